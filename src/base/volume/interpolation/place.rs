//! Where continuous indices lie between voxels.

use crate::geometry::Grid;

/// Where a continuous index lies along an axis of `size` voxels: the voxel at or below it and the way to the next; `None`
/// outside the hull of the voxel centres.
#[inline(always)]
pub fn place(index: f64, size: usize) -> Option<(usize, f64)> {
    let last = size - 1;
    if !(index >= 0.0 && index <= last as f64) {
        return None;
    }
    let low = (index as usize).min(last);
    Some((low, index - low as f64))
}

/// Between which voxels of `coarse` those of `fine` lie, axis by axis: the one at or below, the next, and the way to it. Both grids
/// share their axes; beyond the outermost voxel centres these are held.
pub fn axis_pairs(coarse: &Grid, fine: &Grid) -> [Vec<(usize, usize, f64)>; 3] {
    let (base, step) = (coarse.index(&fine.origin()), coarse.inverse_step() * fine.step());
    std::array::from_fn(|a| {
        let last = coarse.size()[a] - 1;
        let pair = |i: usize| {
            let at = (base[a] + step[(a, a)] * i as f64).clamp(0.0, last as f64);
            let low = at as usize;
            (low, (low + 1).min(last), at - low as f64)
        };
        (0..fine.size()[a]).map(pair).collect()
    })
}
