//! Contours: closed planar polygons of structures on parallel planes, as radiotherapy draws them.
//!
//! What two polygons of one structure on one plane both enclose is outside (even-odd rule), so an inner polygon is a hole.
//! Between planes the signed distances to the polygons are interpolated linearly (shape-based interpolation, Raya and
//! Udupa, IEEE Trans Med Imaging 9, 1990); beyond the first and the last plane the structure goes on for half their
//! spacing, as a voxel does.

mod area;
mod planar;
mod trace;

pub use trace::trace;

use super::{Mask, Volume};
use crate::geometry::Grid;
use area::Drawn;
use nalgebra::{Matrix3, Point3, Vector3};
use planar::PlanarDistance;
use rayon::prelude::*;

/// Planes closer than this are one, mm.
const SAME_PLANE_MM: f64 = 0.05;
/// Gaps wider than this many plane spacings part a structure in two.
const WIDEST_GAP: f64 = 2.5;

/// A closed polygon; its last point joins its first.
#[derive(Debug, Clone, PartialEq)]
pub struct Polygon {
    /// Position of its plane along the normal, mm.
    pub height: f64,
    /// Points along the two in-plane axes, mm.
    pub points: Vec<[f64; 2]>,
}

/// A structure: its name and its polygons.
#[derive(Debug, Clone, PartialEq)]
pub struct Structure {
    /// Name, for example `spinal_cord`.
    pub name: String,
    /// Colour for display, red, green, blue.
    pub colour: Option<[u8; 3]>,
    /// Its polygons, in any order.
    pub polygons: Vec<Polygon>,
}

/// Structures with their common planes.
#[derive(Debug, Clone, PartialEq)]
pub struct Contours {
    /// Columns: the two in-plane axes and the normal, orthonormal, right-handed, LPS.
    pub axes: Matrix3<f64>,
    /// The structures.
    pub structures: Vec<Structure>,
}

impl Contours {
    /// World position of a point of a polygon, LPS mm.
    pub fn world(&self, point: [f64; 2], height: f64) -> Point3<f64> {
        (self.axes * Vector3::new(point[0], point[1], height)).into()
    }

    /// Distance between neighbouring planes: the median over all structures, or `fallback` where there is only one plane.
    pub fn spacing(&self, fallback: f64) -> f64 {
        let mut gaps: Vec<f64> = self
            .structures
            .iter()
            .flat_map(|s| s.heights().windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>())
            .collect();
        gaps.sort_by(f64::total_cmp);
        gaps.get(gaps.len() / 2).copied().unwrap_or(fallback)
    }

    /// Distance between a structure's planes: the median of its own gaps where it has two or more, else
    /// [`Contours::spacing`]. Structures of one file may be drawn on planes of their own.
    pub fn spacing_of(&self, structure: &Structure, fallback: f64) -> f64 {
        let mut gaps: Vec<f64> = structure.heights().windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        match gaps.len() {
            0 | 1 => self.spacing(fallback),
            n => gaps[n / 2],
        }
    }

    /// A structure as a solid. `spacing` is [`Contours::spacing_of`].
    pub fn solid(&self, structure: &Structure, spacing: f64) -> Solid {
        let heights = structure.heights();
        let planes = heights
            .par_iter()
            .map(|&h| {
                let own = structure.polygons.iter().filter(|p| (p.height - h).abs() <= SAME_PLANE_MM);
                PlanarDistance::new(&own.map(|p| p.points.as_slice()).collect::<Vec<_>>())
            })
            .collect();
        Solid { to_plane: self.axes.transpose(), heights, planes, spacing }
    }
}

impl Structure {
    /// Positions of its planes along the normal, ascending, mm.
    pub fn heights(&self) -> Vec<f64> {
        let mut all: Vec<f64> = self.polygons.iter().map(|p| p.height).collect();
        all.sort_by(f64::total_cmp);
        all.dedup_by(|a, b| *a - *b <= SAME_PLANE_MM);
        all
    }

