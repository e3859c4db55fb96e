// Controls, read-outs and lists.

const root = document.getElementById('viewer');
const $ = selector => root.querySelector(selector);
let planes = [], timer = 0, waiting = false;

function draw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    planes.forEach(plane => plane.draw());
    tell();
  });
}

// Crosshair to a position, LPS mm.
function go(p) {
  s.pos = grid.nearest(p);
  draw();
}

const fixed = (x, digits) => x.toFixed(digits).replace(/^-(0(\.0*)?)$/, '$1').replace('-', '\u2212');
// Digits of mm: as many as the field is told in.
const digits = about.steps.mm < 0.1 ? 2 : 1;
const point = (p, digits = 1) => p.map(x => fixed(x, digits)).join(', ');
const told = n => {
  const value = hu(n);
  return value === null ? 'no data' : value === -Infinity ? `below ${fixed(about.hu.first, 0)}` : fixed(value, 0);
};

function tell() {
  const n = grid.at(s.pos), p = grid.world(s.pos), set = (name, text) => { $(`[data-told=${name}]`).textContent = text; };
  set('at', point(p));
  for (const name of ['fraction', 'deformed', 'planning']) set(name, told(volumes[name][n]));
  const v = motion(s.pos), m = coarse.at(coarseOf(s.pos));
  set('from', v ? point(p.map((x, a) => x + v[a]), digits) : '\u2013');
  set('displacement', v ? `${fixed(Math.hypot(...v), digits)} (${point(v.map(x => -x), digits)})` : 'outside the patient');
  const j = (volumes.jacobian[m] - 200) * about.steps.jacobian;
  set('jacobian', !v ? '\u2013' : j <= 0 ? 'folded' : fixed(j, 2));
  const u = volumes.uncertainty && v ? volumes.uncertainty[m] : 0;
  set('uncertainty', u ? fixed((u - 1) * about.steps.uncertainty, 2) : volumes.uncertainty ? 'not known' : 'not computed');
  const bone = name => volumes[name][n] ? about.names[volumes[name][n]] || `label ${volumes[name][n]}` : '';
  const [was, is] = [bone('bones_before'), bone('bones_after')];
  set('bone', is || was ? `${is || 'none'}; before: ${was || 'none'}` : 'none');
  const plan = {
    deformed: 'deformed planning', couch: 'planning moved by the couch shift alone',
    scanned: about.shifted ? 'planning moved by the couch shift' : 'planning as scanned',
  }[s.moved];
  const seen = {
    colour: `${plan} blue, fraction orange, grey where both agree`, curtain: `${plan} on the left, fraction on the right`,
    checker: `${plan} and fraction in alternating squares of ${CHECK_MM} mm`, difference: `blue: ${plan} is brighter; orange: fraction is brighter`,
    blink: `now: ${s.flip ? 'fraction' : plan} (planning and fraction alternate)`, planning: plan, fraction: 'fraction',
  };
  $('.seen').textContent = seen[s.mode];
}

// What the colours of the map mean, or those of the arrows.
function scale() {
  const length = [MAGNITUDE, 'displacement 0', `${fixed(about.top, 0)} mm`];
  const known = {
    displacement: length, jacobian: [GROWTH, 'Jacobian 0.5', '2'], uncertainty: [HEAT, 'uncertainty 0', `${about.unsure[0]} mm; maximum ${fixed(about.unsure[1], 1)} mm`],
  }[s.map] || (s.arrows ? length : null);
  $('.scale').hidden = !known;
  if (!known) return;
  const [low, high] = root.querySelectorAll('.scale b');
  [low.textContent, high.textContent] = [known[1], known[2]];
  $('.scale i').style.background = `linear-gradient(to right, ${known[0].map(c => `rgb(${c})`)})`;
}

function show() {
  for (const button of root.querySelectorAll('[data-mode]')) {
    button.setAttribute('aria-pressed', button.dataset.mode === s.mode);
  }
  for (const button of root.querySelectorAll('[data-moved]')) {
    button.setAttribute('aria-pressed', button.dataset.moved === s.moved);
  }
  for (const box of root.querySelectorAll('[data-flag]')) box.checked = s[box.dataset.flag];
  $('[data-preset]').value = s.preset;
  $('[data-map]').value = s.map;
  $('.window').textContent = s.preset === 'both' ? '' : `level ${s.level}, width ${s.width} HU`;
  scale();
  clearInterval(timer);
  if (s.mode === 'blink') timer = setInterval(() => { s.flip = !s.flip; draw(); }, 700);
  draw();
}

