//! Crate of aventail: files to domain types and back.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{error, findings, geometry, progress, volume, warning};
use aventail_bones::{fit, postures, skeleton};
use aventail_fields::{field, view};
use aventail_measures::{dose, evaluate, sampling};

pub mod io;