    /// What the polygons of the plane at `height` enclose.
    fn drawn(&self, height: f64) -> Drawn {
        let own = self.polygons.iter().filter(|p| (p.height - height).abs() <= SAME_PLANE_MM);
        Drawn::of(&own.map(|p| p.points.as_slice()).collect::<Vec<_>>())
    }

    /// Area on the plane at `height`, mm^2, by the even-odd rule.
    pub fn area(&self, height: f64) -> f64 {
        self.drawn(height).area
    }

    /// Volume of the contours themselves, mm^3: areas between planes by the trapezoid rule, half a spacing beyond the first
    /// and the last plane and into gaps that part the structure. `spacing` is [`Contours::spacing_of`].
    pub fn volume(&self, spacing: f64) -> f64 {
        let heights = self.heights();
        let areas: Vec<f64> = heights.par_iter().map(|h| self.area(*h)).collect();
        let half = |n: usize, next: Option<&f64>| {
            let gap = next.map_or(spacing, |h| (h - heights[n]).abs());
            0.5 * areas[n] * if gap > WIDEST_GAP * spacing { spacing } else { gap }
        };
        (0..heights.len())
            .map(|n| half(n, n.checked_sub(1).and_then(|b| heights.get(b))) + half(n, heights.get(n + 1)))
            .sum()
    }
}

/// Signed area of a polygon, mm^2; positive when it turns from the first to the second axis.
fn shoelace(points: &[[f64; 2]]) -> f64 {
    let next = points.iter().cycle().skip(1);
    points.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum::<f64>() / 2.0
}

