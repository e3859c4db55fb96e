//! Rank 4: how good a field is. Landmark residuals, Jacobian characteristics and rigidity of bones.

pub mod jacobian;
pub mod landmark;
pub mod rigidity;
