// The three planes: what is painted, and where.

// Axis across, image right, image down and its sense, letters left, right, above, below.
const KINDS = [
  { name: 'axial', c: 2, a: 0, b: 1, up: false, letters: 'RLAP' },
  { name: 'coronal', c: 1, a: 0, b: 2, up: true, letters: 'RLHF' },
  { name: 'sagittal', c: 0, a: 1, b: 2, up: true, letters: 'APHF' },
];
const PRESETS = {
  both: null, soft: [40, 400], bone: [400, 1800], lung: [-600, 1500], auto: null, own: null,
};
const CHECK_MM = 20, SLAB_MM = 4, AIR_HU = -900;

const s = {
  pos: grid.nearest(about.start), moved: 'deformed', mode: about.mode, preset: 'both', level: 40, width: 400, zoom: 1,
  curtain: 0.5, flip: false, bonesBefore: true, bonesAfter: true, arrows: false, marks: true, map: '',
  structures: new Set(about.structures.keys()),
};

const share = (x, low, high) => clamp((x - low) / (high - low), 0, 1);
// As the pictures of the report: soft tissue in the lower part, bone above it.
const bothTone = x => 0.64 * share(x, -150, 170) + 0.36 * share(x, 170, 1400);

function tones(gain, offset) {
  const table = new Uint8Array(65536);
  for (let n = 1; n < table.length; n++) {
    const x = gain * (n === 1 ? -1000 : hu(n)) + offset;
    const tone = s.preset === 'both' ? bothTone(x) : share(x, s.level - s.width / 2, s.level + s.width / 2);
    table[n] = Math.round(255 * tone);
  }
  return table;
}
let toneA, toneB;
function window_() {
  toneA = tones(1, 0);
  toneB = tones(...about.scale);
}

// Window from the 2nd to the 99th percentile of what is not air in the fraction.
function automatic() {
  const counts = new Uint32Array(65536);
  let all = 0;
  for (const n of volumes.fraction) if (n > 1 && hu(n) >= AIR_HU) { counts[n]++; all++; }
  const at = part => {
    let sum = 0, n = 0;
    while (n < counts.length - 1 && sum <= part * all) sum += counts[++n];
    return about.scale[0] * hu(n) + about.scale[1];
  };
  const [low, high] = all ? [at(0.02), at(0.99)] : [-160, 240];
  [s.level, s.width] = [Math.round((low + high) / 2), Math.max(20, Math.round(high - low))];
}

const ramp = (stops, x) => {
  const at = clamp(x, 0, 1) * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2);
  return stops[low].map((v, c) => Math.round(v + (stops[low + 1][c] - v) * (at - low)));
};
const MAGNITUDE = [[76, 201, 240], [94, 224, 142], [250, 233, 92], [255, 159, 28], [255, 56, 84]];
const HEAT = [[30, 20, 80], [110, 30, 130], [200, 55, 100], [248, 140, 60], [250, 230, 130]];
const GROWTH = [[8, 62, 140], [56, 130, 196], [160, 204, 232], [255, 255, 255], [250, 190, 165], [222, 92, 74],
  [150, 8, 34]];

// Length of the motion at a place of the coarse grid, apart from the shift between far scanner origins.
const own = n => [0, 1, 2].map(a => volumes[['ux', 'uy', 'uz'][a]][n] * about.steps.mm + about.shift[a]);
const MAPS = {
  displacement: n => ramp(MAGNITUDE, Math.hypot(...own(n)) / about.top),
  jacobian: n => {
    const j = (volumes.jacobian[n] - 200) * about.steps.jacobian;
    return j <= 0 ? [0, 0, 0] : ramp(GROWTH, 0.5 + Math.log2(j) / 2);
  },
  uncertainty: n => volumes.uncertainty[n]
    ? ramp(HEAT, (volumes.uncertainty[n] - 1) * about.steps.uncertainty / about.unsure[0]) : [120, 120, 128],
};

class Plane {
  constructor(kind, host) {
    Object.assign(this, kind, { host, canvas: host.querySelector('canvas') });
    this.slider = host.querySelector('input');
    this.told = host.querySelector('output');
    this.context = this.canvas.getContext('2d');
    this.size = [grid.size[this.a], grid.size[this.b]];
    this.mm = [this.a, this.b].map(a => grid.size[a] * grid.spacing[a]);
    this.canvas.style.aspectRatio = `${this.mm[0]} / ${this.mm[1]}`;
    this.room = ['A', 'B'].map(() => {
      const canvas = document.createElement('canvas');
      [canvas.width, canvas.height] = this.size;
      return canvas;
    });
    this.wash = document.createElement('canvas');
    this.outlines = new Map();
  }

