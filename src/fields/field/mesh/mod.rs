//! The planning grid as a mesh that a push field deforms: voxels are vertices, each cell five tetrahedra (thesis 4.2.5, after
//! Rodriguez).
//!
//! In: a [`super::PushField`]. Out: the Jacobian of each cell and which cells fold ([`jacobian`]), voxels with more than one
//! pre-image ([`multiple`]), where the patient lies on himself ([`overlap`]), images resampled without an inverse ([`scatter`]) and
//! what lies at each voxel of another grid ([`tetrahedra`]), from which the inverse starts.

mod cells;
mod jacobian;
mod multiple;
mod overlap;
mod scatter;
pub(super) mod tetrahedra;

pub use jacobian::{FOLDED, RowOfCells, digital_folds, folded_anywhere, folded_cells, jacobian, jacobian_by_rows};
pub use multiple::multiple_preimages;
pub use overlap::overlaps;
pub use scatter::{Resampling, ScatterReport, scatter_image};