function preset(name) {
  s.preset = name;
  if (PRESETS[name]) [s.level, s.width] = PRESETS[name];
  if (name === 'auto') automatic();
  window_();
  show();
}

function zoom(by) {
  s.zoom = clamp(s.zoom * by, 1, 8);
  if (s.zoom < 1.05) s.zoom = 1;
  draw();
}

function step(axis, by) {
  s.pos[axis] = clamp(s.pos[axis] + by, 0, grid.size[axis] - 1);
  draw();
}

// Mouse, touch and wheel on a plane.
function handle(plane) {
  const { canvas } = plane;
  let held = null, meant = false;
  const place = event => {
    const box = canvas.getBoundingClientRect(), v = plane.view(), scale = canvas.width / box.width;
    const [x, y] = [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    return { x, voxel: plane.voxel((x - v.off[0]) / v.per[0] - 0.5, (y - v.off[1]) / v.per[1] - 0.5) };
  };
  const follow = event => {
    const { x, voxel } = place(event);
    if (held.what === 'curtain') s.curtain = clamp(x / canvas.width, 0, 1);
    else if (held.what === 'window') {
      if (s.preset === 'both') [s.level, s.width] = [110, 520];
      s.preset = 'own';
      s.width = Math.max(4, Math.round(s.width + 2 * (event.clientX - held.x)));
      s.level = Math.round(s.level - 2 * (event.clientY - held.y));
      [held.x, held.y] = [event.clientX, event.clientY];
      window_();
      return show();
    } else s.pos = voxel;
    draw();
  };
  canvas.addEventListener('pointerdown', event => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    const near = s.mode === 'curtain' && Math.abs(place(event).x - s.curtain * canvas.width) < 14 * ratio();
    const what = event.button === 2 || event.shiftKey ? 'window' : near ? 'curtain' : 'cross';
    held = { what, x: event.clientX, y: event.clientY };
    if (what !== 'window') follow(event);
  });
  canvas.addEventListener('pointermove', event => { meant = true; if (held) follow(event); });
  for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, () => { held = null; });
  canvas.addEventListener('contextmenu', event => event.preventDefault());
  // The wheel turns the pages of a plane that the mouse went to, not of one that the page brought under it.
  addEventListener('scroll', () => { meant = false; }, { passive: true });
  canvas.addEventListener('wheel', event => {
    if (!meant && document.activeElement !== canvas) return;
    event.preventDefault();
    if (event.ctrlKey) return zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2);
    step(plane.c, (plane.c === 2 ? -1 : 1) * Math.sign(event.deltaY));
  }, { passive: false });
  plane.slider.max = grid.size[plane.c] - 1;
  plane.slider.addEventListener('input', () => { s.pos[plane.c] = Number(plane.slider.value); draw(); });
  new ResizeObserver(() => {
    const wide = Math.max(1, Math.round(canvas.clientWidth * ratio()));
    const high = Math.max(1, Math.round(wide * plane.mm[1] / plane.mm[0]));
    if (canvas.width === wide && canvas.height === high) return;
    [canvas.width, canvas.height] = [wide, high];
    plane.draw();
  }).observe(canvas);
}

