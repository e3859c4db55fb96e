//! Push to pull: for every fraction voxel `y` the `v` with `v + u(y + v) = 0`.
//!
//! In: a [`super::PushField`], the fraction's grid, where bones come to lie ([`MovedBones`]). Out: the [`super::PullField`] to 1e-3 mm.
//! [`invert()`] starts each voxel where the mesh says that the tissue came from, or where its row leads, and polishes by fixed
//! point and Newton steps ([`newton`]); [`pre_image`] is the same for one point. What was tried: docs/decisions/fields.md.

mod bones;
mod invert;
mod newton;
pub(super) mod pre_image;
mod reach;
mod search;
mod sides;

pub use bones::MovedBones;
pub use invert::{Inverse, InverseReport, invert};
pub use pre_image::{InvertOptions, Solved};
pub use sides::take_sides;
