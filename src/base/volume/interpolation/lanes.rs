//! A field at eight places of a row at once, in single precision, whose error of about 1e-5 mm is far below any tolerance: values
//! and gradients from the same eight corners.

use crate::geometry::wide_vector::{WideVector, minus};
use crate::geometry::{LANES, Wide};
use crate::volume::Volume;
use nalgebra::Vector3;

/// The position in storage of what lies outside the grid.
pub const NOWHERE: usize = usize::MAX;

/// Places are held within this many voxels: farther out no image has any.
const FAR: f64 = 1e6;

/// A field that is continued by its edge values, with the constants of its grid at hand.
pub struct Sampler<'a> {
    field: &'a Volume<[f32; 3]>,
    last: [i32; 3],
    /// Lower neighbour of the last pair of voxels.
    most: [i32; 3],
    strides: [usize; 3],
    /// Distances in storage to the upper corners; 0 along an axis of one voxel.
    up: [usize; 3],
    /// World to index, row by row.
    pub turn: [[f32; 3]; 3],
}

/// [`LANES`] places that follow each other in a row, as indices of the field's grid: whole part and rest of the first, and the
/// way from one to the next.
pub struct Block {
    whole: [i32; 3],
    rest: [f32; 3],
    along: [f32; 3],
}

/// In which cells of the field [`LANES`] places lie.
pub struct Cells {
    /// Position in storage of their first corners.
    base: [usize; LANES],
    /// How far the places are from these, in cells.
    t: WideVector,
    /// The places, counted from the block's whole ones; they may lie outside the grid.
    x: WideVector,
    /// Whether the first corners follow each other in storage.
    in_line: bool,
}

/// Values of the field at places, and its derivative by the index: one column per axis.
pub struct Sample {
    /// The values.
    pub value: WideVector,
    /// The derivative along each axis of the index.
    pub slope: [WideVector; 3],
}

