// Volumes out of the page: base64, zlib, then each number from its neighbours (see io::embed::pack).

const about = JSON.parse(document.getElementById('view-about').textContent);

async function unpack(name, size, Kind) {
  const holder = document.getElementById(`view-${name}`);
  if (!holder) return null;
  const text = atob(holder.textContent);
  const packed = new Uint8Array(text.length);
  for (let n = 0; n < text.length; n++) packed[n] = text.charCodeAt(n);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const [ni, nj, nk] = size;
  const out = new Kind(ni * nj * nk);
  const wide = new DataView(bytes.buffer, out.length);
  let n = 0, next = 0;
  for (let k = 0; k < nk; k++) {
    for (let j = 0; j < nj; j++) {
      let left = 0, corner = 0;
      for (let i = 0; i < ni; i++, n++) {
        const above = j ? out[n - ni] : 0;
        let number = bytes[n];
        if (number === 255) {
          number = wide.getUint32(next, true);
          next += 4;
        }
        const least = left < above ? left : above, most = left < above ? above : left;
        const expected = corner >= most ? least : corner <= least ? most : left + above - corner;
        left = out[n] = expected + ((number >>> 1) ^ -(number & 1));
        corner = above;
      }
    }
  }
  return out;
}

// A grid along the axes of the world: places in storage and positions, LPS mm.
class Grid {
  constructor({ size, spacing, origin }) {
    Object.assign(this, { size, spacing, origin, strides: [1, size[0], size[0] * size[1]] });
  }
  at(voxel) { return voxel[0] + this.strides[1] * voxel[1] + this.strides[2] * voxel[2]; }
  world(voxel) { return voxel.map((v, a) => this.origin[a] + v * this.spacing[a]); }
  nearest(p) {
    return p.map((x, a) => clamp(Math.round((x - this.origin[a]) / this.spacing[a]), 0, this.size[a] - 1));
  }
}

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const grid = new Grid(about.grid), coarse = new Grid(about.coarse);
const every = coarse.spacing.map((s, a) => Math.round(s / grid.spacing[a]));
const coarseOf = voxel => voxel.map((v, a) => clamp(Math.round(v / every[a]), 0, coarse.size[a] - 1));

const volumes = {};
async function load() {
  const whole = ['fraction', 'deformed', 'planning'].map(name => [name, grid.size, Uint16Array]);
  const labels = ['bones_before', 'bones_after'].map(name => [name, grid.size, Uint16Array]);
  const maps = ['ux', 'uy', 'uz', 'jacobian', 'uncertainty'].map(name => [name, coarse.size, Int16Array]);
  const bits = ['structures_before', 'structures_after'].map(name => [name, grid.size, Int32Array]);
  for (const [name, size, Kind] of [...whole, ...labels, ...bits, ...maps]) volumes[name] = await unpack(name, size, Kind);
}

// HU of an embedded number; null: no data; -Infinity: air, below the least that is told.
const hu = number => number === 0 ? null : number === 1 ? -Infinity : about.hu.first + about.hu.step * (number - 2);

// Where the tissue of a voxel comes from: planning minus fraction, mm; null outside the patient.
function motion(voxel) {
  const n = coarse.at(coarseOf(voxel));
  if (!volumes.jacobian[n]) return null;
  return ['ux', 'uy', 'uz'].map(name => volumes[name][n] * about.steps.mm);
}
