//! Structures that guide: the surface of a structure in planning is drawn to its outline in the fraction.
//!
//! As controlling regions in ANACONDA (Weistrand and Svensson, Med. Phys. 42, 2015), by signed distances: a point of an element
//! whose depth in planning's structure is `p` must come to where the fraction's depth `f` is the same. To first order in a further
//! step `d` it is off by `r - n d` with `r = p - f` and `n` the gradient of `f`. Along the surface nothing pulls: there, and
//! inside, the elements' links decide. The pull is as firm as links are; what images ask departs from it.

use crate::chainmail::{Lattice, Pull, Quadratic};
use crate::volume::signed::{depth, slope, within_edges};
use crate::volume::{AROUND_MM, Outline, Volume, trilinear};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Stiffness of a surface, where soft tissue's links have 17 together along an axis.
/// A ball of 11 ml that grows by half errs by 0.58 mm without, 0.29, 0.13 and 0.13 mm at 30, 100 and 300; tissue 10 to 40 mm away by
/// 0.061, 0.060, 0.062 and 0.064.
const STIFFNESS: f64 = 100.0;
/// Points so near the surface pull, as a share of the elements' spacing, the nearest most.
/// At 0.25, 1 and 2 that ball errs by 0.24, 0.12 and 0.24 mm, tissue within 10 mm of it by 0.16, 0.11 and 0.39 for 0.10.
const BAND: f64 = 0.5;
/// Blur of the depths, as a share of the voxels' least edge: thin structures of coarse voxels vanish in more.
const BLUR: f64 = 0.5;
/// So near to the edge of a scan a surface is not believed, mm.
pub const UNBELIEVED_MM: f64 = 3.0;
/// So near to the edge of a scan it is not believed fully, mm.
pub const DOUBTED_MM: f64 = 9.0;

/// How outlines of both scans pull.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GuideOptions {
    /// Weight of the outlines against the chain mail's elasticity; 0 for none: then they only measure.
    pub weight: f64,
    /// The structures that guide; all that both scans outline where none is named.
    pub names: Vec<String>,
}

impl Default for GuideOptions {
    fn default() -> Self {
        Self { weight: 1.0, names: Vec::new() }
    }
}

/// Structures that both scans outline.
pub struct Guides {
    surfaces: Vec<Guide>,
    weight: f64,
}

/// Depths of one structure in both scans, mm.
struct Guide {
    planning: Volume<f32>,
    fraction: Volume<f32>,
}

/// Depth in a structure, mm, negative inside, on the grid of its mask: as its voxels say, without blur.
pub fn depth_in(outline: &Outline) -> Volume<f32> {
    depth(&outline.inside, AROUND_MM, 0.0)
}

impl Guides {
    /// Of pairs of outlines, planning's first; `None` where there are none or they have no weight.
    pub fn new(pairs: &[(Outline, Outline)], options: &GuideOptions) -> Option<Self> {
        let wanted = !pairs.is_empty() && options.weight > 0.0;
        let guide = |(planning, fraction): &(Outline, Outline)| Guide {
            planning: depth(&planning.inside, AROUND_MM, BLUR),
            fraction: depth(&fraction.inside, AROUND_MM, BLUR),
        };
        wanted.then(|| Self { surfaces: pairs.iter().map(guide).collect(), weight: options.weight })
    }

    /// Prepares for a lattice.
    pub(super) fn at(&self, lattice: &Lattice) -> GuidedLattice<'_> {
        let edge = lattice.grid.mean_edge();
        let band = BAND * edge;
        let offsets = lattice.grid.eighths();
        let soft: Vec<u32> = lattice.soft().collect();
        let of_element = |&n: &u32| {
            let rest = lattice.rest(n as usize);
            let points = offsets.iter().enumerate().flat_map(|(o, offset)| {
                let at = rest + offset;
                self.surfaces.iter().enumerate().filter_map(move |(guide, surface)| {
                    let grid = surface.planning.grid();
                    let depth = trilinear(&surface.planning, &grid.index(&at))?;
                    let near = (1.0 - depth.abs() / band).max(0.0) * believed(&surface.planning, &at);
                    (near > 0.0).then_some(GuidedPoint { offset: o, guide, depth, weight: near })
                })
            });
            points.collect::<Vec<_>>()
        };
        let points: Vec<Vec<GuidedPoint>> = soft.par_iter().map(of_element).collect();
        let rest = soft.iter().map(|&n| lattice.rest(n as usize)).collect();
        let weight = STIFFNESS * self.weight / offsets.len() as f64;
        GuidedLattice { guides: self, soft, rest, offsets, points, weight, reach: edge }
    }
}

/// How far a surface is believed at a point of its scan: not at all at the edge, where the structure is cut.
fn believed(surface: &Volume<f32>, at: &Point3<f64>) -> f64 {
    ((within_edges(surface.grid(), at) - UNBELIEVED_MM) / (DOUBTED_MM - UNBELIEVED_MM)).clamp(0.0, 1.0)
}

/// A point of an element beside a surface.
struct GuidedPoint {
    /// Which point of the element.
    offset: usize,
    /// Which structure.
    guide: usize,
    /// In planning's structure, mm.
    depth: f64,
    weight: f64,
}

/// The outlines for one lattice.
pub(super) struct GuidedLattice<'a> {
    guides: &'a Guides,
    /// Soft elements, ascending.
    soft: Vec<u32>,
    /// Where each is at rest.
    rest: Vec<Point3<f64>>,
    offsets: [Vector3<f64>; 8],
    /// Of each soft element.
    points: Vec<Vec<GuidedPoint>>,
    weight: f64,
    /// Farthest that a point asks to go, mm: normals turn on the way.
    reach: f64,
}