impl<'a> Sampler<'a> {
    /// Of displacements (mm) on any grid.
    pub fn new(field: &'a Volume<[f32; 3]>) -> Self {
        let grid = field.grid();
        let (size, strides, turn) = (grid.size(), grid.strides(), grid.inverse_step());
        let index = |n: usize| i32::try_from(n).unwrap_or(i32::MAX);
        Self {
            field,
            last: size.map(|n| index(n - 1)),
            most: size.map(|n| index(n.saturating_sub(2))),
            strides,
            up: std::array::from_fn(|a| if size[a] > 1 { strides[a] } else { 0 }),
            turn: std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)] as f32)),
        }
    }

    /// The places from a continuous index on, `along` apart.
    pub fn block(start: &Vector3<f64>, along: &Vector3<f64>) -> Block {
        // What is no number becomes 0, and what is far off is held far outside.
        let held = start.map(|x| x.clamp(-FAR, FAR));
        Block {
            whole: std::array::from_fn(|a| held[a].floor() as i32),
            rest: std::array::from_fn(|a| (held[a] - held[a].floor()) as f32),
            along: std::array::from_fn(|a| along[a] as f32),
        }
    }

    /// The voxels nearest to where displacements lead, by their position in storage; [`NOWHERE`] outside the grid.
    #[inline(always)]
    pub fn land(&self, block: &Block, v: &WideVector) -> [usize; LANES] {
        let (mut near, mut within) = ([0u64; LANES], [true; LANES]);
        for a in 0..3 {
            let by = self.turn[a];
            let (least, most) = ((-block.whole[a]) as f32, (self.last[a] - block.whole[a]) as f32);
            let stride = self.strides[a] as u32;
            for l in 0..LANES {
                let moved = by[0] * v[0].0[l] + by[1] * v[1].0[l] + by[2] * v[2].0[l];
                let x = (block.rest[a] + block.along[a] * l as f32) + moved;
                within[l] &= (x >= least) & (x <= most);
                let voxel = nearest(x).0.wrapping_add(block.whole[a]);
                near[l] = near[l].wrapping_add(u64::from(voxel as u32) * u64::from(stride));
            }
        }
        let mut out = [NOWHERE; LANES];
        for l in 0..LANES {
            out[l] = if within[l] { near[l] as usize } else { NOWHERE };
        }
        out
    }

    /// The cells in which the places of a block lie after displacements `v`.
    #[inline(always)]
    pub fn cells(&self, block: &Block, v: &WideVector) -> Cells {
        let (x, t) = ([Wide::default(); 3], [Wide::default(); 3]);
        let mut cells = Cells { base: [0; LANES], t, x, in_line: self.up[0] == 1 };
        for a in 0..3 {
            let by = self.turn[a];
            let (least, most) = ((-block.whole[a]) as f32, (self.last[a] - block.whole[a]) as f32);
            let last_cell = (self.most[a] - block.whole[a]) as f32;
            for l in 0..LANES {
                let moved = by[0] * v[0].0[l] + by[1] * v[1].0[l] + by[2] * v[2].0[l];
                let x = (block.rest[a] + block.along[a] * l as f32) + moved;
                // What is no number comes to lie at the edge.
                let held = if x > least { x } else { least };
                let held = if held < most { held } else { most };
                // The whole number nearest to half a voxel before it; on a voxel either of its cells will do.
                let half = held - 0.5;
                let half = if half > least { half } else { least };
                let half = if half < last_cell { half } else { last_cell };
                let (cell, low) = nearest(half);
                cells.x[a].0[l] = x;
                cells.t[a].0[l] = held - low;
                cells.base[l] += cell.wrapping_add(block.whole[a]) as u32 as usize * self.strides[a];
            }
        }
        for (l, place) in cells.base.iter().enumerate() {
            cells.in_line &= *place == cells.base[0] + l;
        }
        cells
    }

    /// The field in cells of a block.
    #[inline(always)]
    pub fn at(&self, block: &Block, cells: &Cells) -> Sample {
        let t = &cells.t;
        let ((a, ax, ay), (b, bx, by)) = (self.face(cells, 0), self.face(cells, self.up[2]));
        let z = minus(&b, &a);
        let x = between(&ax, t[2], &minus(&bx, &ax));
        let y = between(&ay, t[2], &minus(&by, &ay));
        let mut slope = [x, y, z];
        for (a, slope) in slope.iter_mut().enumerate() {
            let (least, most) = ((-block.whole[a]) as f32, (self.last[a] - block.whole[a]) as f32);
            // Beyond the edge the field does not change.
            let mut free = Wide::default();
            for l in 0..LANES {
                let x = cells.x[a].0[l];
                free.0[l] = if (x >= least) & (x <= most) { 1.0 } else { 0.0 };
            }
            *slope = times(slope, free);
        }
        Sample { value: between(&a, t[2], &z), slope }
    }

    /// The field's values at the places of a block after displacements `v`.
    #[inline(always)]
    pub fn value(&self, block: &Block, v: &WideVector) -> WideVector {
        self.values(block, &self.cells(block, v))
    }

    /// The field's values in cells of a block: the same bits as with the slope, sooner.
    #[inline(always)]
    pub fn values(&self, block: &Block, cells: &Cells) -> WideVector {
        let edges = [0, self.up[1], self.up[2], self.up[1] + self.up[2]];
        let flat = self.field.data().as_flattened();
        if cells.in_line
            && let Some(runs) = each(edges, |e| flat.get(3 * (cells.base[0] + e)..)?.first_chunk())
        {
            return in_line(runs, &cells.t);
        }
        let mut values = [[0f32; 4]; LANES];
        for (l, value) in values.iter_mut().enumerate() {
            let t = [cells.t[0].0[l], cells.t[1].0[l], cells.t[2].0[l]];
            let pairs = each(edges, |e| flat.get(3 * (cells.base[l] + e)..)?.first_chunk());
            let Some(pairs) = pairs.filter(|_| self.up[0] == 1) else { return self.at(block, cells).value };
            *value = in_cell(pairs, t);
        }
        let mut out = [Wide::default(); 3];
        for (l, value) in values.iter().enumerate() {
            for (a, out) in out.iter_mut().enumerate() {
                out.0[l] = value[a];
            }
        }
        out
    }

    /// Values on the lower or upper faces of cells, and their derivatives by the first two indices.
    #[inline(always)]
    fn face(&self, cells: &Cells, offset: usize) -> (WideVector, WideVector, WideVector) {
        let t = &cells.t;
        let (a, b) = self.pairs(cells, offset);
        let (c, d) = self.pairs(cells, offset + self.up[1]);
        let (low, high) = (minus(&b, &a), minus(&d, &c));
        let (a, c) = (between(&a, t[0], &low), between(&c, t[0], &high));
        let across = minus(&c, &a);
        (between(&a, t[1], &across), between(&low, t[1], &minus(&high, &low)), across)
    }

    /// The voxels `offset` behind the first ones of cells, and the next ones along the first axis.
    #[inline(always)]
    fn pairs(&self, cells: &Cells, offset: usize) -> (WideVector, WideVector) {
        let base = &cells.base;
        if cells.in_line
            && let Some(run) = self.field.data().get(base[0] + offset..).and_then(|u| u.first_chunk::<{ LANES + 1 }>())
        {
            let (mut a, mut b) = ([Wide::default(); 3], [Wide::default(); 3]);
            for l in 0..LANES {
                for c in 0..3 {
                    a[c].0[l] = run[l][c];
                    b[c].0[l] = run[l + 1][c];
                }
            }
            return (a, b);
        }
        (self.corners(base, offset), self.corners(base, offset + self.up[0]))
    }

    /// The voxels `offset` behind those of `base`.
    #[inline(always)]
    fn corners(&self, base: &[usize; LANES], offset: usize) -> WideVector {
        let mut out = [Wide::default(); 3];
        for (l, base) in base.iter().enumerate() {
            let u = self.field.data()[base + offset];
            for a in 0..3 {
                out[a].0[l] = u[a];
            }
        }
        out
    }
}

