//! What a field carries: images, labels, contours, points.
//!
//! Images and labels come through the pull field, voxel by voxel of the new grid; points go with the push field; contours become
//! a solid that the new slices cut. [`density`] changes grey values with the tissue's volume where that is asked for.

mod contours;
mod density;
mod images;
mod labels;
mod walk;

pub use contours::resample_contours;
pub use density::{Scaled, scale_by_volume};
pub use images::{Interpolation, push_point, resample, warp_image, warp_labels};
pub use labels::resample_labels;
