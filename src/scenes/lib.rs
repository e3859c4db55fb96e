//! Crate of aventail: anatomy with known truth, and the concept figures of the thesis.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{error, geometry, progress, volume};
use aventail_bones::skeleton;
use aventail_fields::field;
use aventail_measures::evaluate;
use aventail_registration::pipeline;
use aventail_tissue::chainmail;

pub mod concepts;
pub mod phantom;