#[inline(always)]
fn times(a: &WideVector, by: Wide) -> WideVector {
    [a[0] * by, a[1] * by, a[2] * by]
}

/// `a + t b`.
#[inline(always)]
fn between(a: &WideVector, t: Wide, b: &WideVector) -> WideVector {
    [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]]
}

/// What `of` makes of four things, if it makes something of each.
#[inline(always)]
fn each<T>(of: [usize; 4], make: impl Fn(usize) -> Option<T>) -> Option<[T; 4]> {
    Some([make(of[0])?, make(of[1])?, make(of[2])?, make(of[3])?])
}

/// Three components of nine voxels in a row, as they lie in storage.
type LaneRun<'a> = &'a [f32; 3 * (LANES + 1)];

/// Values in cells that follow each other in storage, whose edges along the first axis are these: interpolated as they lie in
/// storage, and sorted by component at the end.
#[inline(always)]
fn in_line(runs: [LaneRun<'_>; 4], t: &WideVector) -> WideVector {
    // Eight numbers at a time of the run from `first` on.
    let part = |run: LaneRun<'_>, first: usize| {
        let mut out = [Wide::default(); 3];
        for (c, out) in out.iter_mut().enumerate() {
            for l in 0..LANES {
                out.0[l] = run[first + c * LANES + l];
            }
        }
        out
    };
    // Each place's share three times, once for each component.
    let thrice = |t: Wide| {
        let mut out = [Wide::default(); 3];
        for l in 0..LANES {
            for c in 0..3 {
                let n = 3 * l + c;
                out[n / LANES].0[n % LANES] = t.0[l];
            }
        }
        out
    };
    let mix = |a: &WideVector, t: &WideVector, b: &WideVector| {
        let d = minus(b, a);
        [a[0] + t[0] * d[0], a[1] + t[1] * d[1], a[2] + t[2] * d[2]]
    };
    let [tx, ty, tz] = [thrice(t[0]), thrice(t[1]), thrice(t[2])];
    let edge = |run: LaneRun<'_>| mix(&part(run, 0), &tx, &part(run, 3));
    let low = mix(&edge(runs[0]), &ty, &edge(runs[1]));
    let high = mix(&edge(runs[2]), &ty, &edge(runs[3]));
    let mixed = mix(&low, &tz, &high);
    let mut out = [Wide::default(); 3];
    for l in 0..LANES {
        for (c, out) in out.iter_mut().enumerate() {
            let n = 3 * l + c;
            out.0[l] = mixed[n / LANES].0[n % LANES];
        }
    }
    out
}

/// The value in a cell whose edges along the first axis are these: two voxels each, and one number more.
#[inline(always)]
fn in_cell(edges: [&[f32; 7]; 4], t: [f32; 3]) -> [f32; 4] {
    let mix = |a: [f32; 4], t: f32, b: [f32; 4]| {
        let mut out = a;
        for c in 0..4 {
            out[c] += t * (b[c] - a[c]);
        }
        out
    };
    let edge = |e: &[f32; 7]| mix([e[0], e[1], e[2], e[3]], t[0], [e[3], e[4], e[5], e[6]]);
    let low = mix(edge(edges[0]), t[1], edge(edges[1]));
    let high = mix(edge(edges[2]), t[1], edge(edges[3]));
    mix(low, t[2], high)
}

/// The whole number nearest to one below 2^22, as such and as it is; nothing that makes sense for others.
#[inline(always)]
pub fn nearest(x: f32) -> (i32, f32) {
    // Added to such a number this leaves the nearest whole one in the low bits: without a rounding instruction, which the
    // oldest 64-bit machines lack, a cast costs several times as much.
    const MAGIC: f32 = 12_582_912.0;
    let shifted = x + MAGIC;
    ((shifted.to_bits() as i32).wrapping_sub(MAGIC.to_bits() as i32), shifted - MAGIC)
}
