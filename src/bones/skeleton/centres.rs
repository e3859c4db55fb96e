//! Where each joint turns, from the shapes of its two bones.

use super::anatomy::{C1, C2, Kind, SKULL, Side};
use super::shape::{Contact, Shape, contact, mean, sphere};
use super::spine::{self, Vertebra};
use nalgebra::{Matrix3, Point3, Vector3};
use std::collections::BTreeMap;

/// What is known when joints are placed.
pub(super) struct Anatomy<'a> {
    pub(super) shapes: &'a [Shape],
    pub(super) vertebrae: BTreeMap<u8, Vertebra>,
}

/// Bones that lie farther apart than this have something missing between them: the joint is at the child's end, mm.
const BRIDGE: f64 = 20.0;

impl Anatomy<'_> {
    /// Centre of the joint between two bones (positions in `shapes`), LPS mm.
    pub(super) fn centre(&self, child: usize, parent: usize) -> Point3<f64> {
        let (c, p) = (&self.shapes[child], &self.shapes[parent]);
        let special = match (c.kind, p.kind) {
            (Kind::Spine(SKULL), Kind::Spine(C1)) => self.atlanto_occipital(c, p),
            (Kind::Spine(C1), Kind::Spine(C2)) => spine::dens(c, p, &self.axes(child, parent)),
            (Kind::Spine(upper), Kind::Spine(lower)) => self.disc(upper, lower),
            (Kind::Mandible, _) => Some(self.condyles(c)),
            (Kind::Hyoid, _) => Some(c.centroid),
            (Kind::Clavicle(side), Kind::Spine(_)) if c.cut > 0.02 => self.sternal_end(side, p),
            (Kind::Rib(..), Kind::Spine(level)) => self.rib_head(c, level),
            (Kind::Humerus(_) | Kind::Femur(_), _) => head(c, p),
            (Kind::Ulna(_) | Kind::Radius(_), _) => beyond_the_edge(c, p),
            _ => None,
        };
        special.unwrap_or_else(|| match contact(&c.surface, &p.surface) {
            Some(Contact { own, gap, .. }) if gap > BRIDGE => own,
            Some(facing) => facing.middle(),
            None => c.centroid,
        })
    }

    /// Axes of the joint between two bones, columns: flexion, lateral bending, axial rotation.
    pub(super) fn axes(&self, child: usize, parent: usize) -> Matrix3<f64> {
        let (c, p) = (&self.shapes[child], &self.shapes[parent]);
        match (c.kind, p.kind) {
            (Kind::Humerus(_) | Kind::Ulna(_) | Kind::Radius(_) | Kind::Femur(_), _) => {
                limb_axes(&(self.centre(child, parent) - c.centroid))
            }
            (Kind::Spine(upper), Kind::Spine(lower)) => {
                let up = |level: u8| self.vertebrae.get(&level).map(|v| v.frame.column(2).into_owned());
                let up: Vector3<f64> = [up(upper), up(lower)].into_iter().flatten().sum();
                if up.norm() > 1e-6 { spine::frame(&up.normalize()) } else { Matrix3::identity() }
            }
            (_, Kind::Spine(level)) => self.vertebrae.get(&level).map_or_else(Matrix3::identity, |v| v.frame),
            _ => Matrix3::identity(),
        }
    }

    /// Middle of the disc between two vertebral bodies.
    fn disc(&self, upper: u8, lower: u8) -> Option<Point3<f64>> {
        let (above, below) = (self.vertebrae.get(&upper)?, self.vertebrae.get(&lower)?);
        /// Half of a disc's height, where only one endplate is seen, mm.
        const HALF_DISC: f64 = 2.0;
        let up = above.frame.column(2).into_owned();
        match (above.lower, below.upper) {
            (Some(a), Some(b)) => Some(nalgebra::center(&a, &b)),
            (Some(a), None) => Some(a - up * HALF_DISC),
            (None, Some(b)) => Some(b + up * HALF_DISC),
            // Both are cut off: as far from the endplate that is seen as the next vertebra is high.
            (None, None) => {
                let height = |level: u8| {
                    let v = self.vertebrae.get(&level)?;
                    Some((v.upper? - v.lower?).norm() + HALF_DISC)
                };
                let from_above = || Some(above.upper? - up * height(upper + 1)?);
                let from_below = || Some(below.lower? + up * height(lower.checked_sub(1)?)?);
                from_above().or_else(from_below)
            }
        }
    }

    /// Middle between the two joints of condyles and lateral masses.
    fn atlanto_occipital(&self, skull: &Shape, atlas: &Shape) -> Option<Point3<f64>> {
        let to_local = self.vertebrae.get(&C1)?.frame.transpose();
        let side = |sign: f64| {
            let mass = |p: &&Point3<f64>| {
                let v = to_local * (*p - atlas.centroid);
                (8.0..28.0).contains(&(v.x * sign)) && v.y.abs() <= 14.0
            };
            let mass: Vec<_> = atlas.surface.iter().filter(mass).copied().collect();
            contact(&mass, &skull.surface).filter(|c| c.gap < 12.0).map(|c| c.middle())
        };
        Some(nalgebra::center(&side(1.0)?, &side(-1.0)?))
    }

    /// Middle between the two condyles of the jaw: the ends of its rami that reach farthest up and back.
    fn condyles(&self, jaw: &Shape) -> Point3<f64> {
        let axes = self.vertebrae.values().next_back().map_or_else(Matrix3::identity, |v| v.frame);
        let reach = axes * Vector3::new(0.0, 1.0, 1.0).normalize();
        let left = axes.column(0).into_owned();
        let end = |sign: f64| {
            let half: Vec<_> =
                jaw.surface.iter().filter(|p| (*p - jaw.centroid).dot(&left) * sign > 15.0).copied().collect();
            let far = |p: &Point3<f64>| (p - jaw.centroid).dot(&reach);
            let tip = half.iter().map(far).max_by(f64::total_cmp)?;
            Some(mean(&half.into_iter().filter(|p| far(p) > tip - 8.0).collect::<Vec<_>>()))
        };
        match (end(1.0), end(-1.0)) {
            (Some(l), Some(r)) => nalgebra::center(&l, &r),
            (one, other) => one.or(other).unwrap_or(jaw.centroid),
        }
    }

    /// The end of a rib that lies nearest to the vertebra's body: ribs touch the transverse process too.
    fn rib_head(&self, rib: &Shape, level: u8) -> Option<Point3<f64>> {
        /// Length of the head, mm.
        const HEAD: f64 = 4.0;
        let body = self.on_axis(level)?;
        let nearest = rib.surface.iter().map(|p| (p - body).norm()).min_by(f64::total_cmp)?;
        Some(mean(&rib.surface.iter().filter(|p| (*p - body).norm() <= nearest + HEAD).copied().collect::<Vec<_>>()))
    }

    /// Middle of a vertebra's body, or of the disc above it where the image's edge cuts the body off.
    fn on_axis(&self, level: u8) -> Option<Point3<f64>> {
        let own = self.vertebrae.get(&level).filter(|v| v.has_body).map(|v| v.middle);
        own.or_else(|| self.vertebrae.range(level + 1..).next().and_then(|(&upper, _)| self.disc(upper, level)))
    }

    /// Where the sternal end of a clavicle is expected when the image's edge cuts it off: beside the midline and
    /// in front of the spine, in the frame of the vertebra that carries it.
    fn sternal_end(&self, side: Side, parent: &Shape) -> Option<Point3<f64>> {
        let Kind::Spine(level) = parent.kind else { return None };
        let frame = self.vertebrae.get(&level)?.frame;
        let sign = if side == Side::Left { 1.0 } else { -1.0 };
        // The lowest disc lies on the bodies' line, even where the carrier itself is cut.
        let joint = self.vertebrae.range(level + 1..).next().and_then(|(&upper, _)| self.disc(upper, level));
        Some(joint.unwrap_or(parent.centroid) + frame * Vector3::new(27.0 * sign, -45.0, 0.0))
    }
}

