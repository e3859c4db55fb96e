//! The bright ring that truncated projections leave just inside a reconstruction's circle.

use super::circle::CircleFound;
use crate::volume::Volume;

/// Rings of this width are compared, mm.
const RING_MM: f64 = 2.0;
/// Rings up to this depth may be too bright; the next as many millimetres tell what is usual.
const DEEPEST_MM: f64 = 16.0;
/// A ring this much brighter than usual is none to trust, HU.
const BRIGHT_HU: f64 = 60.0;
/// Tissue, HU.
const TISSUE: std::ops::Range<f32> = -300.0..2000.0;
/// Voxels that tell a ring's brightness at least.
const FEWEST: usize = 200;

/// Depth below the circle to which tissue is too bright, mm.
pub(super) fn width(ct: &Volume<f32>, circle: &CircleFound) -> f64 {
    let rings = (DEEPEST_MM / RING_MM) as usize;
    let mut values: Vec<Vec<f32>> = vec![Vec::new(); 2 * rings];
    let grid = ct.grid();
    for (l, hu) in ct.data().iter().enumerate().filter(|(_, hu)| TISSUE.contains(hu)) {
        let ring = circle.depth(grid, grid.voxel(l)) / RING_MM;
        if ring >= 0.0
            && let Some(values) = values.get_mut(ring as usize)
        {
            values.push(*hu);
        }
    }
    let middle = |values: &mut [f32]| {
        let at = values.len() / 2;
        f64::from(*values.select_nth_unstable_by(at, f32::total_cmp).1)
    };
    let mut usual = values.split_off(rings).concat();
    if usual.len() < FEWEST {
        return 0.0;
    }
    let usual = middle(&mut usual);
    let bright = |ring: &mut Vec<f32>| ring.len() >= FEWEST && middle(ring) - usual > BRIGHT_HU;
    // The deepest bright ring counts, and all that lie beyond it.
    let deepest = values.iter_mut().rposition(bright);
    deepest.map_or(0.0, |ring| (ring as f64 + 1.5) * RING_MM)
}
