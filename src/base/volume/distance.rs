//! Exact Euclidean distance in mm on anisotropic grids.
//!
//! The squared distance to a set separates by axes: the distance along lines of one axis, then for the two
//! others the lower envelope of parabolas (Felzenszwalb and Huttenlocher, Theory of Computing 8, 2012).
//! Where only distances up to a radius matter, a window of that radius replaces the envelope.

use super::{Mask, Volume};
use crate::geometry::vectorised;
use rayon::prelude::*;

/// Lines that are gathered together, so that a cache line read across the storage order is used whole.
const BLOCK: usize = 16;

/// Squared distance in mm^2 from each voxel's centre to the nearest centre of a voxel whose value is `target`.
///
/// Infinite everywhere when no voxel has that value. Exact up to `f32` rounding.
pub fn squared_distance(mask: &Mask, target: bool) -> Volume<f32> {
    let spacing = mask.grid().spacing();
    let mut out = along_i(mask, target);
    for axis in [1, 2] {
        for_each_plane(&mut out, axis, |rows| envelope_rows(rows, spacing[axis]));
    }
    out
}

/// As [`squared_distance`], but exact only up to `limit` mm; beyond it the value is larger than `limit` squared.
pub fn squared_distance_within(mask: &Mask, target: bool, limit: f64) -> Volume<f32> {
    let spacing = mask.grid().spacing();
    let mut out = along_i(mask, target);
    for axis in [1, 2] {
        let reach = (limit / spacing[axis] + 1e-9) as usize;
        for_each_plane(&mut out, axis, |rows| {
            vectorised(
                #[inline(always)]
                || window_rows(rows, spacing[axis], reach),
            );
        });
    }
    out
}

/// The label (not 0) of the nearest labelled voxel centre; 0 everywhere when there is none. Exact up to rounding; of
/// equally near labels the one that comes first along the last axis, then the second, then the first.
pub fn nearest_label(labels: &Volume<u16>) -> Volume<u16> {
    let grid = labels.grid();
    let mut square = along_i(&labels.map(|&l| l != 0), true);
    let mut out = labels.clone();
    let ni = grid.size()[0];
    out.data_mut().par_chunks_mut(ni).zip(labels.data().par_chunks(ni)).for_each(|(line, set)| nearest_in(line, set));
    for axis in [1, 2] {
        let mut planes = planes_of(&mut out, axis);
        for_each_plane_with(&mut square, axis, &mut planes, |rows, labels| {
            label_rows(rows, labels, grid.spacing()[axis]);
        });
    }
    out
}

/// Each voxel takes the nearest label of its own line, of two the one before it.
fn nearest_in(line: &mut [u16], set: &[u16]) {
    let mut last: Option<usize> = None;
    for n in 0..set.len() {
        if set[n] == 0 {
            continue;
        }
        match last {
            None => line[..n].fill(set[n]),
            Some(l) => {
                let middle = usize::midpoint(l, n) + 1;
                line[l..middle].fill(set[l]);
                line[middle..n].fill(set[n]);
            }
        }
        last = Some(n);
    }
    if let Some(l) = last {
        line[l..].fill(set[l]);
    }
}

/// Squared distances along lines of the first axis.
fn along_i(mask: &Mask, target: bool) -> Volume<f32> {
    let [ni, ..] = mask.grid().size();
    let step = mask.grid().spacing()[0] as f32;
    let mut out = Volume::filled(mask.grid().clone(), f32::INFINITY);
    out.data_mut().par_chunks_mut(ni).zip(mask.data().par_chunks(ni)).for_each(|(line, set)| {
        let mut steps = f32::INFINITY;
        for (d, &s) in line.iter_mut().zip(set) {
            steps = if s == target { 0.0 } else { steps + 1.0 };
            *d = steps;
        }
        steps = f32::INFINITY;
        for (d, &s) in line.iter_mut().zip(set).rev() {
            steps = if s == target { 0.0 } else { steps + 1.0 };
            *d = (d.min(steps) * step).powi(2);
        }
    });
    out
}

