//! The inverse by Newton's method from good starts, eight voxels of a row at a time: value and gradient of the field from the
//! same eight corners, in single precision, whose error of about 1e-5 mm is far below any tolerance.
//!
//! One voxel after the other each step would wait for the one before it.

use super::PushField;
use super::walk::lower;
use crate::error::Result;
use crate::geometry::wide_vector::{WideVector, cross, dot, minus, plus};
use crate::geometry::{Grid, LANES, Wide};
use crate::volume::{Mask, Volume};
use nalgebra::Vector3;

/// The position in storage of what lies outside the grid.
pub(super) const NOWHERE: usize = usize::MAX;

/// Determinants of the map's gradient below this are too close to a fold.
const LEAST_DETERMINANT: f32 = 0.05;

/// A field that is continued by its edge values, with the constants of its grid at hand.
pub(super) struct Sampler<'a> {
    field: &'a Volume<[f32; 3]>,
    last: [i32; 3],
    /// Lower neighbour of the last pair of voxels.
    most: [i32; 3],
    strides: [usize; 3],
    /// Distances in storage to the upper corners; 0 along an axis of one voxel.
    up: [usize; 3],
    /// World to index, row by row.
    turn: [[f32; 3]; 3],
}

/// [`LANES`] places that follow each other in a row, as indices of the field's grid: whole part and rest of the first, and the
/// way from one to the next.
pub(super) struct Block {
    whole: [i32; 3],
    rest: [f32; 3],
    along: [f32; 3],
}

/// Values of the field at places, and its derivative by the index: one column per axis.
struct Sample {
    value: WideVector,
    slope: [WideVector; 3],
}

/// What the search has found for [`LANES`] voxels.
pub(super) struct Best {
    /// The best displacements, mm.
    pub(super) v: WideVector,
    /// |v + u(y + v)|, mm; infinite where that is no number.
    pub(super) residual: Wide,
}