impl GuidedLattice<'_> {
    /// Renews the firm pull on the soft elements `which` at the elements' displacements `u`.
    pub(super) fn renew(&self, u: &[[f32; 3]], which: &[u32], pull: &mut Pull) {
        pull.firm.resize(self.soft.len(), Quadratic::default());
        let renewed: Vec<Quadratic> = which.par_iter().map(|&s| self.element(s as usize, u)).collect();
        which.iter().zip(renewed).for_each(|(&s, new)| pull.firm[s as usize] = new);
    }

    /// What its points ask of soft element `s`.
    fn element(&self, s: usize, u: &[[f32; 3]]) -> Quadratic {
        if self.points[s].is_empty() {
            return Quadratic::default();
        }
        let now = Vector3::from(u[self.soft[s] as usize].map(f64::from));
        let (mut a, mut b) = ([0f64; 6], Vector3::zeros());
        for point in &self.points[s] {
            let Some((r, normal, sure)) = self.asked(point, &(self.rest[s] + now + self.offsets[point.offset])) else {
                continue;
            };
            let w = self.weight * point.weight * sure;
            // The quadratic of a further step, about the displacement that the element has.
            b += normal * (w * (r + normal.dot(&now)));
            for (k, (x, y)) in Pull::ENTRIES.into_iter().enumerate() {
                a[k] += w * normal[x] * normal[y];
            }
        }
        Quadratic { stiffness: a.map(|v| v as f32), towards: std::array::from_fn(|c| b[c] as f32) }
    }

    /// How far a point that is now `at` must go along which gradient, and how much that counts.
    fn asked(&self, point: &GuidedPoint, at: &Point3<f64>) -> Option<(f64, Vector3<f64>, f64)> {
        let fraction = &self.guides.surfaces[point.guide].fraction;
        let index = fraction.grid().index(at);
        let r = (point.depth - trilinear(fraction, &index)?).clamp(-self.reach, self.reach);
        let sure = believed(fraction, at);
        (sure > 0.0).then_some(())?;
        Some((r, slope(fraction, &index)?, sure))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::{Material, Node};
    use crate::geometry::Grid;

    fn ball(radius: f64, centre: [f64; 3]) -> Outline {
        // Voxels much smaller than elements: of few points, steps of an outline would turn the normals.
        let grid = Grid::axis_aligned([161; 3], [0.5; 3], [-40.0; 3]).unwrap();
        let inside = |n: usize| (grid.centre(grid.voxel(n)) - Point3::from(centre)).norm() < radius;
        Outline::of("gland", &Volume::from_fn(grid.clone(), inside), |v| v).unwrap()
    }

    fn elements() -> Lattice {
        let grid = Grid::axis_aligned([15; 3], [4.0; 3], [-28.0; 3]).unwrap();
        let inner = |n: usize| grid.voxel(n).iter().all(|&c| c > 0 && c < 14);
        let node = (0..grid.len()).map(|n| if inner(n) { Node::Soft } else { Node::Outside }).collect();
        let constraint = vec![Material::default().at(40.0); grid.len()];
        Lattice::from_nodes(grid, node, constraint)
    }

    /// Where each element at rest comes to that outlines alone draw, and its place at rest.
    fn drawn(planning: Outline, fraction: Outline) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let guides = Guides::new(&[(planning, fraction)], &GuideOptions::default()).unwrap();
        let lattice = elements();
        let mut pull = Pull::none(lattice.soft().count(), 0.1);
        let which: Vec<u32> = (0..pull.towards.len() as u32).collect();
        guides.at(&lattice).renew(&vec![[0.0; 3]; lattice.node.len()], &which, &mut pull);
        let way = |(s, n): (usize, u32)| {
            let u = pull.settle(s, 0.5, [0.0; 3]);
            (lattice.rest(n as usize).coords, Vector3::from(u.map(f64::from)))
        };
        lattice.soft().enumerate().map(way).collect()
    }

    #[test]
    fn a_surface_goes_to_its_other_outline_and_nothing_else_moves() {
        // It grows by 2 mm: outwards. Exchanged it would shrink.
        for (planning, fraction, out) in [(14.0, 16.0, 2.0), (16.0, 14.0, -2.0)] {
            let mut beside = 0;
            for (rest, way) in drawn(ball(planning, [0.0; 3]), ball(fraction, [0.0; 3])) {
                if (rest.norm() - planning).abs() < 0.7 {
                    assert!((way.dot(&rest.normalize()) - out).abs() < 0.6, "{rest}: {way}");
                    assert!((way - rest.normalize() * out).norm() < 0.8, "{rest}: {way}");
                    beside += 1;
                } else if (rest.norm() - planning).abs() > 5.0 {
                    assert!(way.norm() < 1e-9, "{rest}: {way}");
                }
            }
            assert!(beside > 20, "{beside}");
        }
    }

    #[test]
    fn equal_outlines_ask_for_nothing_and_no_weight_is_none() {
        let same = || ball(14.0, [1.0, 0.0, 2.0]);
        assert!(drawn(same(), same()).iter().all(|(_, way)| way.norm() < 1e-6));
        let none = GuideOptions { weight: 0.0, ..GuideOptions::default() };
        assert!(Guides::new(&[(same(), same())], &none).is_none());
        assert!(Guides::new(&[], &GuideOptions::default()).is_none());
    }
}
