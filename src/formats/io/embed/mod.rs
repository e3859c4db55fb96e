//! Volumes as a page embeds them: few enough voxels for a file that is sent around, whole numbers,
//! packed.

mod grid;
mod pack;

pub use grid::{FINEST_MM, HuScale, PageGrid};
pub use pack::pack;