/// Calls `work` with the rows (along the first axis) of every plane that contains the first axis and `axis`.
fn for_each_plane(volume: &mut Volume<f32>, axis: usize, work: impl Fn(&mut [&mut [f32]]) + Sync) {
    planes_of(volume, axis).par_iter_mut().for_each(|rows| work(rows));
}

/// As [`for_each_plane`], with the same planes of a second volume.
fn for_each_plane_with<T: Send>(
    volume: &mut Volume<f32>,
    axis: usize,
    other: &mut [Vec<&mut [T]>],
    work: impl Fn(&mut [&mut [f32]], &mut [&mut [T]]) + Sync,
) {
    planes_of(volume, axis).par_iter_mut().zip(other).for_each(|(rows, others)| work(rows, others));
}

/// The rows (along the first axis) of every plane that contains the first axis and `axis`.
fn planes_of<T: Clone>(volume: &mut Volume<T>, axis: usize) -> Vec<Vec<&mut [T]>> {
    let [ni, nj, nk] = volume.grid().size();
    let mut planes: Vec<Vec<&mut [T]>> = Vec::new();
    planes.resize_with(if axis == 1 { nk } else { nj }, Vec::new);
    for (n, row) in volume.data_mut().chunks_mut(ni).enumerate() {
        planes[if axis == 1 { n / nj } else { n % nj }].push(row);
    }
    planes
}

/// Least of own and shifted rows within `reach` rows.
#[inline(always)]
fn window_rows(rows: &mut [&mut [f32]], step: f64, reach: usize) {
    let Some(ni) = rows.first().map(|r| r.len()) else { return };
    let mut source = vec![f32::INFINITY; rows.len() * ni];
    for (s, row) in source.chunks_mut(ni).zip(rows.iter()) {
        s.copy_from_slice(row);
    }
    for (n, row) in rows.iter_mut().enumerate() {
        for m in n.saturating_sub(reach)..(n + reach + 1).min(source.len() / ni) {
            let far = ((m.abs_diff(n) as f64) * step).powi(2) as f32;
            for (d, s) in row.iter_mut().zip(&source[m * ni..(m + 1) * ni]) {
                let there = s + far;
                *d = if there < *d { there } else { *d };
            }
        }
    }
}

/// Lower envelope of parabolas along the direction across the rows.
fn envelope_rows(rows: &mut [&mut [f32]], step: f64) {
    let n = rows.len();
    let Some(ni) = rows.first().map(|r| r.len()) else { return };
    let mut lines = vec![0.0f32; BLOCK * n];
    let mut hull = Hull { at: vec![0; n], from: vec![0.0; n] };
    for first in (0..ni).step_by(BLOCK) {
        let width = BLOCK.min(ni - first);
        for (q, row) in rows.iter().enumerate() {
            for (b, v) in row[first..first + width].iter().enumerate() {
                lines[b * n + q] = *v;
            }
        }
        for (b, line) in lines.chunks(n).take(width).enumerate() {
            hull.minimum(line, step, |q, v, _| rows[q][first + b] = v);
        }
    }
}

/// As [`envelope_rows`]; each voxel also takes the label that its nearest row has there.
fn label_rows(rows: &mut [&mut [f32]], labels: &mut [&mut [u16]], step: f64) {
    let n = rows.len();
    let Some(ni) = rows.first().map(|r| r.len()) else { return };
    let mut hull = Hull { at: vec![0; n], from: vec![0.0; n] };
    let (mut line, mut label) = (vec![0.0f32; n], vec![0u16; n]);
    for i in 0..ni {
        for q in 0..n {
            (line[q], label[q]) = (rows[q][i], labels[q][i]);
        }
        hull.minimum(&line, step, |q, v, p| (rows[q][i], labels[q][i]) = (v, label[p]));
    }
}

/// Parabolas of the lower envelope: their vertex, and where each becomes the lowest.
struct Hull {
    at: Vec<usize>,
    from: Vec<f64>,
}