  // Place in the plane, voxels right and down from the corner, of a voxel or its fractions; and back.
  place(voxel) { return [voxel[this.a], this.up ? grid.size[this.b] - 1 - voxel[this.b] : voxel[this.b]]; }
  voxel(x, y) {
    const voxel = [...s.pos];
    voxel[this.a] = clamp(Math.round(x), 0, this.size[0] - 1);
    const b = this.up ? grid.size[this.b] - 1 - y : y;
    voxel[this.b] = clamp(Math.round(b), 0, this.size[1] - 1);
    return voxel;
  }

  // Pixels of the canvas per voxel, and where the corner of the first voxel lies.
  view() {
    const { width, height } = this.canvas;
    const per = [width * s.zoom / this.size[0], height * s.zoom / this.size[1]];
    const at = this.place(s.pos);
    const off = [width, height].map((room, n) =>
      s.zoom === 1 ? 0 : clamp(room / 2 - (at[n] + 0.5) * per[n], room - room * s.zoom, 0));
    return { per, off, x: i => off[0] + (i + 0.5) * per[0], y: j => off[1] + (j + 0.5) * per[1] };
  }

  // Calls `each(pixel, place in storage, column, row)` for all pixels of the plane.
  walk(each) {
    const [wide, high] = this.size, [sa, sb] = [grid.strides[this.a], grid.strides[this.b]];
    const base = s.pos[this.c] * grid.strides[this.c];
    for (let j = 0, n = 0; j < high; j++) {
      let at = base + (this.up ? high - 1 - j : j) * sb;
      for (let i = 0; i < wide; i++, n++, at += sa) each(n, at, i, j);
    }
  }

  // Paints one of the two rooms; `colour(planning tone, fraction tone, column, row)` is 0xBBGGRR.
  paint(room, colour) {
    const canvas = this.room[room], context = canvas.getContext('2d');
    const image = context.createImageData(canvas.width, canvas.height);
    const pixels = new Uint32Array(image.data.buffer);
    const b = volumes.fraction;
    if (s.moved === 'couch') {
      const a = this.couched();
      this.walk((n, at, i, j) => { pixels[n] = 0xff000000 | colour(toneA[a[n]], toneB[b[at]], i, j); });
    } else {
      const a = s.moved === 'deformed' ? volumes.deformed : volumes.planning;
      this.walk((n, at, i, j) => { pixels[n] = 0xff000000 | colour(toneA[a[at]], toneB[b[at]], i, j); });
    }
    context.putImageData(image, 0, 0);
    return canvas;
  }

  // The plane of planning as scanned, moved by the couch shift alone: between voxels; 0 where there is no data.
  couched() {
    if (this.shifted && this.shifted.at === s.pos[this.c]) return this.shifted.values;
    const values = new Uint16Array(this.size[0] * this.size[1]), { size, strides } = grid, from = volumes.planning;
    const back = about.couch.map((mm, a) => -mm / grid.spacing[a]), low = back.map(Math.floor);
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map(n => {
      const by = [n & 1, n >> 1 & 1, n >> 2];
      const weight = by.reduce((w, b, a) => w * (b ? back[a] - low[a] : 1 - back[a] + low[a]), 1);
      return { offset: by.reduce((sum, b, a) => sum + (low[a] + b) * strides[a], 0), weight };
    }).filter(corner => corner.weight > 0);
    const fits = (i, a) => i + low[a] >= 0 && i + low[a] + (back[a] > low[a] ? 1 : 0) < size[a];
    const b = j => this.up ? size[this.b] - 1 - j : j;
    if (fits(s.pos[this.c], this.c)) this.walk((n, at, i, j) => {
      if (!fits(i, this.a) || !fits(b(j), this.b)) return;
      let sum = 0;
      for (const { offset, weight } of corners) {
        const value = from[at + offset];
        if (!value) return;
        sum += weight * value;
      }
      values[n] = Math.round(sum);
    });
    this.shifted = { at: s.pos[this.c], values };
    return values;
  }

