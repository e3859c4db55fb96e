//! Crate of aventail: the chain mail of soft tissue, its refinement by images, and simpler models to compare with.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{error, geometry, progress, stats, volume};
use aventail_fields::{body, field};
#[cfg(test)]
use aventail_measures::evaluate;

pub mod chainmail;
pub mod comparator;
pub mod refine;
