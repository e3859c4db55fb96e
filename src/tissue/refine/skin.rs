//! The skin's pull: elements beside the skin of planning are drawn along its normal to the skin of the fraction.
//!
//! The distance to the skin, negative inside, is compared in both frames: to first order in a further step `d` an element
//! is off by `r - n d` with `r = p - f` and `n` the gradient of the fraction's distance. Along the skin nothing pulls.

use super::SkinOptions;
use crate::chainmail::{Lattice, Pull};
use crate::geometry::Grid;
use crate::volume::signed::{depth, slope, within_edges};
use crate::volume::{Mask, Volume, trilinear};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Distances are known up to this one, mm; differences beyond half of it are couch, mask or clothes, and do not pull.
const KNOWN_MM: f64 = 20.0;
/// Blur of the distances, as a share of the voxels' least edge.
const BLUR: f64 = 1.0;
/// Differences beyond this count less (Huber), mm.
const ROBUST_MM: f64 = 3.0;
/// How well an outline tells where the skin is, one standard deviation, mm.
/// It scales the weight; five times the weight: 0.479 for 0.473 mm without grey values (moderate).
const SD_MM: f64 = 0.5;
/// The skin is not believed within half of this distance from the edge of either scan, and fully from one and a half on, mm.
const EDGE_MM: f64 = 6.0;

/// The skins of both scans.
pub(super) struct Skin {
    planning: Volume<f32>,
    fraction: Volume<f32>,
    weight: f64,
    /// [`EDGE_MM`]
    edge_mm: f64,
}

impl Skin {
    /// From the patient in each scan; `None` where the settings give the skin no weight.
    pub(super) fn new(planning: &Mask, fraction: &Mask, options: &SkinOptions) -> Option<Self> {
        let weight = options.weight;
        let wanted = weight > 0.0;
        wanted.then(|| Self {
            planning: depth(planning, KNOWN_MM, BLUR),
            fraction: depth(fraction, KNOWN_MM, BLUR),
            weight,
            edge_mm: EDGE_MM,
        })
    }

    /// Prepares for a lattice.
    pub(super) fn at(&self, lattice: &Lattice) -> Outline<'_> {
        let edge = lattice.grid.mean_edge();
        let grid = self.planning.grid();
        let beside = |&n: &u32| {
            let rest = lattice.rest(n as usize);
            let depth = trilinear(&self.planning, &grid.index(&rest))?;
            let sure = self.confidence(grid, &rest);
            (depth.abs() < edge && sure > 0.0).then_some((rest, depth, sure))
        };
        let soft: Vec<u32> = lattice.soft().collect();
        let elements = soft.par_iter().map(beside).collect();
        Outline { skin: self, soft, elements, weight: self.weight * edge * edge / SD_MM.powi(2) }
    }

    /// How far the skin is believed at a point of a scan: not at all at the edge of its field of view, where the patient is
    /// cut.
    fn confidence(&self, grid: &Grid, point: &Point3<f64>) -> f64 {
        (within_edges(grid, point) / self.edge_mm - 0.5).clamp(0.0, 1.0)
    }
}

/// The skin for one lattice.
pub(super) struct Outline<'a> {
    skin: &'a Skin,
    /// Soft elements, ascending.
    soft: Vec<u32>,
    /// Of each soft element beside the skin its place at rest, its distance from the skin and how far that is believed.
    elements: Vec<Option<(Point3<f64>, f64, f64)>>,
    weight: f64,
}