impl<'a> Sampler<'a> {
    pub(super) fn new(field: &'a Volume<[f32; 3]>) -> Self {
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
    pub(super) fn block(start: &Vector3<f64>, along: &Vector3<f64>) -> Block {
        // What is no number becomes 0, and what is far off is held far outside.
        let held = start.map(|x| x.clamp(-1e8, 1e8));
        Block {
            whole: std::array::from_fn(|a| held[a].floor() as i32),
            rest: std::array::from_fn(|a| (held[a] - held[a].floor()) as f32),
            along: std::array::from_fn(|a| along[a] as f32),
        }
    }

    /// The voxels nearest to where displacements lead, by their position in storage; [`NOWHERE`] outside the grid.
    #[inline(always)]
    pub(super) fn land(&self, block: &Block, v: &WideVector) -> [usize; LANES] {
        let (mut near, mut within) = ([0u64; LANES], [true; LANES]);
        for a in 0..3 {
            let by = self.turn[a];
            let (least, most) = ((-block.whole[a]) as f32, (self.last[a] - block.whole[a]) as f32);
            let stride = self.strides[a] as u32;
            for l in 0..LANES {
                let moved = by[0] * v[0].0[l] + by[1] * v[1].0[l] + by[2] * v[2].0[l];
                let x = (block.rest[a] + block.along[a] * l as f32) + moved;
                within[l] &= (x >= least) & (x <= most);
                let (voxel, _) = lower(x + 0.5, block.whole[a]);
                near[l] = near[l].wrapping_add(u64::from(voxel as u32) * u64::from(stride));
            }
        }
        let mut out = [NOWHERE; LANES];
        for l in 0..LANES {
            out[l] = if within[l] { near[l] as usize } else { NOWHERE };
        }
        out
    }

    /// Searches `v` with `v + u(y + v) = 0` within `tolerance` mm for the places `y` of a block, in at most `steps` steps.
    #[inline(always)]
    pub(super) fn invert(&self, block: &Block, start: WideVector, (tolerance, steps): (f32, usize)) -> Best {
        let mut v = start;
        let mut best = Best { v, residual: Wide::all(f32::INFINITY) };
        for step in 0..=steps {
            let sample = self.at(block, &v);
            let r = plus(&v, &sample.value);
            let size = dot(&r, &r).sqrt();
            let mut open = false;
            for l in 0..LANES {
                let better = size.0[l] < best.residual.0[l];
                best.residual.0[l] = if better { size.0[l] } else { best.residual.0[l] };
                for (best, v) in best.v.iter_mut().zip(&v) {
                    best.0[l] = if better { v.0[l] } else { best.0[l] };
                }
                open |= best.residual.0[l] >= tolerance;
            }
            if !open || step == steps {
                break;
            }
            let by = self.step(&sample.slope, &r);
            // A step is kept short, so that it stays in its basin.
            let length = dot(&by, &by).sqrt();
            for l in 0..LANES {
                let longest = 2.0 * size.0[l];
                let share = if length.0[l] > longest { longest / length.0[l] } else { 1.0 };
                // A voxel that has arrived stays, whatever its neighbours still need.
                let share = if best.residual.0[l] < tolerance { 0.0 } else { share };
                for (v, by) in v.iter_mut().zip(&by) {
                    v.0[l] -= share * by.0[l];
                }
            }
        }
        best
    }

    /// The field's values at the places of a block after displacements `v`.
    #[inline(always)]
    pub(super) fn value(&self, block: &Block, v: &WideVector) -> WideVector {
        self.at(block, v).value
    }

    /// The field at the places of a block after displacements `v`.
    #[inline(always)]
    fn at(&self, block: &Block, v: &WideVector) -> Sample {
        let (mut base, mut t, mut free) = ([0usize; LANES], [Wide::default(); 3], [Wide::default(); 3]);
        for a in 0..3 {
            let by = self.turn[a];
            let (least, most) = ((-block.whole[a]) as f32, (self.last[a] - block.whole[a]) as f32);
            for (l, base) in base.iter_mut().enumerate() {
                let moved = by[0] * v[0].0[l] + by[1] * v[1].0[l] + by[2] * v[2].0[l];
                let x = (block.rest[a] + block.along[a] * l as f32) + moved;
                // What is no number comes to lie at the edge.
                let held = if x > least { x } else { least };
                let held = if held < most { held } else { most };
                // Beyond the edge the field does not change.
                free[a].0[l] = if (least..=most).contains(&x) { 1.0 } else { 0.0 };
                let (low, rest) = lower(held, block.whole[a]);
                let cell = low.min(self.most[a]).max(0);
                t[a].0[l] = (rest + (low - cell) as f32).clamp(0.0, 1.0);
                *base += cell as usize * self.strides[a];
            }
        }
        let ((a, ax, ay), (b, bx, by)) = (self.face(&base, 0, &t), self.face(&base, self.up[2], &t));
        let z = minus(&b, &a);
        let x = between(&ax, t[2], &minus(&bx, &ax));
        let y = between(&ay, t[2], &minus(&by, &ay));
        Sample { value: between(&a, t[2], &z), slope: [times(&x, free[0]), times(&y, free[1]), times(&z, free[2])] }
    }

    /// Values on the lower or upper faces of the cells that begin at `base`, and their derivatives by the first two indices.
    #[inline(always)]
    fn face(&self, base: &[usize; LANES], offset: usize, t: &WideVector) -> (WideVector, WideVector, WideVector) {
        let (a, b) = self.pairs(base, offset);
        let (c, d) = self.pairs(base, offset + self.up[1]);
        let (low, high) = (minus(&b, &a), minus(&d, &c));
        let (a, c) = (between(&a, t[0], &low), between(&c, t[0], &high));
        let across = minus(&c, &a);
        (between(&a, t[1], &across), between(&low, t[1], &minus(&high, &low)), across)
    }

    /// The voxels `offset` behind those of `base`, and the next ones along the first axis.
    #[inline(always)]
    fn pairs(&self, base: &[usize; LANES], offset: usize) -> (WideVector, WideVector) {
        let mut in_line = self.up[0] == 1;
        for (l, place) in base.iter().enumerate() {
            in_line &= *place == base[0] + l;
        }
        if in_line
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

    /// The Newton steps for residuals: the map's gradient, turned round; near a fold the residual takes its place.
    #[inline(always)]
    fn step(&self, slope: &[WideVector; 3], r: &WideVector) -> WideVector {
        // Columns of the gradient by world position.
        let mut by = [[Wide::default(); 3]; 3];
        for (c, column) in by.iter_mut().enumerate() {
            for (a, entry) in column.iter_mut().enumerate() {
                let turn = [Wide::all(self.turn[0][c]), Wide::all(self.turn[1][c]), Wide::all(self.turn[2][c])];
                *entry = slope[0][a] * turn[0] + slope[1][a] * turn[1] + slope[2][a] * turn[2];
            }
            column[c] = column[c] + Wide::all(1.0);
        }
        let [a, b, c] = &by;
        let bc = cross(b, c);
        let determinant = dot(a, &bc);
        let solved = [dot(r, &bc), dot(r, &cross(c, a)), dot(r, &cross(a, b))];
        let mut out = *r;
        for l in 0..LANES {
            let upright = determinant.0[l] >= LEAST_DETERMINANT;
            let scale = if upright { determinant.0[l].recip() } else { 0.0 };
            for a in 0..3 {
                out[a].0[l] = if upright { solved[a].0[l] * scale } else { r[a].0[l] };
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

/// The field at every few voxels, about `spacing` mm apart: enough to start an inversion from.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub(super) fn thinned(push: &PushField, spacing: f64) -> Result<PushField> {
    let grid = push.displacement.grid();
    let stride = grid.spacing().map(|s| ((spacing / s + 1e-6) as usize).max(1));
    let last = grid.size().map(|n| n - 1);
    let size = std::array::from_fn(|a| last[a].div_ceil(stride[a]) + 1);
    let coarse: [f64; 3] = std::array::from_fn(|a| grid.spacing()[a] * stride[a] as f64);
    let thin = Grid::new(size, coarse, grid.origin(), *grid.direction())?;
    let from = |n: usize| {
        let at = thin.voxel(n);
        grid.linear(std::array::from_fn(|a| (at[a] * stride[a]).min(last[a])))
    };
    let displacement = Volume::from_fn(thin.clone(), |n| push.displacement.data()[from(n)]);
    let computed: Mask = Volume::from_fn(thin.clone(), |n| push.computed.data()[from(n)]);
    Ok(PushField { displacement, computed })
}