const MODES = { 3: 'fraction', 4: 'colour', 5: 'curtain', 6: 'checker', 7: 'difference', b: 'blink' };
function key(event) {
  const inside = root.contains(document.activeElement), tag = document.activeElement.tagName;
  if (event.ctrlKey || event.metaKey || event.altKey || tag === 'SELECT') return;
  const k = event.key.toLowerCase(), plane = planes.find(p => p.canvas === document.activeElement) || planes[0];
  if (k.startsWith('arrow') || k.startsWith('page')) {
    if (!inside || tag === 'INPUT') return;
    const [axis, by] = {
      arrowleft: [plane.a, -1], arrowright: [plane.a, 1], arrowup: [plane.b, plane.up ? 1 : -1],
      arrowdown: [plane.b, plane.up ? -1 : 1], pageup: [plane.c, 1], pagedown: [plane.c, -1],
    }[k];
    step(axis, by);
  } else if (!inside && document.activeElement !== document.body) return;
  else if (k === '1' || k === '2') { s.mode = 'planning'; s.moved = k === '2' ? 'deformed' : 'scanned'; show(); }
  else if (MODES[k]) { s.mode = s.mode === 'blink' && k === 'b' ? 'colour' : MODES[k]; show(); }
  else if (k === 'm') { s.moved = { deformed: 'scanned', scanned: about.shifted ? 'deformed' : 'couch', couch: 'deformed' }[s.moved]; show(); }
  else if (k === 'o') { s.bonesBefore = s.bonesAfter = !s.bonesAfter; show(); }
  else if (k === 'a') { s.arrows = !s.arrows; show(); }
  else if (k === '+' || k === '=') zoom(1.25);
  else if (k === '-') zoom(1 / 1.25);
  else return;
  event.preventDefault();
}

// A list whose lines bring the crosshair to their places.
function list(name, title, lines) {
  const host = $(`[data-list=${name}]`);
  if (!lines.length) return;
  host.hidden = false;
  host.querySelector('summary').textContent = `${title} (${lines.length})`;
  for (const [text, more, at] of lines) {
    const button = document.createElement('button'), aside = document.createElement('span');
    button.type = 'button';
    button.textContent = text;
    aside.textContent = more;
    button.append(aside);
    button.addEventListener('click', () => go(at));
    host.append(button);
  }
}

// A list of structures, each with its colour and whether it is drawn.
function structures() {
  const host = $('[data-list=structures]');
  host.hidden = !about.structures.length;
  host.querySelector('summary').textContent = `Structures (${about.structures.length})`;
  about.structures.forEach((structure, bit) => {
    const label = document.createElement('label'), box = document.createElement('input');
    box.type = 'checkbox';
    box.checked = true;
    box.addEventListener('change', () => {
      if (box.checked) s.structures.add(bit); else s.structures.delete(bit);
      draw();
    });
    const colour = document.createElement('i');
    colour.className = 'outline';
    colour.style.color = `rgb(${structure.colour})`;
    label.append(box, colour, structure.name);
    host.append(label);
  });
}

async function start() {
  root.hidden = false;
  await load();
  if (!volumes.uncertainty) $('[data-map] [value=uncertainty]').remove();
  window_();
  const [wx, wy, wz] = grid.size.map((n, a) => n * grid.spacing[a]);
  $('.planes').style.setProperty('--columns', `${wx}fr ${wy}fr`);
  $('.planes').style.maxWidth = `${Math.round(680 * (wx + wy) / Math.max(wy, wz))}px`;
  planes = KINDS.map(kind => new Plane(kind, $(`[data-plane=${kind.name}]`)));
  planes.forEach(handle);
  document.addEventListener('keydown', key);
  root.addEventListener('click', event => {
    const { mode, moved } = event.target.dataset;
    if (mode) s.mode = mode;
    if (moved) s.moved = moved;
    if (mode || moved) show();
  });
  root.addEventListener('change', event => {
    const { flag, preset: windows, map } = event.target.dataset;
    if (flag) s[flag] = event.target.checked;
    if (windows !== undefined) return preset(event.target.value);
    if (map !== undefined) s.map = event.target.value;
    show();
  });
  const after = mark => mark.after === null ? 'outside' : `${mark.before.toFixed(1)} \u2192 ${mark.after.toFixed(1)} mm`;
  const worst = about.landmarks.map((mark, n) => ({ ...mark, n })).sort((a, b) => (b.after ?? 1e9) - (a.after ?? 1e9));
  list('places', 'Places to look at', about.places.map(p => [p.what, p.more, p.at]));
  list('landmarks', 'Landmarks, worst first', worst.map(m => [`${m.n + 1} ${m.name}`, after(m), m.fraction]));
  structures();
  list('bones', 'Bones: motion without the couch shift', about.bones.map(b => [b.name, `${b.mm.toFixed(1)} mm`, b.at]));
  show();
  root.dataset.state = 'ready';
}

start().catch(error => {
  root.hidden = false;
  root.dataset.state = 'failed';
  $('.planes').hidden = true;
  $('.failed').hidden = false;
  console.error(error);
});