/// Whether a point lies inside a polygon, by the even-odd rule.
fn encloses(points: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let next = points.iter().cycle().skip(1);
    points
        .iter()
        .zip(next)
        .filter(|(a, b)| (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
        .count()
        % 2
        == 1
}

/// A structure as a function of position.
pub struct Solid {
    to_plane: Matrix3<f64>,
    heights: Vec<f64>,
    planes: Vec<PlanarDistance>,
    spacing: f64,
}

impl Solid {
    /// Distance to the surface, mm: positive inside, negative outside; exact near the surface only.
    pub fn depth(&self, point: &Point3<f64>) -> f64 {
        let p = self.to_plane * point.coords;
        let at = [p.x, p.y];
        let above = self.heights.partition_point(|h| *h < p.z);
        let below = above.checked_sub(1);
        let cap = |n: usize| (0.5 * self.spacing - (p.z - self.heights[n]).abs()).min(self.planes[n].at(at));
        match (below, above < self.planes.len()) {
            (None, false) => f64::MIN,
            (Some(b), false) => cap(b),
            (None, true) => cap(above),
            (Some(b), true) => {
                let gap = self.heights[above] - self.heights[b];
                if gap > WIDEST_GAP * self.spacing {
                    return cap(b).max(cap(above));
                }
                let t = (p.z - self.heights[b]) / gap;
                self.planes[b].at(at) * (1.0 - t) + self.planes[above].at(at) * t
            }
        }
    }

    /// Share of a small box around a point that lies inside, 0 to 1: in the plane by the distance to the surface, at an edge
    /// `soft` mm wide; along the normal, where the structure ends beyond a plane, by overlap of `high` mm. A point on the
    /// surface counts half, so that no layer of a drawing through sampled points is lost or won.
    pub fn share(&self, point: &Point3<f64>, soft: f64, high: f64) -> f64 {
        let p = self.to_plane * point.coords;
        let at = [p.x, p.y];
        let above = self.heights.partition_point(|h| *h < p.z);
        let edge = |depth: f64| (0.5 + depth / soft).clamp(0.0, 1.0);
        let half = 0.5 * self.spacing;
        let cap = |n: usize| {
            let z = p.z - self.heights[n];
            let overlap = (((z + 0.5 * high).min(half) - (z - 0.5 * high).max(-half)) / high).clamp(0.0, 1.0);
            if overlap > 0.0 { overlap * edge(self.planes[n].at(at)) } else { 0.0 }
        };
        match (above.checked_sub(1), above < self.planes.len()) {
            (None, false) => 0.0,
            (Some(b), false) => cap(b),
            (None, true) => cap(above),
            (Some(b), true) => {
                let gap = self.heights[above] - self.heights[b];
                if gap > WIDEST_GAP * self.spacing {
                    return cap(b).max(cap(above));
                }
                let t = (p.z - self.heights[b]) / gap;
                edge(self.planes[b].at(at) * (1.0 - t) + self.planes[above].at(at) * t)
            }
        }
    }

    /// The voxels whose centre lies inside.
    pub fn mask(&self, grid: &Grid) -> Mask {
        let slice = grid.strides()[2];
        let mut out = Volume::filled(grid.clone(), false);
        out.data_mut().par_chunks_mut(slice).enumerate().for_each(|(k, plane)| {
            for (n, inside) in plane.iter_mut().enumerate() {
                *inside = self.depth(&grid.centre(grid.voxel(k * slice + n))) > 0.0;
            }
        });
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    pub(super) fn circle(centre: [f64; 2], radius: f64, corners: usize) -> Vec<[f64; 2]> {
        let at = |n: usize| (TAU * n as f64 / corners as f64).sin_cos();
        (0..corners).map(|n| [centre[0] + radius * at(n).1, centre[1] + radius * at(n).0]).collect()
    }

    fn tube(radii: &[f64], spacing: f64, hole: Option<f64>) -> Contours {
        let polygons = (0..10)
            .flat_map(|k| {
                let height = spacing * f64::from(k);
                radii.iter().chain(&hole).map(move |&r| Polygon { height, points: circle([5.0, -3.0], r, 180) })
            })
            .collect();
        let tube = Structure { name: "tube".into(), colour: None, polygons };
        Contours { axes: Matrix3::identity(), structures: vec![tube] }
    }

    #[test]
    fn a_tube_with_a_hole_has_its_area_and_its_volume() {
        let contours = tube(&[12.0], 3.0, Some(5.0));
        let ring = 0.5 * TAU * (144.0 - 25.0);
        let tube = &contours.structures[0];
        assert!((tube.area(6.0) / ring - 1.0).abs() < 1e-3);
        assert!((contours.spacing(1.0) - 3.0).abs() < 1e-12);
        let grid = Grid::axis_aligned([80, 80, 80], [0.5; 3], [-15.13, -23.21, -6.2]).unwrap();
        let mask = contours.solid(tube, 3.0).mask(&grid);
        // Ten planes of 3 mm, the outermost reaching half a spacing beyond.
        let volume = mask.count() as f64 * grid.voxel_volume();
        assert!((volume / (ring * 30.0) - 1.0).abs() < 0.01, "{volume}");
    }

    #[test]
    fn depth_is_distance_near_the_surface() {
        let contours = tube(&[12.0], 3.0, None);
        let solid = contours.solid(&contours.structures[0], 3.0);
        for (r, height) in [(11.0, 6.0), (13.0, 7.4), (12.0, 13.0), (30.0, 9.0), (2.0, 9.0)] {
            let depth = solid.depth(&Point3::new(5.0 + r, -3.0, height));
            assert!((depth - (12.0 - r)).abs() < 0.05, "r {r}: {depth}");
        }
    }

    #[test]
    fn a_wide_gap_is_not_filled() {
        let mut contours = tube(&[12.0], 3.0, None);
        contours.structures[0].polygons.retain(|p| p.height < 8.0 || p.height > 20.0);
        let solid = contours.solid(&contours.structures[0], contours.spacing(1.0));
        assert!(solid.depth(&Point3::new(5.0, -3.0, 7.0)) > 0.0);
        assert!(solid.depth(&Point3::new(5.0, -3.0, 14.0)) < 0.0);
    }
}
