//! The walk over a field's rows: where each voxel's displaced place lies in the grid of a source, eight voxels at a time.

use crate::geometry::{Grid, LANES, vectorised};
use crate::volume::Volume;
use crate::volume::interpolation::nearest;
use nalgebra::Vector3;
use rayon::prelude::*;

/// How far outside the hull of the voxel centres an index still counts as on it, voxels: rounding of the field's single
/// precision must not push the outermost voxel outside.
const ROUNDING: f64 = 1e-3;

/// A place between voxels: the lower ones along each axis, which may lie outside the grid, and the way to the upper ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WalkPlace {
    pub(super) low: [i32; 3],
    pub(super) t: [f32; 3],
}

/// [`LANES`] places, axis by axis.
pub(super) struct WalkPlaces {
    pub(super) low: [[i32; LANES]; 3],
    pub(super) t: [[f32; LANES]; 3],
}

impl WalkPlaces {
    #[inline(always)]
    pub(super) fn at(&self, l: usize) -> WalkPlace {
        let (low, t) = (&self.low, &self.t);
        WalkPlace { low: [low[0][l], low[1][l], low[2][l]], t: [t[0][l], t[1][l], t[2][l]] }
    }
}

/// A place inside a grid: storage position of the lower corner, and the way to the upper ones.
pub(super) struct WalkCorner {
    pub(super) base: usize,
    pub(super) t: [f32; 3],
}

/// How places lie in a grid.
pub(super) struct WalkHull {
    size: [usize; 3],
    pub(super) strides: [usize; 3],
    /// Pairs of voxels along each axis.
    pairs: [u32; 3],
    /// The same where positions in storage fit 31 bits, else none.
    pub(super) quick: [u32; 3],
    /// Distances in storage to the upper corners; 0 along an axis of one voxel.
    pub(super) up: [usize; 3],
}

impl WalkHull {
    pub(super) fn new(grid: &Grid) -> Self {
        let (size, strides) = (grid.size(), grid.strides());
        let up = std::array::from_fn(|a| if size[a] > 1 { strides[a] } else { 0 });
        // More voxels along an axis than an image can have: places beyond are looked up the slow way.
        let pairs = size.map(|n| u32::try_from(n - 1).unwrap_or(u32::MAX));
        let quick = if i32::try_from(grid.len()).is_ok() { pairs } else { [0; 3] };
        Self { size, strides, pairs, quick, up }
    }

    /// The corner of a place; `None` outside the hull of the voxel centres.
    #[inline(always)]
    pub(super) fn corner(&self, WalkPlace { low: [i, j, k], t }: WalkPlace) -> Option<WalkCorner> {
        if (i as u32) < self.pairs[0] && (j as u32) < self.pairs[1] && (k as u32) < self.pairs[2] {
            let base = i as usize + j as usize * self.strides[1] + k as usize * self.strides[2];
            return Some(WalkCorner { base, t });
        }
        self.edge(WalkPlace { low: [i, j, k], t })
    }

    /// As [`WalkHull::corner`] where a coordinate may lie on the last voxel, or beyond the hull by rounding.
    #[cold]
    fn edge(&self, WalkPlace { low, mut t }: WalkPlace) -> Option<WalkCorner> {
        let mut base = 0;
        for a in 0..3 {
            let last = self.size[a] as i64 - 1;
            let lower = match i64::from(low[a]) {
                l if l >= 0 && l < last => l,
                l if l == last && f64::from(t[a]) <= ROUNDING => {
                    t[a] = if last > 0 { 1.0 } else { 0.0 };
                    (last - 1).max(0)
                }
                -1 if f64::from(t[a]) >= 1.0 - ROUNDING => {
                    t[a] = 0.0;
                    0
                }
                _ => return None,
            };
            base += lower as usize * self.strides[a];
        }
        Some(WalkCorner { base, t })
    }
}

/// Indices farther than this from a row of voxels are outside of everything.
const FAR: f32 = 1e6;
/// The lower voxel of what is.
const OUTSIDE: i32 = -400_000_000;

/// `value(continuous index in the source)` at every voxel of the displacements' grid, in parallel over rows. Indices that
/// rounding puts outside the hull of the voxel centres are put back on it.
pub(super) fn pulled<T: Send + Default + Clone>(
    v: &Volume<[f32; 3]>,
    source: &Grid,
    value: impl Fn(&Vector3<f64>) -> T + Sync,
) -> Vec<T> {
    let last = Vector3::from(source.size().map(|n| (n - 1) as f64));
    let near = |i: f64, l: f64| {
        let held = i.clamp(0.0, l);
        if (i - held).abs() < ROUNDING { held } else { i }
    };
    let grid = v.grid();
    let [nx, ny, _] = grid.size();
    let base = source.index(&grid.origin());
    let step = source.inverse_step() * grid.step();
    let turn = *source.inverse_step();
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(nx).zip(v.data().par_chunks(nx)).enumerate().for_each(|(row, (out, v))| {
        let start = base + step * Vector3::new(0.0, (row % ny) as f64, (row / ny) as f64);
        let along: Vector3<f64> = step.column(0).into_owned();
        for (i, (o, v)) in out.iter_mut().zip(v).enumerate() {
            let index = start + along * i as f64 + turn * Vector3::from(v.map(f64::from));
            *o = value(&index.zip_map(&last, near));
        }
    });
    out
}

