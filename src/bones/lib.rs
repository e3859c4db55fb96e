//! Crate of aventail: the jointed skeleton, the pose that explains an image, and postures drawn at random.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{error, findings, geometry, progress, stats, volume, warning};
use aventail_measures::evaluate;

pub mod fit;
pub mod plausibility;
pub mod postures;
pub mod skeleton;
