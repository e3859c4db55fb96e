//! Crate of aventail: outcomes to pictures, pages and tables.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{Error, error, findings, geometry, runtime, stats, volume, warning};
use aventail_bones::{fit, postures, skeleton};
use aventail_fields::{field, view};
use aventail_formats::io;
use aventail_measures::{dose, evaluate, sampling};
use aventail_registration::{config, pipeline};
use aventail_scenes::concepts;
use aventail_tissue::chainmail;

pub mod provenance;
pub mod report;
