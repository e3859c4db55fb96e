//! Fields of either direction, ours or another tool's, with the missing one made by inversion.

use crate::error::Result;
use crate::field::{InverseReport, InvertOptions, PullField, PushField, invert};
use crate::geometry::Grid;
use crate::volume::{Volume, trilinear_vector};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Which way a field points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// On the planning grid: planning x goes to x + u(x) in the fraction.
    PlanningToFraction,
    /// On the fraction grid: fraction y shows planning y + v(y).
    FractionToPlanning,
}

impl Direction {
    /// The other way.
    #[must_use]
    pub fn reversed(self) -> Self {
        match self {
            Self::PlanningToFraction => Self::FractionToPlanning,
            Self::FractionToPlanning => Self::PlanningToFraction,
        }
    }

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::PlanningToFraction => "planning to fraction",
            Self::FractionToPlanning => "fraction to planning",
        }
    }
}

/// Both directions of one registration.
#[derive(Debug, Clone)]
pub struct FieldPair {
    /// Planning to fraction.
    pub push: PushField,
    /// Fraction to planning.
    pub pull: PullField,
    /// Which directions were given; the other was made by inversion.
    pub given: Vec<Direction>,
    /// How well the inversion went; `None` when both were given.
    pub inversion: Option<InverseReport>,
}

impl FieldPair {
    /// Completes what was given; `planning` and `fraction` are the grids of an inversion. `None` for no field at all.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn new(
        push: Option<Volume<[f32; 3]>>,
        pull: Option<Volume<[f32; 3]>>,
        planning: Option<&Grid>,
        fraction: Option<&Grid>,
    ) -> Result<Option<Self>> {
        let all = |grid: &Grid| Volume::filled(grid.clone(), true);
        let options = InvertOptions::default();
        let as_push = |u: Volume<[f32; 3]>| PushField { computed: all(u.grid()), displacement: u };
        let as_pull = |v: Volume<[f32; 3]>| PullField { inside: all(v.grid()), displacement: v };
        Ok(match (push, pull) {
            (Some(u), Some(v)) => Some(Self {
                push: as_push(u),
                pull: as_pull(v),
                given: vec![Direction::PlanningToFraction, Direction::FractionToPlanning],
                inversion: None,
            }),
            (Some(u), None) => {
                let push = as_push(u);
                let to = fraction.unwrap_or(push.displacement.grid()).clone();
                let (pull, report) = invert(&push, &to, None, &options)?;
                Some(Self { push, pull, given: vec![Direction::PlanningToFraction], inversion: Some(report) })
            }
            (None, Some(v)) => {
                // The inverse of a pull field is found as that of a push field: the roles of the images change.
                let from = as_push(v);
                let to = planning.unwrap_or(from.displacement.grid()).clone();
                let (back, report) = invert(&from, &to, None, &options)?;
                let push = PushField { displacement: back.displacement, computed: back.inside };
                let pull = as_pull(from.displacement);
                Some(Self { push, pull, given: vec![Direction::FractionToPlanning], inversion: Some(report) })
            }
            (None, None) => None,
        })
    }
}

/// A field's displacement at a point; `None` outside its grid.
pub(super) fn displacement(field: &Volume<[f32; 3]>, p: &Point3<f64>) -> Option<Vector3<f64>> {
    trilinear_vector(field, &inner(field.grid(), p))
}

/// Continuous index; what lies outside by single-precision rounding only counts as inside.
pub(super) fn inner(grid: &Grid, p: &Point3<f64>) -> Vector3<f64> {
    let size = grid.size();
    let mut index = grid.index(p);
    for a in 0..3 {
        let last = (size[a] - 1) as f64;
        if index[a] < 0.0 && index[a] > -1e-3 {
            index[a] = 0.0;
        } else if index[a] > last && index[a] < last + 1e-3 {
            index[a] = last;
        }
    }
    index
}

/// The field at the voxels of another grid, linear; the identity outside its own.
pub(super) fn on_grid(field: &Volume<[f32; 3]>, grid: &Grid) -> Result<Volume<[f32; 3]>> {
    let data = per_voxel(grid, |p| displacement(field, &p).map_or([0.0; 3], |u| u.map(|c| c as f32).into()));
    Volume::new(grid.clone(), data)
}

/// `value(centre)` of each voxel, in parallel over planes.
pub(super) fn per_voxel<T: Send + Clone + Default>(grid: &Grid, value: impl Fn(Point3<f64>) -> T + Sync) -> Vec<T> {
    let [nx, ny, _] = grid.size();
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(nx * ny).enumerate().for_each(|(k, plane)| {
        for (n, o) in plane.iter_mut().enumerate() {
            *o = value(grid.centre([n % nx, n / nx, k]));
        }
    });
    out
}

/// The nearest voxel's value at a point; `T::default()` outside the grid.
pub(super) fn nearest<T: Copy + Default>(volume: &Volume<T>, p: &Point3<f64>) -> T {
    volume.grid().voxel_at(p).map(|voxel| *volume.at(voxel)).unwrap_or_default()
}
