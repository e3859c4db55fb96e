//! Crate of aventail: settings, and what turns a case into an outcome.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{error, findings, geometry, progress, runtime, stats, volume, warning};
use aventail_bones::{fit, plausibility, postures, skeleton};
use aventail_fields::{body, field, view};
use aventail_measures::{dose, evaluate, sampling};
use aventail_tissue::{chainmail, comparator, refine};

pub mod config;
pub mod pipeline;
