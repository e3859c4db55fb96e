//! Fields read at many places at once, eight voxels of a row: where displaced places lie ([`walk`]), values and gradients there
//! ([`sampler`]). In single precision and the same bits on every machine; the kernels under warping and inversion.

pub(super) mod sampler;
pub(super) mod walk;
