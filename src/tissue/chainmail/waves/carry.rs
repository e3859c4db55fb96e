//! What a bone hands to tissue and what each link leaves of it (thesis 2.4 and 5.3).

use super::super::lattice::Lattice;
use super::super::lattice::material::Constraint;
use super::super::variants::Carry;
use super::front::Hop;
use crate::geometry::Rigid;
use nalgebra::{Matrix3, Point3, Unit, UnitQuaternion, Vector3};

/// The bones' motion: one transform and one centroid (LPS mm, the thesis's rotation point) per bone of the skeleton.
#[derive(Debug, Clone, Copy)]
pub struct Initiators<'a> {
    /// Planning to fraction.
    pub transforms: &'a [Rigid],
    /// Centroids in planning.
    pub centroids: &'a [Point3<f64>],
}

/// What an element holds of its bone's motion.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Parcel {
    /// Displacement left, in grid axes, mm: the translation in linear decay, the whole displacement otherwise.
    pub shift: [f32; 3],
    /// Angle left about the bone's axis, radians.
    pub angle: f32,
    /// Largest component of the initiating element's tangential arc per radian, mm: sets how fast linear decay goes.
    pub reach: f32,
}

impl Parcel {
    /// Times a weight.
    pub fn scaled(self, w: f32) -> Self {
        Self { shift: self.shift.map(|s| s * w), angle: self.angle * w, reach: self.reach * w }
    }

    /// Sum of two.
    pub fn plus(self, other: &Self) -> Self {
        let shift = std::array::from_fn(|a| self.shift[a] + other.shift[a]);
        Self { shift, angle: self.angle + other.angle, reach: self.reach + other.reach }
    }
}

/// A bone's motion as the thesis sees it: rotation about the centroid, then translation.
#[derive(Debug, Clone)]
struct BoneMotion {
    centroid: Point3<f64>,
    axis: Unit<Vector3<f64>>,
    angle: f64,
    /// Translation in grid axes, mm.
    translation: Vector3<f64>,
}

impl BoneMotion {
    /// Splits a transform at the bone's centroid.
    fn new(transform: &Rigid, centroid: Point3<f64>, directions: &Matrix3<f64>) -> Self {
        let (axis, angle) = transform.rotation.axis_angle().unwrap_or((Vector3::z_axis(), 0.0));
        Self { centroid, axis, angle, translation: directions.transpose() * (transform * centroid - centroid) }
    }

    /// Largest component (in grid axes) of the tangent over the arc of an element at `x`, times its distance from the
    /// axis: eq. 5.4 takes the largest component over the whole arc, per radian.
    fn reach(&self, x: &Point3<f64>, directions: &Matrix3<f64>) -> f64 {
        let arm = x - self.centroid;
        let radial = arm - self.axis.into_inner() * arm.dot(&self.axis);
        // Each component of the tangent is a sinusoid over the arc: its extreme lies at an end or at a stationary angle.
        let (tangent, inward) = (self.axis.cross(&radial), -radial);
        let mut largest: f64 = 0.0;
        for a in 0..3 {
            let (t, r) = (directions.column(a).dot(&tangent), directions.column(a).dot(&inward));
            let value = |angle: f64| (t * angle.cos() + r * angle.sin()).abs();
            let stationary = f64::atan2(r, t).rem_euclid(std::f64::consts::PI);
            largest = largest.max(value(0.0)).max(value(self.angle));
            if stationary <= self.angle {
                largest = largest.max(value(stationary));
            }
        }
        largest
    }

    fn turn(&self, angle: f32) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&self.axis, f64::from(angle))
    }
}

/// The valid region of a neighbour (thesis 2.4, Fig. 7): how far it may leave its rest place beside an element, in grid
/// axes, mm. A link along several axes adds up the play of its steps.
struct Region {
    low: [f32; 3],
    high: [f32; 3],
    /// Steps of the link, mm along each grid axis.
    total: f32,
}

