//! Crate of aventail: what a registration is judged by, and dose on a deforming patient.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{Error, error, findings, geometry, runtime, stats, volume, warning};
use aventail_fields::{body, field};

pub mod dose;
pub mod evaluate;
