//! The frame that the couch has brought along.
//!
//! A patient is laid down somewhere else, before his joints move. In a frame that goes with him, what neither bones nor images
//! move stays where it is, and a field that fades with the distance from the patient fades to the mean motion.

use crate::chainmail::Carry;
use crate::field::{PullField, PushField, in_steps};
use crate::fit::FitResult;
use crate::geometry::{Grid, Rigid};
use crate::volume::{Mask, Volume};
use nalgebra::Vector3;
use rayon::prelude::*;

/// How far the middle of the planning grid has moved with all bones, LPS mm.
pub(super) fn common_shift(fit: &FitResult, planning: &Grid) -> Vector3<f64> {
    let middle = planning.middle();
    fit.common * middle - middle
}

/// The same as displacements are stored.
pub(super) struct Couch([f32; 3]);

impl Couch {
    /// Of a fit, in the middle of the planning grid. Motion that dies out with the play of the links dies out to none in the
    /// scanner's frame, as the thesis has it.
    pub(super) fn of(fit: &FitResult, planning: &Grid, carry: Carry) -> Self {
        match carry {
            Carry::Rigid => {
                let shift = common_shift(fit, planning);
                Self(in_steps([shift.x as f32, shift.y as f32, shift.z as f32]))
            }
            Carry::Translation | Carry::ConstraintBased | Carry::LinearDecay => Self([0.0; 3]),
        }
    }

    fn back(&self) -> Vector3<f64> {
        -Vector3::from(self.0.map(f64::from))
    }

    /// Motions from planning into the frame.
    pub(super) fn transforms(&self, transforms: &[Rigid]) -> Vec<Rigid> {
        let back = Rigid::from_parts(self.back().into(), nalgebra::UnitQuaternion::identity());
        transforms.iter().map(|t| back * t).collect()
    }

    /// A grid of the fraction in the frame.
    pub(super) fn grid(&self, fraction: &Grid) -> Grid {
        fraction.shifted(&self.back())
    }

    /// A volume of the fraction in the frame.
    pub(super) fn volume<T>(&self, fraction: Volume<T>) -> Volume<T> {
        fraction.shifted(&self.back())
    }

    /// Displacements into the frame as displacements into the fraction.
    pub(super) fn added(&self, mut displacement: Volume<[f32; 3]>) -> Volume<[f32; 3]> {
        let add = |u: &mut [f32; 3]| (0..3).for_each(|a| u[a] += self.0[a]);
        displacement.data_mut().par_iter_mut().with_min_len(1 << 14).for_each(add);
        displacement
    }

    /// A push field into the frame as one into the fraction.
    pub(super) fn push(&self, push: PushField) -> PushField {
        PushField { displacement: self.added(push.displacement), computed: push.computed }
    }

    /// A pull field of the frame as one of the fraction.
    pub(super) fn pull(&self, pull: PullField) -> PullField {
        let there = -self.back();
        let back = Self(self.0.map(|c| -c));
        let inside: Mask = pull.inside.shifted(&there);
        PullField { displacement: back.added(pull.displacement).shifted(&there), inside }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::push_point;
    use nalgebra::{Point3, UnitQuaternion};

    #[test]
    fn motion_that_dies_out_does_so_in_the_frame_of_the_scanner() {
        let planning = Grid::axis_aligned([12, 11, 10], [3.0; 3], [5.0, -20.0, 100.0]).unwrap();
        let fit = FitResult {
            transforms: Vec::new(),
            pose: crate::skeleton::Pose::default(),
            bones: Vec::new(),
            common: Rigid::translation(30.5, -4.25, 12.0),
            common_share: 1.0,
            open: None,
            warnings: Vec::new(),
        };
        let bits = |carry| Couch::of(&fit, &planning, carry).0.map(f32::to_bits);
        assert_eq!(bits(Carry::Rigid), [30.5f32, -4.25, 12.0].map(f32::to_bits));
        for carry in [Carry::Translation, Carry::ConstraintBased, Carry::LinearDecay] {
            assert_eq!(bits(carry), [0; 3]);
        }
    }

    #[test]
    fn fields_of_the_frame_are_fields_of_the_fraction() {
        let couch = Couch([30.5, -4.25, 12.0]);
        let planning = Grid::axis_aligned([12, 11, 10], [3.0; 3], [5.0, -20.0, 100.0]).unwrap();
        let fraction = planning.shifted(&Vector3::new(31.0, -3.0, 11.0));
        // In the frame everything moves by 1 mm to the left.
        let moved = |grid: &Grid, by: f32| Volume::filled(grid.clone(), [by, 0.0, 0.0]);
        let computed = Volume::filled(planning.clone(), true);
        let push = couch.push(PushField { displacement: moved(&planning, 1.0), computed });
        let x = planning.centre([4, 5, 6]);
        let y = push_point(&push, &x).unwrap();
        assert!((y - x - Vector3::new(31.5, -4.25, 12.0)).norm() < 1e-5, "{y}");
        let there = couch.grid(&fraction);
        let inside = Volume::filled(there.clone(), true);
        let pull = couch.pull(PullField { displacement: moved(&there, -1.0), inside });
        assert!(pull.displacement.grid().matches(&fraction, 1e-9) && pull.inside.grid().matches(&fraction, 1e-9));
        let v = Vector3::from(pull.displacement.at([4, 5, 6]).map(f64::from));
        let back: Point3<f64> = fraction.centre([4, 5, 6]) + v;
        assert!((back - (fraction.centre([4, 5, 6]) - Vector3::new(31.5, -4.25, 12.0))).norm() < 1e-5);
        let turned =
            Rigid::from_parts(Vector3::new(1.0, 2.0, 3.0).into(), UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3));
        let [there] = couch.transforms(&[turned])[..] else { panic!("one for one") };
        assert!((there * x - (turned * x - Vector3::new(30.5, -4.25, 12.0))).norm() < 1e-9);
    }
}