  draw() {
    const { canvas, context } = this, v = this.view();
    context.imageSmoothingEnabled = true;
    context.fillStyle = '#000';
    context.fillRect(0, 0, canvas.width, canvas.height);
    const put = image => context.drawImage(image, v.off[0], v.off[1], canvas.width * s.zoom, canvas.height * s.zoom);
    const grey = t => t * 0x010101;
    if (s.mode === 'curtain') {
      put(this.paint(0, a => grey(a)));
      context.save();
      context.beginPath();
      context.rect(s.curtain * canvas.width, 0, canvas.width, canvas.height);
      context.clip();
      put(this.paint(1, (a, b) => grey(b)));
      context.restore();
      this.line([[s.curtain * canvas.width, 0], [s.curtain * canvas.width, canvas.height]], '#fff', 2);
    } else {
      put(this.paint(0, this.colours(grey)));
    }
    if (s.map && volumes[s.map === 'displacement' ? 'ux' : s.map]) this.drawMap(v);
    if (s.bonesBefore) this.drawOutline(v, 'bones_before', '#ffffff', true);
    if (s.bonesAfter) this.drawOutline(v, 'bones_after', '#ffe14d', false);
    for (const bit of s.structures) {
      const colour = `rgb(${about.structures[bit].colour})`;
      if (s.bonesBefore) this.drawOutline(v, 'structures_before', colour, true, bit);
      if (s.bonesAfter) this.drawOutline(v, 'structures_after', colour, false, bit);
    }
    if (s.arrows) this.drawArrows(v);
    if (s.marks) this.drawMarks(v);
    this.drawCross(v);
    this.drawLetters();
    this.slider.value = s.pos[this.c];
    this.told.textContent = `${this.name} ${'xyz'[this.c]} = ${fixed(grid.world(s.pos)[this.c], 1)} mm`;
  }

  colours(grey) {
    const first = s.mode === 'planning' || (s.mode === 'blink' && !s.flip);
    if (first) return a => grey(a);
    if (s.mode === 'fraction' || s.mode === 'blink') return (a, b) => grey(b);
    if (s.mode === 'checker') {
      const side = [this.a, this.b].map(a => CHECK_MM / grid.spacing[a]);
      return (a, b, i, j) => grey((Math.floor(i / side[0]) + Math.floor(j / side[1])) % 2 ? b : a);
    }
    if (s.mode === 'difference') {
      return (a, b) => {
        const d = Math.min(255, 2 * Math.abs(a - b));
        return a > b ? d << 16 | (d * 108 / 255) << 8 : (d * 147 / 255) << 8 | d;
      };
    }
    return (a, b) => a << 16 | ((a * 108 + b * 147) / 255) << 8 | b;
  }

  drawMap(v) {
    const wide = coarse.size[this.a], high = coarse.size[this.b];
    [this.wash.width, this.wash.height] = [wide, high];
    const context = this.wash.getContext('2d'), image = context.createImageData(wide, high);
    const at = coarseOf(s.pos);
    for (let j = 0; j < high; j++) for (let i = 0; i < wide; i++) {
      [at[this.a], at[this.b]] = [i, this.up ? high - 1 - j : j];
      const n = coarse.at(at);
      if (volumes.jacobian[n]) image.data.set([...MAPS[s.map](n), 150], 4 * (i + wide * j));
    }
    context.putImageData(image, 0, 0);
    // The first and last place of the coarse grid are voxels of the fine one.
    const [ea, eb] = [every[this.a], every[this.b]];
    const top = this.up ? grid.size[this.b] - 1 - (high - 1) * eb : 0;
    this.context.drawImage(this.wash, v.x(-ea / 2), v.y(top - eb / 2), wide * ea * v.per[0], high * eb * v.per[1]);
  }

  // Borders of labels as pairs of places: between unequal neighbours, corners cut.
  outline(name, bit) {
    const key = `${name} ${bit} ${s.pos[this.c]}`;
    if (this.outlines.has(key)) return this.outlines.get(key);
    if (this.outlines.size > 200) this.outlines.clear();
    const labels = volumes[name], [wide, high] = this.size, own = new Uint16Array(wide * high), out = [];
    this.walk((n, at) => { own[n] = bit === undefined ? labels[at] : labels[at] >>> bit & 1; });
    for (let j = 0; j + 1 < high; j++) for (let i = 0; i + 1 < wide; i++) {
      const n = i + wide * j, p = own[n], q = own[n + 1], r = own[n + wide], t = own[n + wide + 1];
      if (p === q && q === r && r === t) continue;
      const cuts = [];
      if (p !== q) cuts.push([i + 0.5, j]);
      if (q !== t) cuts.push([i + 1, j + 0.5]);
      if (r !== t) cuts.push([i + 0.5, j + 1]);
      if (p !== r) cuts.push([i, j + 0.5]);
      if (cuts.length === 2) out.push([cuts[0], cuts[1]]);
      else for (const cut of cuts) out.push([cut, [i + 0.5, j + 0.5]]);
    }
    this.outlines.set(key, out);
    return out;
  }

