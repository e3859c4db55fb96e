//! Rank 1: regular grids in the world frame and rigid transforms. World frame is LPS, millimetres.

mod grid;
mod rigid;
pub mod stencil;
mod wide;
pub mod wide_vector;

pub use grid::Grid;
pub use rigid::{Rigid, about, rigid_from_matrix, rotation_angle_deg, rotation_matrices};
pub use wide::{LANES, Wide, simd, vectorised};