/// The joint of two long bones that both leave the image before they meet: where their axes come nearest.
fn beyond_the_edge(child: &Shape, parent: &Shape) -> Option<Point3<f64>> {
    /// Longer than any upper arm, mm.
    const LONGEST: f64 = 400.0;
    /// Axes that pass each other farther apart than this do not meet, mm.
    const MISS: f64 = 60.0;
    let gap = contact(&child.surface, &parent.surface)?.gap;
    if gap <= BRIDGE || child.cut <= 0.0 || parent.cut <= 0.0 {
        return None;
    }
    let (d, e) = (long_axis(child)?, long_axis(parent)?);
    let (between, cross) = (parent.centroid - child.centroid, d.cross(&e));
    // Nearly parallel axes meet nowhere in particular.
    if cross.norm() < 0.2 {
        return None;
    }
    let along = |other: &Vector3<f64>| between.cross(other).dot(&cross) / cross.norm_squared();
    let (a, b) = (child.centroid + d * along(&e), parent.centroid + e * along(&d));
    let plausible =
        (a - b).norm() <= MISS && (a - child.centroid).norm() <= LONGEST && (b - parent.centroid).norm() <= LONGEST;
    plausible.then(|| nalgebra::center(&a, &b))
}

/// Direction of a bone's greatest extent; `None` for one that is not clearly long.
fn long_axis(bone: &Shape) -> Option<Vector3<f64>> {
    let mut spread = Matrix3::zeros();
    for p in &bone.points {
        let v = p - bone.centroid;
        spread += v * v.transpose();
    }
    let eigen = spread.symmetric_eigen();
    let longest = eigen.eigenvalues.imax();
    let second = (0..3).filter(|&n| n != longest).map(|n| eigen.eigenvalues[n]).fold(0.0, f64::max);
    (eigen.eigenvalues[longest] > 4.0 * second).then(|| eigen.eigenvectors.column(longest).into_owned())
}