impl Hull {
    /// Calls `set(q, min over p of line[p] + (step (q - p))^2, p)` for every position `q` of the line.
    fn minimum(&mut self, line: &[f32], step: f64, mut set: impl FnMut(usize, f32, usize)) {
        let square = step * step;
        let height = |p: usize| f64::from(line[p]) / square + (p * p) as f64;
        let mut count = 0;
        for p in (0..line.len()).filter(|&p| line[p].is_finite()) {
            let mut start = f64::NEG_INFINITY;
            while count > 0 {
                let last = self.at[count - 1];
                start = (height(p) - height(last)) / (2.0 * (p - last) as f64);
                if start > self.from[count - 1] {
                    break;
                }
                count -= 1;
                start = f64::NEG_INFINITY;
            }
            self.at[count] = p;
            self.from[count] = start;
            count += 1;
        }
        if count == 0 {
            return;
        }
        let mut n = 0;
        for q in 0..line.len() {
            while n + 1 < count && self.from[n + 1] < q as f64 {
                n += 1;
            }
            let p = self.at[n];
            set(q, (f64::from(line[p]) + (p.abs_diff(q) as f64).powi(2) * square) as f32, p);
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::geometry::Grid;
    use proptest::prelude::*;

    /// Squared distance to the target by looking at every pair.
    pub(in crate::volume) fn brute(mask: &Mask, target: bool) -> Vec<f64> {
        let g = mask.grid();
        let targets: Vec<_> =
            (0..g.len()).filter(|&l| mask.data()[l] == target).map(|l| g.centre(g.voxel(l))).collect();
        let nearest =
            |l: usize| targets.iter().map(|t| (t - g.centre(g.voxel(l))).norm_squared()).fold(f64::INFINITY, f64::min);
        (0..g.len()).map(nearest).collect()
    }

    pub(in crate::volume) fn scene() -> impl Strategy<Value = Mask> {
        let size = prop::array::uniform3(1usize..9);
        (size, prop::array::uniform3(0.4f64..4.0), any::<u64>(), 1u64..40).prop_map(|(size, spacing, seed, every)| {
            let grid = Grid::axis_aligned(size, spacing, [0.0; 3]).unwrap();
            let mut state = seed | 1;
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33).is_multiple_of(every)
            };
            let values = (0..grid.len()).map(|_| next()).collect();
            Volume::new(grid, values).unwrap()
        })
    }

    #[test]
    fn the_nearest_label_is_the_nearest_by_brute_force() {
        let grid = Grid::axis_aligned([9, 8, 7], [1.0, 1.7, 2.9], [0.0; 3]).unwrap();
        let seeds = [([1, 2, 1], 3u16), ([7, 6, 5], 9), ([8, 0, 3], 4), ([0, 7, 6], 7)];
        let mut labels = Volume::filled(grid.clone(), 0u16);
        for (at, l) in seeds {
            labels.data_mut()[grid.linear(at)] = l;
        }
        let out = nearest_label(&labels);
        for n in 0..grid.len() {
            let far = |at: [usize; 3]| (grid.centre(at) - grid.centre(grid.voxel(n))).norm();
            let least = seeds.iter().map(|s| far(s.0)).fold(f64::MAX, f64::min);
            let own = seeds.iter().find(|s| s.1 == out.data()[n]).unwrap();
            assert!(far(own.0) < least + 1e-5, "voxel {n}");
        }
        assert!(nearest_label(&Volume::filled(grid, 0u16)).data().iter().all(|&l| l == 0));
    }

    proptest! {
        #[test]
        fn equals_brute_force(mask in scene(), target in any::<bool>(), limit in 0.5f64..12.0) {
            let exact = brute(&mask, target);
            for (&e, &d) in exact.iter().zip(squared_distance(&mask, target).data()) {
                let d = f64::from(d);
                prop_assert!((e.is_infinite() && d.is_infinite()) || (e - d).abs() <= 1e-5 * e);
            }
            for (&e, &d) in exact.iter().zip(squared_distance_within(&mask, target, limit).data()) {
                let d = f64::from(d);
                let right = if e <= limit * limit { (e - d).abs() <= 1e-5 * e } else { d >= e * (1.0 - 1e-5) };
                prop_assert!(right, "{e} {d}");
            }
        }
    }
}