/// As [`pulled`], with places instead of indices, in single precision relative to the row: [`LANES`] voxels at a time.
pub(super) fn walked<T: Send + Default + Clone>(
    v: &Volume<[f32; 3]>,
    source: &Grid,
    value: impl Fn(&WalkPlaces, &mut [T]) + Sync,
) -> Vec<T> {
    let grid = v.grid();
    let [nx, ny, _] = grid.size();
    let base = source.index(&grid.origin());
    let step = source.inverse_step() * grid.step();
    let turn: [[f32; 3]; 3] = std::array::from_fn(|a| std::array::from_fn(|c| source.inverse_step()[(a, c)] as f32));
    let along: [f32; 3] = std::array::from_fn(|a| step[(a, 0)] as f32);
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(nx).zip(v.data().par_chunks(nx)).enumerate().for_each(|(row, (out, v))| {
        vectorised(
            #[inline(always)]
            || {
                // Filled anew for each block: arrays that are returned would be copied more often than computed.
                let mut places = WalkPlaces { low: [[0; LANES]; 3], t: [[0.0; LANES]; 3] };
                for (n, (out, v)) in out.chunks_mut(SPAN).zip(v.chunks(SPAN)).enumerate() {
                    let index = Vector3::new((n * SPAN) as f64, (row % ny) as f64, (row / ny) as f64);
                    let start = (base + step * index).map(|x| x.clamp(-1e8, 1e8));
                    let span = WalkSpan {
                        whole: std::array::from_fn(|a| start[a].floor() as i32),
                        rest: std::array::from_fn(|a| (start[a] - start[a].floor()) as f32),
                        along,
                        turn,
                    };
                    let (blocks, left) = v.as_chunks::<LANES>();
                    let (outs, out_left) = out.as_chunks_mut::<LANES>();
                    for (b, (v, out)) in blocks.iter().zip(outs).enumerate() {
                        span.places(b * LANES, v, &mut places);
                        value(&places, out);
                    }
                    if !left.is_empty() {
                        let mut padded = [[0f32; 3]; LANES];
                        padded[..left.len()].copy_from_slice(left);
                        span.places(blocks.len() * LANES, &padded, &mut places);
                        value(&places, out_left);
                    }
                }
            },
        )
    });
    out
}

/// Voxels that follow each other along a row.
struct WalkSpan {
    /// Index of the first without displacement: whole part and rest.
    whole: [i32; 3],
    rest: [f32; 3],
    /// From one to the next, indices.
    along: [f32; 3],
    /// From displacements to indices.
    turn: [[f32; 3]; 3],
}

impl WalkSpan {
    /// Where the voxels from `first` on lie, given their displacements.
    #[inline(always)]
    fn places(&self, first: usize, v: &[[f32; 3]; LANES], places: &mut WalkPlaces) {
        for a in 0..3 {
            let by = self.turn[a];
            for (l, v) in v.iter().enumerate() {
                let moved = by[0] * v[0] + by[1] * v[1] + by[2] * v[2];
                let x = (self.rest[a] + self.along[a] * (first as i32 + l as i32) as f32) + moved;
                (places.low[a][l], places.t[a][l]) = lower(x, self.whole[a]);
            }
        }
    }
}

/// Voxels of a row that share a starting point in double precision.
const SPAN: usize = 64;

/// The lower voxel and the way from it; what is far off or no number comes to lie far outside.
///
/// Choices are made bit by bit: a branch, which the compiler may make of an `if`, would keep eight voxels from being found at once.
#[inline(always)]
fn lower(x: f32, whole: i32) -> (i32, f32) {
    let mask = |yes: bool| u32::from(yes).wrapping_neg();
    let near = mask(x.abs() < FAR);
    let held = f32::from_bits(x.to_bits() & near);
    let (number, nearest) = nearest(held);
    let above = mask(nearest > held);
    let floor = nearest - f32::from_bits(1f32.to_bits() & above);
    let low = number.wrapping_add(above as i32);
    (low.wrapping_add(whole & near as i32 | OUTSIDE & !near as i32), held - floor)
}