impl Outline<'_> {
    /// Adds to the pull on the soft elements `which` at the elements' displacements `u`.
    pub(super) fn add(&self, u: &[[f32; 3]], which: &[u32], pull: &mut Pull) {
        let asked = which.par_iter().map(|&s| {
            let (rest, depth, sure) = self.elements[s as usize].as_ref()?;
            let now = Vector3::from(u[self.soft[s as usize] as usize].map(f64::from));
            let (r, normal, w) = self.asked(&(rest + now), *depth)?;
            Some((r, normal, w * sure * self.weight, now))
        });
        let asked: Vec<_> = asked.collect();
        for (&s, asked) in which.iter().zip(asked) {
            let Some((r, normal, w, now)) = asked else { continue };
            // The quadratic of a further step, about the displacement that the element has.
            let b = normal * (w * (r + normal.dot(&now)));
            for (k, (x, y)) in Pull::ENTRIES.into_iter().enumerate() {
                pull.stiffness[s as usize][k] += (w * normal[x] * normal[y]) as f32;
            }
            (0..3).for_each(|a| pull.towards[s as usize][a] += b[a] as f32);
        }
    }

    /// How far a point must go along which gradient to be as deep in the fraction as it was in planning, and how much that
    /// counts.
    fn asked(&self, point: &Point3<f64>, depth: f64) -> Option<(f64, Vector3<f64>, f64)> {
        let fraction = &self.skin.fraction;
        let grid = fraction.grid();
        let at = grid.index(point);
        let sure = self.skin.confidence(grid, point);
        let r = depth - trilinear(fraction, &at)?;
        if sure <= 0.0 || r.abs() > 0.5 * KNOWN_MM {
            return None;
        }
        let normal = slope(fraction, &at)?;
        Some((r, normal, sure * (ROBUST_MM / r.abs().max(ROBUST_MM))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::{Material, Node};

    /// A ball of this radius about the middle of a cube of 40 mm, and elements of 4 mm inside a ball of 12 mm.
    fn ball(radius: f64) -> Mask {
        let grid = Grid::axis_aligned([41; 3], [1.0; 3], [-20.0; 3]).unwrap();
        Volume::from_fn(grid.clone(), |v| grid.centre(grid.voxel(v)).coords.norm() < radius)
    }

    fn elements() -> Lattice {
        let grid = Grid::axis_aligned([11; 3], [4.0; 3], [-20.0; 3]).unwrap();
        let soft = |n: usize| grid.centre(grid.voxel(n)).coords.norm() < 12.5;
        let node = (0..grid.len()).map(|n| if soft(n) { Node::Soft } else { Node::Outside }).collect();
        let constraint = vec![Material::default().at(40.0); grid.len()];
        Lattice::from_nodes(grid, node, constraint)
    }

    /// With another distance from the edge of the scan: these scenes are small.
    fn believed_from(edge_mm: f64, skin: Option<Skin>) -> Skin {
        Skin { edge_mm, ..skin.unwrap() }
    }

    #[test]
    fn elements_at_the_skin_ask_for_the_way_along_its_normal() {
        let lattice = elements();
        let skin = believed_from(1.0, Skin::new(&ball(12.0), &ball(14.0), &SkinOptions { weight: 1.0 }));
        let outline = skin.at(&lattice);
        let at_rest = vec![[0f32; 3]; lattice.node.len()];
        let mut pull = Pull::none(lattice.soft().count(), 100.0);
        let which: Vec<u32> = (0..pull.towards.len() as u32).collect();
        outline.add(&at_rest, &which, &mut pull);
        let mut pulled = 0;
        for (s, n) in lattice.soft().enumerate() {
            let x = lattice.rest(n as usize).coords;
            let [xx, _, _, yy, _, zz] = pull.stiffness[s];
            if x.norm() < 6.0 {
                assert!(xx + yy + zz < 1e-6, "{x}");
            } else if x.norm() > 11.0 {
                // Held weakly, it goes the 2 mm outwards that the skin has gone.
                let u = pull.settle(s, 0.5, [0.0; 3]);
                let way = Vector3::from(u.map(f64::from));
                assert!((way - x.normalize() * 2.0).norm() < 0.5, "{x}: {way}");
                pulled += 1;
            }
        }
        assert!(pulled > 20, "{pulled}");
    }

    #[test]
    fn the_edge_of_the_scan_and_skins_far_away_do_not_pull() {
        let lattice = elements();
        let at_rest = vec![[0f32; 3]; lattice.node.len()];
        for (fraction, edge_mm) in [(14.0, 40.0), (0.0, 1.0), (90.0, 1.0)] {
            let skin = believed_from(edge_mm, Skin::new(&ball(12.0), &ball(fraction), &SkinOptions { weight: 1.0 }));
            let mut pull = Pull::none(lattice.soft().count(), 100.0);
            let which: Vec<u32> = (0..pull.towards.len() as u32).collect();
            skin.at(&lattice).add(&at_rest, &which, &mut pull);
            assert!(pull.stiffness.iter().flatten().all(|s| s.abs() < 1e-6), "{fraction} {edge_mm}");
        }
        assert!(Skin::new(&ball(12.0), &ball(12.0), &SkinOptions::default()).is_none());
    }

    #[test]
    fn what_is_far_off_counts_less_and_beyond_half_of_what_is_known_nothing() {
        let lattice = elements();
        let asked = |radius: f64| {
            let skin = believed_from(1.0, Skin::new(&ball(12.0), &ball(radius), &SkinOptions { weight: 1.0 }));
            skin.at(&lattice).asked(&Point3::new(12.0, 0.0, 0.0), 0.0)
        };
        let (r, _, near) = asked(14.0).unwrap();
        assert!((r - 2.0).abs() < 0.6 && (near - 1.0).abs() < 1e-9, "{r} {near}");
        let (r, _, far) = asked(18.0).unwrap();
        assert!((r - 6.0).abs() < 0.7 && (far - ROBUST_MM / r).abs() < 1e-9, "{r} {far}");
        assert!(asked(24.0).is_none());
    }
}