/// Axes of a limb whose bone points away from the joint against `proximal`: flexion stays as near to right-left as
/// the bone lets it.
fn limb_axes(proximal: &Vector3<f64>) -> Matrix3<f64> {
    let Some(axial) = proximal.try_normalize(1e-6) else { return Matrix3::identity() };
    let hint = if axial.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let flexion = (hint - axial * axial.dot(&hint)).normalize();
    Matrix3::from_columns(&[flexion, axial.cross(&flexion), axial])
}

/// Plausible radii of the heads of humerus and femur, mm.
const HEAD_RADIUS: std::ops::Range<f64> = 15.0..34.0;

/// Centre of the ball at the end of `bone` that faces `socket`, by a sphere through its surface.
fn head(bone: &Shape, socket: &Shape) -> Option<Point3<f64>> {
    let at = contact(&bone.surface, &socket.surface)?.own;
    let near = |r: f64| bone.surface.iter().filter(|p| (*p - at).norm() <= r).copied().collect::<Vec<_>>();
    let inwards = (mean(&near(45.0)) - at).try_normalize(1e-6)?;
    let (mut centre, mut radius) = (at + inwards * 23.0, 23.0);
    for round in 0..20 {
        // The band narrows, so that neck and tubercles drop out.
        let band = 6.0 - 0.2 * f64::from(round);
        let toward = (at - centre).try_normalize(1e-6)?;
        let on_ball = |p: &&Point3<f64>| {
            let v = *p - centre;
            (v.norm() - radius).abs() <= band && v.dot(&toward) >= -0.3 * radius
        };
        let points: Vec<_> = bone.surface.iter().filter(on_ball).copied().collect();
        let (c, r) = sphere(&points)?;
        if !HEAD_RADIUS.contains(&r) || (c - at).norm() > 2.0 * HEAD_RADIUS.end {
            return None;
        }
        (centre, radius) = (c, r);
    }
    Some(centre)
}
