//! Crate of aventail: registrations from files or memory to saved results, and what the hot paths cost.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{error, findings, geometry, progress, runtime, stats, volume, warning};
use aventail_bones::{fit, skeleton};
use aventail_fields::{body, field};
use aventail_formats::io;
use aventail_measures::{evaluate, sampling};
use aventail_pages::{provenance, report};
use aventail_registration::{config, pipeline};
use aventail_scenes::phantom;
use aventail_tissue::{chainmail, refine};

pub mod benchmark;
pub mod session;
