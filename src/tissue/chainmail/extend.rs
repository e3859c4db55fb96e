//! Continuation of the field beyond the elements: every reader interpolates at the skin, so the field must be smooth
//! some way out and fade to the identity.

use super::lattice::Lattice;
use crate::geometry::stencil::NEIGHBOURS_26;
use rayon::prelude::*;

/// Distance from the patient over which the field is continued unchanged, mm: as far as readers interpolate.
const KEEP_MM: f64 = 8.0;
/// Least distance over which it then fades to the motion of the couch, mm: zero in the frame of this room.
/// At 12 mm the fields of moderate take 83.9 MB for 87.6, and no less time.
const FADE_MM: f64 = 20.0;
/// Distance over which a displacement fades, as a multiple of its own length.
/// With [`EASE`] the slope is 0.74 at most; at 1 the field would fold.
const FADE: f64 = 1.6;
/// Share of that distance over which the slope grows, and falls again: it stays below 3/4, and the field one to one.
const EASE: f64 = 0.15;

/// Continues the known displacements over the lattice and fades them with the distance from where they are known or `inside`
/// the patient, whose cavities move with what is around them.
pub fn extend(lattice: &Lattice, known: &[Option<[f32; 3]>], inside: impl Fn(usize) -> bool + Sync) -> Vec<[f32; 3]> {
    // How far a displacement has faded at a distance.
    let faded = |u: &[f32; 3], d: f32| {
        let length = f64::from(u.iter().map(|v| v * v).sum::<f32>().sqrt());
        (f64::from(d) - KEEP_MM) / (fades_within(length) - KEEP_MM)
    };
    let (mut out, far) = fill(lattice, known, inside, |_, u, d| faded(u, d) < 1.0);
    for (u, &d) in out.iter_mut().zip(&far) {
        let keep = 1.0 - ramp(faded(u, d));
        *u = u.map(|v| v * keep as f32);
    }
    out
}

/// Distance from the patient at which a displacement of this length has faded, mm.
pub fn fades_within(length: f64) -> f64 {
    KEEP_MM + FADE_MM.max(FADE * length)
}

/// From 0 at 0 to 1 at 1, straight but for its ends.
fn ramp(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    let end = t.min(1.0 - t);
    let risen = if end < EASE { end * end / (2.0 * EASE) } else { end - EASE / 2.0 } / (1.0 - EASE);
    if t < 0.5 { risen } else { 1.0 - risen }
}

/// Fills nodes without a displacement, layer by layer, with the mean of their filled neighbours, weighted by inverse length,
/// as long as `wanted` tells so of the layer (from 0), of what they would get and of their distance (mm, along links) from the
/// nearest node that is known or `near`. Returns displacements and distances; where nothing was filled 0 and infinity.
pub fn fill(
    lattice: &Lattice,
    known: &[Option<[f32; 3]>],
    near: impl Fn(usize) -> bool + Sync,
    wanted: impl Fn(usize, &[f32; 3], f32) -> bool,
) -> (Vec<[f32; 3]>, Vec<f32>) {
    let size = lattice.grid.size();
    let links = lattice.links();
    let mut out: Vec<[f32; 3]> = known.iter().map(|u| u.unwrap_or_default()).collect();
    let mut far: Vec<f32> = known.iter().map(|u| if u.is_some() { 0.0 } else { f32::INFINITY }).collect();
    let inside = |at: [usize; 3], o: [i32; 3]| -> Option<usize> {
        let mut n = [0; 3];
        for a in 0..3 {
            n[a] = at[a].checked_add_signed(o[a] as isize).filter(|&v| v < size[a])?;
        }
        Some(lattice.grid.linear(n))
    };
    let mut layer: Vec<usize> = Vec::new();
    let mut queued = vec![false; out.len()];
    let mut next_layer = |from: &mut dyn Iterator<Item = usize>, far: &[f32]| {
        let mut next = Vec::new();
        for n in from {
            let at = lattice.grid.voxel(n);
            for o in NEIGHBOURS_26 {
                if let Some(m) = inside(at, o)
                    && far[m].is_infinite()
                    && !queued[m]
                {
                    queued[m] = true;
                    next.push(m);
                }
            }
        }
        next.sort_unstable();
        next
    };
    layer.extend(next_layer(&mut (0..known.len()).filter(|&n| known[n].is_some()), &far));
    for depth in 0.. {
        if layer.is_empty() {
            break;
        }
        let filled: Vec<([f32; 3], f32)> = layer
            .par_iter()
            .map(|&n| {
                let at = lattice.grid.voxel(n);
                let (mut sum, mut weights, mut nearest) = ([0f32; 3], 0f32, f32::INFINITY);
                let apart = if near(n) { 0.0 } else { 1.0 };
                for (o, l) in NEIGHBOURS_26.iter().zip(&links) {
                    let Some(m) = inside(at, *o) else { continue };
                    if far[m].is_infinite() {
                        continue;
                    }
                    let mm = l.norm() as f32;
                    nearest = nearest.min(far[m] + apart * mm);
                    weights += 1.0 / mm;
                    for a in 0..3 {
                        sum[a] += out[m][a] / mm;
                    }
                }
                (sum.map(|s| s / weights), nearest)
            })
            .collect();
        let mut last = Vec::with_capacity(layer.len());
        for (&n, (u, d)) in layer.iter().zip(filled) {
            if wanted(depth, &u, d) {
                (out[n], far[n]) = (u, d);
                last.push(n);
            }
        }
        layer = next_layer(&mut last.into_iter(), &far);
    }
    (out, far)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;

    #[test]
    fn the_ramp_is_smooth_and_nowhere_too_steep() {
        assert_eq!([ramp(-1.0), ramp(0.0), ramp(1.0), ramp(7.0)], [0.0, 0.0, 1.0, 1.0]);
        let h = 1e-4;
        for n in 0..10_000 {
            let t = f64::from(n) * h;
            let slope = (ramp(t + h) - ramp(t)) / h;
            assert!((0.0..0.75 * FADE).contains(&slope), "{t}: {slope}");
            assert!((ramp(t) + ramp(1.0 - t) - 1.0).abs() < 1e-12);
        }
    }
}
