//! Rank 4: how good a field is. Landmark residuals and Jacobian characteristics.

pub mod jacobian;
pub mod landmark;
