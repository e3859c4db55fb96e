//! What the label map says about each bone's shape: surface, centroid, pieces, where bones face each other.

use super::anatomy::Kind;
use crate::geometry::Grid;
use crate::volume::components::{Components, Connectivity};
use crate::volume::{LabelMap, Volume};
use nalgebra::{Matrix4, Point3, Vector3, Vector4};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A bone as the label map shows it. World positions, LPS mm.
#[derive(Debug, Clone)]
pub(super) struct Shape {
    pub(super) name: String,
    pub(super) label: u16,
    pub(super) kind: Kind,
    /// Number of voxels.
    pub(super) voxels: usize,
    pub(super) centroid: Point3<f64>,
    /// Centres of all voxels.
    pub(super) points: Vec<Point3<f64>>,
    /// Centres of the voxels that face another label, background or the image's edge.
    pub(super) surface: Vec<Point3<f64>>,
    /// Share of the surface that lies on the image's edge.
    pub(super) cut: f64,
}

/// The shapes of the wanted labels, in ascending order of label.
pub(super) fn shapes(labels: &LabelMap, wanted: &BTreeMap<u16, Kind>) -> Vec<Shape> {
    let grid = labels.volume.grid();
    let mut slots = vec![usize::MAX; usize::from(u16::MAX) + 1];
    let mut out: Vec<Shape> = Vec::new();
    for (&label, &kind) in wanted {
        slots[usize::from(label)] = out.len();
        let name = labels.names[&label].clone();
        let (points, surface) = (Vec::new(), Vec::new());
        out.push(Shape { name, label, kind, voxels: 0, centroid: Point3::origin(), points, surface, cut: 0.0 });
    }
    let data = labels.volume.data();
    for (l, &label) in data.iter().enumerate() {
        let slot = slots[usize::from(label)];
        if label == 0 || slot == usize::MAX {
            continue;
        }
        let shape = &mut out[slot];
        let voxel = grid.voxel(l);
        let point = grid.centre(voxel);
        shape.voxels += 1;
        shape.points.push(point);
        let edge = (0..3).any(|a| voxel[a] == 0 || voxel[a] + 1 == grid.size()[a]);
        if edge || grid.strides().iter().any(|s| data[l - s] != label || data[l + s] != label) {
            shape.surface.push(point);
            shape.cut += f64::from(u8::from(edge));
        }
    }
    out.retain(|s| s.voxels > 0);
    for s in &mut out {
        s.centroid = mean(&s.points);
        s.cut /= s.surface.len() as f64;
    }
    out
}

/// Mean of points; the origin for none.
pub(super) fn mean(points: &[Point3<f64>]) -> Point3<f64> {
    (points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64).into()
}

/// Where two bones face each other.
#[derive(Debug, Clone)]
pub(super) struct Contact {
    /// Mean position of the first bone's facing surface.
    pub(super) own: Point3<f64>,
    /// Mean position of the second bone's facing surface.
    pub(super) other: Point3<f64>,
    /// Smallest distance of surface voxel centres, mm.
    pub(super) gap: f64,
}

impl Contact {
    /// The middle between both surfaces.
    pub(super) fn middle(&self) -> Point3<f64> {
        nalgebra::center(&self.own, &self.other)
    }
}

/// Facing surfaces count up to this much farther apart than the nearest points, mm.
const FACING: f64 = 2.0;
/// Only points this near to the nearest pair are looked at, mm.
const NEIGHBOURHOOD: f64 = 25.0;

/// Where surface `a` faces surface `b`; `None` when one is empty.
pub(super) fn contact(a: &[Point3<f64>], b: &[Point3<f64>]) -> Option<Contact> {
    let thin = |p: &[Point3<f64>]| p.iter().step_by(p.len() / 500 + 1).copied().collect::<Vec<_>>();
    let coarse_b = thin(b);
    let far: Vec<(f64, Point3<f64>)> = thin(a).into_par_iter().map(|p| (distance(&p, &coarse_b), p)).collect();
    let (_, start) = far.into_iter().min_by(|p, q| p.0.total_cmp(&q.0))?;
    let at_b = nearest(&start, b)?;
    let at_a = nearest(&at_b, a)?;
    let near = |p: &[Point3<f64>], at: &Point3<f64>| {
        p.iter().filter(|q| (*q - at).norm() <= NEIGHBOURHOOD).copied().collect::<Vec<_>>()
    };
    let (a, b) = (near(a, &at_a), near(b, &at_b));
    // The gap is no wider than between these two, and what is farther from all of `b` does not face it.
    let sorted = Sorted::new(&b, (at_a - at_b).norm() + FACING);
    let pairs: Vec<_> = a.par_iter().filter_map(|p| sorted.nearest(p).map(|q| (*p, q, (q - p).norm()))).collect();
    let gap = pairs.iter().map(|p| p.2).min_by(f64::total_cmp)?;
    let (own, other): (Vec<_>, Vec<_>) = pairs.iter().filter(|p| p.2 <= gap + FACING).map(|p| (p.0, p.1)).unzip();
    Some(Contact { own: mean(&own), other: mean(&other), gap })
}

/// Points in order along the axis on which they lie farthest apart.
struct Sorted<'a> {
    points: &'a [Point3<f64>],
    axis: usize,
    /// Coordinates along it, ascending, and places among `points`.
    along: Vec<(f64, usize)>,
    reach: f64,
}

