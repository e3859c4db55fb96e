//! The frame that the couch has brought along.
//!
//! A patient is laid down somewhere else, before his joints move. In a frame that goes with him, what neither bones nor images
//! move stays where it is, and a field that fades with the distance from the patient fades to the couch shift.

use crate::field::{PullField, PushField, in_steps};
use crate::fit::FitResult;
use crate::geometry::{Grid, Rigid};
use crate::volume::{Mask, Volume};
use nalgebra::Vector3;
use rayon::prelude::*;

/// How far the couch has moved, LPS mm.
pub(super) struct Couch([f32; 3]);

impl Couch {
    /// Of a fit, in the middle of the planning grid.
    pub(super) fn of(fit: &FitResult, planning: &Grid) -> Self {
        let middle = planning.middle();
        let shift = fit.common * middle - middle;
        Self(in_steps([shift.x as f32, shift.y as f32, shift.z as f32]))
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