impl Region {
    fn new(link: Constraint, step: &[i32; 3], spacing: &[f64; 3]) -> Self {
        let length: [f32; 3] = std::array::from_fn(|a| step[a].unsigned_abs() as f32 * spacing[a] as f32);
        let total: f32 = length.iter().sum();
        let side = |a: usize, away: bool| {
            let along = length[a] * if away { link.max - 1.0 } else { 1.0 - link.min };
            along + link.shear * (total - length[a])
        };
        Self {
            low: std::array::from_fn(|a| -side(a, step[a] < 0)),
            high: std::array::from_fn(|a| side(a, step[a] > 0)),
            total,
        }
    }

    /// The place nearest to `from_rest` inside the region.
    fn hold(&self, from_rest: &Vector3<f64>) -> Vector3<f64> {
        Vector3::from_fn(|a, _| from_rest[a].clamp(f64::from(self.low[a]), f64::from(self.high[a])))
    }

    /// What a shift of the element leaves to a neighbour at rest: the constraint violation (eq. 2.7), axis by axis.
    fn violation(&self, shift: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|a| shift[a] + (-shift[a]).clamp(self.low[a], self.high[a]))
    }
}

/// Carries motion along links in one of the variants.
pub struct Carrier<'a> {
    carry: Carry,
    transforms: &'a [Rigid],
    motions: Vec<BoneMotion>,
    directions: Matrix3<f64>,
    spacing: [f64; 3],
}

impl<'a> Carrier<'a> {
    /// A carrier of these bones' motion over a lattice.
    pub fn new(lattice: &Lattice, bones: &Initiators<'a>, carry: Carry) -> Self {
        let directions = *lattice.grid.direction();
        let motions =
            bones.transforms.iter().zip(bones.centroids).map(|(t, &c)| BoneMotion::new(t, c, &directions)).collect();
        Self { carry, transforms: bones.transforms, motions, directions, spacing: lattice.grid.spacing() }
    }

    /// Whether elements hold anything beyond the name of their bone.
    pub fn carries(&self) -> bool {
        self.carry != Carry::Rigid
    }

    /// What an element of a bone holds.
    pub fn seed(&self, bone: u16, x: &Point3<f64>) -> Parcel {
        let motion = &self.motions[usize::from(bone)];
        let whole = || self.directions.transpose() * (self.transforms[usize::from(bone)] * x - x);
        let (shift, angle, reach) = match self.carry {
            Carry::Rigid => (Vector3::zeros(), 0.0, 0.0),
            Carry::Translation => (whole(), 0.0, 0.0),
            Carry::ConstraintBased => (whole(), motion.angle, 0.0),
            Carry::LinearDecay => (motion.translation, motion.angle, motion.reach(x, &self.directions)),
        };
        Parcel { shift: [0, 1, 2].map(|a| shift[a] as f32), angle: angle as f32, reach: reach as f32 }
    }

    /// Displacement of an element at rest at `x`, LPS mm.
    pub fn displacement(&self, parcel: &Parcel, bone: u16, x: &Point3<f64>) -> Vector3<f64> {
        let shift = || self.directions * Vector3::from(parcel.shift.map(f64::from));
        match self.carry {
            Carry::Rigid => self.transforms[usize::from(bone)] * x - x,
            Carry::Translation | Carry::ConstraintBased => shift(),
            Carry::LinearDecay => {
                let motion = &self.motions[usize::from(bone)];
                let arm = x - motion.centroid;
                motion.turn(parcel.angle) * arm - arm + shift()
            }
        }
    }

    /// What node `n`, which holds `from`, leaves to its neighbour `m` after their link.
    pub fn hand_on(&self, lattice: &Lattice, from: &Parcel, bone: u16, [n, m]: [usize; 2], hop: &Hop) -> Parcel {
        let link = lattice.link(n, m);
        let region = Region::new(link, &hop.step, &self.spacing);
        match self.carry {
            Carry::Rigid => *from,
            Carry::Translation => Parcel { shift: region.violation(from.shift), ..*from },
            Carry::LinearDecay => {
                Parcel { shift: region.violation(from.shift), angle: decayed(from, link, region.total), ..*from }
            }
            Carry::ConstraintBased => {
                let motion = &self.motions[usize::from(bone)];
                self.co_rotated(motion, from, &region, link, [lattice.rest(n), lattice.rest(m)])
            }
        }
    }