impl<'a> Sorted<'a> {
    fn new(points: &'a [Point3<f64>], reach: f64) -> Self {
        let ends = |a: usize| points.iter().map(|p| p[a]).fold([f64::MAX, f64::MIN], |[l, h], x| [l.min(x), h.max(x)]);
        let extent = [0, 1, 2].map(|a| ends(a)[1] - ends(a)[0]);
        let axis = Vector3::from(extent).imax();
        let mut along: Vec<(f64, usize)> = points.iter().enumerate().map(|(n, p)| (p[axis], n)).collect();
        along.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { points, axis, along, reach }
    }

    /// The nearest to `p`, the first of several; maybe none where all are farther than `reach`.
    fn nearest(&self, p: &Point3<f64>) -> Option<Point3<f64>> {
        let [low, high] = [-1.0, 1.0].map(|side| p[self.axis] + side * self.reach);
        let from = self.along.partition_point(|(x, _)| *x < low);
        let near = self.along[from..].iter().take_while(|(x, _)| *x <= high);
        let square = |n: usize| (self.points[n] - p).norm_squared();
        let first = near.map(|(_, n)| (square(*n), *n)).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        first.map(|(_, n)| self.points[n])
    }
}

/// Distance from a point to the nearest of `points`.
fn distance(p: &Point3<f64>, points: &[Point3<f64>]) -> f64 {
    points.iter().map(|q| (q - p).norm_squared()).fold(f64::INFINITY, f64::min).sqrt()
}

/// The nearest of `points`.
fn nearest(p: &Point3<f64>, points: &[Point3<f64>]) -> Option<Point3<f64>> {
    points.iter().min_by(|q, r| (*q - p).norm_squared().total_cmp(&(*r - p).norm_squared())).copied()
}

/// Least-squares sphere (algebraic): centre and radius; `None` when the points do not define one.
pub(super) fn sphere(points: &[Point3<f64>]) -> Option<(Point3<f64>, f64)> {
    if points.len() < 8 {
        return None;
    }
    let middle = mean(points);
    let (mut m, mut v) = (Matrix4::zeros(), Vector4::zeros());
    for p in points {
        let d = p - middle;
        let row = Vector4::new(d.x, d.y, d.z, 1.0);
        m += row * row.transpose();
        v += row * d.norm_squared();
    }
    let s = m.cholesky()?.solve(&v);
    let centre = s.xyz() / 2.0;
    let radius = (s.w + centre.norm_squared()).sqrt();
    radius.is_finite().then(|| (middle + centre, radius))
}

/// A piece of a bone apart from its main part.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) label: u16,
    /// Its share of the bone's voxels.
    pub(super) share: f64,
    /// Its distance from the bone's largest piece, mm.
    pub(super) gap: f64,
}

/// All pieces but the largest of each wanted bone, pieces below `least` of the bone left out.
pub(super) fn pieces(labels: &LabelMap, shapes: &[Shape], least: f64) -> Vec<Piece> {
    let parts = Components::of(&labels.volume, 0, Connectivity::Corner);
    let mut out = Vec::new();
    for shape in shapes {
        let mut own: Vec<usize> = (0..parts.len()).filter(|&c| parts.values[c] == shape.label).collect();
        own.sort_by_key(|&c| std::cmp::Reverse(parts.sizes[c]));
        let share = |c: usize| parts.sizes[c] as f64 / shape.voxels as f64;
        let Some((&main, others)) = own.split_first() else { continue };
        for &c in others.iter().filter(|&&c| share(c) >= least) {
            let (a, b) = (points(&labels.volume, &parts, c), points(&labels.volume, &parts, main));
            if let Some(contact) = contact(&a, &b) {
                out.push(Piece { label: shape.label, share: share(c), gap: contact.gap });
            }
        }
    }
    out
}

/// Voxel centres at the ends of a component's runs: enough of its surface to measure distances.
fn points(volume: &Volume<u16>, parts: &Components<u16>, component: usize) -> Vec<Point3<f64>> {
    let grid: &Grid = volume.grid();
    let ends = parts.runs.iter().filter(|r| r.component == component).flat_map(|r| [r.start, r.end - 1]);
    ends.map(|l| grid.centre(grid.voxel(l))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sphere_is_found_from_a_cap(c in prop::array::uniform3(-300.0f64..300.0), r in 10.0f64..40.0) {
            let centre = Point3::from(c);
            let cap = (0..400).map(|n| {
                let (z, t) = (f64::from(n % 20) / 20.0, f64::from(n / 20) * 0.314);
                let s = (1.0 - z * z).sqrt();
                centre + r * Vector3::new(s * t.cos(), s * t.sin(), z)
            });
            let (found, radius) = sphere(&cap.collect::<Vec<_>>()).unwrap();
            prop_assert!((found - centre).norm() < 1e-6 && (radius - r).abs() < 1e-6);
        }
    }

    #[test]
    fn contact_of_parallel_plates_is_the_middle_of_their_overlap() {
        let plate = |x0: i32, z: f64| -> Vec<Point3<f64>> {
            (0..40 * 20).map(|n| Point3::new(f64::from(x0 + n % 40), f64::from(n / 40), z)).collect()
        };
        let c = contact(&plate(0, 0.0), &plate(20, 6.0)).unwrap();
        assert!((c.gap - 6.0).abs() < 1e-12);
        // Points of the first plate beyond the second one's rim count as far as 2 mm farther than the gap.
        assert!((c.middle() - Point3::new(28.0, 9.5, 3.0)).norm() < 2.0, "{}", c.middle());
        assert!(contact(&[], &plate(0, 0.0)).is_none() && contact(&plate(0, 0.0), &[]).is_none());
    }
}
