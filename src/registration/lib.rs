//! Crate of aventail: settings, and what turns a case into an outcome.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{Error, error, findings, geometry, progress, runtime, stats, volume, warning};
use aventail_bones::{fit, plausibility, postures, skeleton};
use aventail_fields::{body, field, view};
use aventail_formats::io;
use aventail_measures::{dose, evaluate};
use aventail_scenes::phantom;
use aventail_tissue::{chainmail, comparator, refine};

pub mod benchmark;
pub mod config;
pub mod pipeline;
