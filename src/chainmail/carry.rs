//! How one bone's motion decays along its front: not at all, or by the play of each link (thesis 5.2 and 5.3.2).

use super::front::{FrontRules, TimeMap};
use super::lattice::{Lattice, Node};
use crate::geometry::Rigid;
use nalgebra::{Matrix3, Point3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// What a bone hands to the tissue around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Carry {
    /// Its rigid motion, undiminished: the blend of several bones does the rest.
    #[default]
    Rigid,
    /// Its translation, reduced by the play of each link, and its rotation about the bone's centroid with linear decay
    /// (thesis 5.3.2, eq. 5.3-5.6, on displacements so that the bone itself moves exactly).
    LinearDecay,
}

/// A bone's motion as the thesis sees it: rotation about the centroid, then translation.
#[derive(Debug, Clone)]
pub struct BoneMotion {
    centroid: Point3<f64>,
    axis: Unit<Vector3<f64>>,
    angle: f64,
    /// Translation in grid axes, mm.
    translation: Vector3<f64>,
}

/// What travels along the front.
#[derive(Clone, Copy, Default)]
struct Parcel {
    /// Translation left, in grid axes, mm.
    translation: [f32; 3],
    /// Angle left, radians.
    angle: f32,
    /// Largest component of the initiating element's tangential arc per radian, mm: sets how fast the angle decays.
    reach: f32,
}

impl BoneMotion {
    /// Splits a transform at the bone's centroid.
    pub fn new(transform: &Rigid, centroid: Point3<f64>, directions: &Matrix3<f64>) -> Self {
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

    /// Displacement of a resting point that has `angle` and `translation` (grid axes) left.
    fn displace(&self, x: &Point3<f64>, parcel: &Parcel, directions: &Matrix3<f64>) -> Vector3<f64> {
        let arm = x - self.centroid;
        let turn = UnitQuaternion::from_axis_angle(&self.axis, f64::from(parcel.angle));
        turn * arm - arm + directions * Vector3::from(parcel.translation.map(f64::from))
    }
}

/// Displacement that one bone alone gives to each node its front reaches, mm, in the order of `map.order`.
pub fn decayed(lattice: &Lattice, bone: u16, motion: &BoneMotion, map: &TimeMap, rules: &FrontRules) -> Vec<[f32; 3]> {
    let links = rules.links(lattice);
    let axes = rules.steps();
    let spacing = lattice.grid.spacing();
    let directions = lattice.grid.direction();
    let mut parcel = vec![Parcel::default(); lattice.node.len()];
    let start =
        Parcel { translation: [0, 1, 2].map(|a| motion.translation[a] as f32), angle: motion.angle as f32, reach: 0.0 };
    for &n in &lattice.active {
        if lattice.node[n as usize] == Node::Bone(bone) {
            let reach = motion.reach(&lattice.rest(n as usize), directions) as f32;
            parcel[n as usize] = Parcel { reach, ..start };
        }
    }
    let mut out = Vec::with_capacity(map.order.len());
    for &n in &map.order {
        let n = n as usize;
        // The parent on the fastest path; of several the first in storage.
        let parent = links.iter().zip(axes).filter_map(|(&(o, mm), step)| {
            let m = (n as isize + o) as usize;
            let carries = lattice.node[m] == Node::Soft || lattice.node[m] == Node::Bone(bone);
            (carries
                && map.time[m] != super::front::NEVER
                && map.time[m] + rules.between(lattice, m, n, mm) == map.time[n])
                .then_some((m, step))
        });
        if let Some((m, step)) = parent.min_by_key(|p| p.0) {
            parcel[n] = hand_on(&parcel[m], lattice.link(m, n), step, &spacing);
        }
        let u = motion.displace(&lattice.rest(n), &parcel[n], directions);
        out.push([u.x as f32, u.y as f32, u.z as f32]);
    }
    out
}

/// What is left after a link: along each grid axis the play of the link's steps in every direction adds up.
fn hand_on(from: &Parcel, link: super::Constraint, step: &[i32; 3], spacing: &[f64; 3]) -> Parcel {
    let length: [f32; 3] = std::array::from_fn(|a| step[a].unsigned_abs() as f32 * spacing[a] as f32);
    let total: f32 = length.iter().sum();
    let translation = std::array::from_fn(|a| {
        let along = length[a];
        let across = link.shear * (total - along);
        // Moved by d, the neighbour may stay behind by the compression (when pushed) or the extension (when pulled).
        let pushed = from.translation[a] * step[a] as f32 > 0.0;
        let play = along * if pushed { 1.0 - link.min } else { link.max - 1.0 } + across;
        from.translation[a].signum() * (from.translation[a].abs() - play).max(0.0)
    });
    let play = (1.0 - link.min).min(link.shear) * total;
    let angle = if from.reach > 0.0 {
        (from.angle - play / from.reach).max(0.0)
    } else if play > 0.0 {
        0.0
    } else {
        from.angle
    };
    Parcel { translation, angle, reach: from.reach }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chainmail::Constraint;

    #[test]
    fn one_link_keeps_what_its_play_does_not_take() {
        let link = Constraint { min: 0.6, max: 1.3, shear: 0.2 };
        let from = Parcel { translation: [3.0, -2.0, 0.1], angle: 0.3, reach: 20.0 };
        let to = hand_on(&from, link, &[1, 0, 0], &[1.0, 1.0, 3.0]);
        // Pushed along +i: compression 0.4 mm; sideways shear 0.2 mm; what is within play decays to nothing.
        assert!((to.translation[0] - 2.6).abs() < 1e-6);
        assert!((to.translation[1] + 1.8).abs() < 1e-6);
        assert!(to.translation[2].abs() < 1e-6);
        assert!((to.angle - (0.3 - 0.2 / 20.0)).abs() < 1e-6);
        let pulled = hand_on(&from, link, &[-1, 0, 0], &[1.0, 1.0, 3.0]);
        assert!((pulled.translation[0] - 2.7).abs() < 1e-6);
        let rigid = hand_on(&from, crate::chainmail::material::RIGID, &[0, 0, 1], &[1.0, 1.0, 3.0]);
        assert_eq!((rigid.translation, rigid.angle), (from.translation, from.angle));
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
