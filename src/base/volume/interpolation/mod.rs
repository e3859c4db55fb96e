//! Values between voxels: every interpolation of images and fields, each with what it is for.
//!
//! | file | what | precision | outside the voxel centres | used by |
//! |---|---|---|---|---|
//! | [`trilinear`](trilinear()), [`trilinear_vector`] | value of an image, of a field | double | none | all |
//! | [`Surrounding`] | weights of the eight voxels and their slopes | double | none | chain mail, consistency, dose |
//! | [`corners`] | value and slope from eight corners at hand | double | the caller's | fit |
//! | [`cubic`](cubic()) | value and slope of an image, once differentiable | single | none | fit |
//! | [`lanes`] | field and slope at eight places of a row | single | the edge's value goes on | inverse, consistency |
//!
//! They agree where they meet; `tests.rs` holds all of them to one set of properties: linear functions are
//! reproduced, slopes are those of the values, voxel centres keep their values, the hull's edge belongs to it.

mod cubic;
pub mod lanes;
mod place;
#[cfg(test)]
mod tests;
mod trilinear;

pub use cubic::cubic;
pub use lanes::nearest;
pub use place::{axis_pairs, place};
pub use trilinear::{Surrounding, corners, trilinear, trilinear_vector, weights};