  drawOutline(v, name, colour, thin, bit) {
    const { context } = this;
    context.beginPath();
    for (const [[x0, y0], [x1, y1]] of this.outline(name, bit)) {
      context.moveTo(v.x(x0), v.y(y0));
      context.lineTo(v.x(x1), v.y(y1));
    }
    context.lineWidth = (thin ? 1 : 1.4) * ratio();
    context.globalAlpha = thin ? 0.75 : 1;
    context.strokeStyle = colour;
    context.stroke();
    context.globalAlpha = 1;
  }

  line(points, colour, width) {
    const { context } = this;
    context.beginPath();
    points.forEach(([x, y], n) => n ? context.lineTo(x, y) : context.moveTo(x, y));
    context.strokeStyle = colour;
    context.lineWidth = width * ratio();
    context.stroke();
  }

  // From where tissue was to where it is, apart from the shift between far scanner origins.
  drawArrows(v) {
    const least = 22 * ratio(), step = [this.a, this.b].map((a, n) => Math.ceil(least / (every[a] * v.per[n])));
    const at = coarseOf(s.pos);
    for (let j = 0; j < coarse.size[this.b]; j += step[1]) for (let i = 0; i < coarse.size[this.a]; i += step[0]) {
      [at[this.a], at[this.b]] = [i, j];
      const n = coarse.at(at);
      if (!volumes.jacobian[n]) continue;
      const u = own(n), [x, y] = this.place(at.map((c, a) => c * every[a]));
      const back = [this.a, this.b].map(a => u[a] / grid.spacing[a]);
      const to = [v.x(x), v.y(y)], from = [v.x(x + back[0]), v.y(y + (this.up ? -back[1] : back[1]))];
      const colour = `rgb(${ramp(MAGNITUDE, Math.hypot(...u) / about.top)})`;
      const [dx, dy] = [to[0] - from[0], to[1] - from[1]], long = Math.hypot(dx, dy);
      if (long < 1) continue;
      const head = Math.min(6 * ratio(), long) / long;
      const wing = side => [to[0] - head * (dx + side * 0.5 * dy), to[1] - head * (dy - side * 0.5 * dx)];
      for (const [c, w] of [['rgba(0,0,0,.8)', 3], [colour, 1.5]]) {
        this.line([from, to], c, w);
        this.line([wing(1), to, wing(-1)], c, w);
      }
    }
  }

  // Landmarks near the plane: a ring where they are, a cross where the field takes them.
  drawMarks(v) {
    const here = grid.world(s.pos)[this.c];
    for (const mark of about.landmarks) {
      const spot = p => {
        const [x, y] = this.place(p.map((q, a) => (q - grid.origin[a]) / grid.spacing[a]));
        return [v.x(x), v.y(y)];
      };
      if (Math.abs(mark.fraction[this.c] - here) <= SLAB_MM) {
        const [x, y] = spot(mark.fraction), { context } = this;
        context.beginPath();
        context.arc(x, y, 5 * ratio(), 0, 7);
        context.strokeStyle = '#3cff50';
        context.lineWidth = 1.6 * ratio();
        context.stroke();
      }
      if (mark.mapped && Math.abs(mark.mapped[this.c] - here) <= SLAB_MM) {
        const [x, y] = spot(mark.mapped), d = 4 * ratio();
        this.line([[x - d, y - d], [x + d, y + d]], '#ff3cc8', 1.6);
        this.line([[x - d, y + d], [x + d, y - d]], '#ff3cc8', 1.6);
      }
    }
  }

  drawCross(v) {
    const [i, j] = this.place(s.pos), [x, y] = [v.x(i), v.y(j)], { width, height } = this.canvas, gap = 9 * ratio();
    for (const ends of [[[0, y], [x - gap, y]], [[x + gap, y], [width, y]], [[x, 0], [x, y - gap]],
      [[x, y + gap], [x, height]]]) this.line(ends, 'rgba(120,230,255,.75)', 1);
  }

  drawLetters() {
    const { context } = this, { width, height } = this.canvas, d = 11 * ratio();
    context.font = `600 ${14 * ratio()}px sans-serif`;
    context.textAlign = 'center';
    context.textBaseline = 'middle';
    const places = [[d, height / 2], [width - d, height / 2], [width / 2, d], [width / 2, height - d]];
    places.forEach(([x, y], n) => {
      context.lineWidth = 3 * ratio();
      context.strokeStyle = '#000';
      context.strokeText(this.letters[n], x, y);
      context.fillStyle = '#fff';
      context.fillText(this.letters[n], x, y);
    });
    if (s.mode === 'curtain') {
      context.textAlign = 'right';
      const x = s.curtain * width;
      context.fillText('planning  ', x, height - 3 * d);
      context.textAlign = 'left';
      context.fillText('  fraction', x, height - 3 * d);
    }
  }
}

const ratio = () => Math.min(window.devicePixelRatio || 1, 2);