    /// Shifts a neighbour into the valid region that has moved and turned with its element (thesis 5.3.1).
    fn co_rotated(
        &self,
        motion: &BoneMotion,
        from: &Parcel,
        region: &Region,
        link: Constraint,
        [n, m]: [Point3<f64>; 2],
    ) -> Parcel {
        let turn = motion.turn(from.angle);
        let rest = m - n;
        let into = |moved: Point3<f64>| {
            let local = self.directions.transpose() * (turn.inverse() * (m - moved) - rest);
            moved + turn * (rest + self.directions * region.hold(&local))
        };
        let centre = motion.centroid;
        let flat = |p: Point3<f64>| (p - centre) - motion.axis.into_inner() * (p - centre).dot(&motion.axis);
        let (before, after) = (flat(m), flat(into(centre + turn * (n - centre))));
        let least = 1e-9 * rest.norm();
        let along_axis = flat(m).metric_distance(&flat(n)) < least;
        let angle = if along_axis || before.norm() < least || after.norm() < least {
            // No arm to measure an angle by, or a link along the axis: the cardinal-axis exception.
            from.angle - link.shear.atan2(link.min)
        } else {
            f64::atan2(motion.axis.dot(&before.cross(&after)), before.dot(&after)) as f32
        };
        let end = n + self.directions * Vector3::from(from.shift.map(f64::from));
        let shift = self.directions.transpose() * (into(end) - m);
        Parcel { shift: [0, 1, 2].map(|a| shift[a] as f32), angle: angle.clamp(0.0, from.angle), reach: from.reach }
    }
}

/// Angle after a link of `total` mm: it decays over as many links as the initiating element's arc would (eq. 5.3-5.4).
fn decayed(from: &Parcel, link: Constraint, total: f32) -> f32 {
    let play = (1.0 - link.min).min(link.shear) * total;
    if from.reach > 0.0 {
        (from.angle - play / from.reach).max(0.0)
    } else if play > 0.0 {
        0.0
    } else {
        from.angle
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::lattice::material::RIGID;

    const LINK: Constraint = Constraint { min: 0.6, max: 1.3, shear: 0.2 };

    #[test]
    fn one_link_keeps_what_its_play_does_not_take() {
        let hand_on = |link, step: [i32; 3]| {
            let region = Region::new(link, &step, &[1.0, 1.0, 3.0]);
            let from = Parcel { shift: [3.0, -2.0, 0.1], angle: 0.3, reach: 20.0 };
            (region.violation(from.shift), decayed(&from, link, region.total))
        };
        // Pushed along +i: compression 0.4 mm; sideways shear 0.2 mm; what is within play decays to nothing.
        let (shift, angle) = hand_on(LINK, [1, 0, 0]);
        assert!((shift[0] - 2.6).abs() < 1e-6 && (shift[1] + 1.8).abs() < 1e-6 && shift[2].abs() < 1e-6);
        assert!((angle - (0.3 - 0.2 / 20.0)).abs() < 1e-6);
        // Pulled: extension 0.3 mm.
        assert!((hand_on(LINK, [-1, 0, 0]).0[0] - 2.7).abs() < 1e-6);
        let (shift, angle) = hand_on(RIGID, [0, 0, 1]);
        assert_eq!((shift, angle), ([3.0, -2.0, 0.1], 0.3));
    }

    #[test]
    fn reach_is_the_largest_tangent_component_over_the_arc() {
        let c = Point3::origin();
        let turn = Rigid::rotation(Vector3::z() * 0.5);
        let m = BoneMotion::new(&turn, c, &Matrix3::identity());
        // At (d, 0) the tangent is d (-sin, cos): largest component d over arcs up to 45 degrees.
        assert!((m.reach(&Point3::new(10.0, 0.0, 5.0), &Matrix3::identity()) - 10.0).abs() < 1e-9);
        // At 30 degrees before the y axis an arc of 0.5 rad passes ... its x component peaks at cos 0 on the y axis.
        let a = std::f64::consts::FRAC_PI_2 - 0.2;
        assert!((m.reach(&Point3::new(10.0 * a.cos(), 10.0 * a.sin(), 0.0), &Matrix3::identity()) - 10.0).abs() < 1e-9);
        assert!(m.reach(&Point3::new(0.0, 0.0, 9.0), &Matrix3::identity()) < 1e-12);
    }
}
