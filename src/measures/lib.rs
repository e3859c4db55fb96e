//! Crate of aventail: what a registration is judged by, dose on a deforming patient, and samples of its errors.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{Error, error, findings, geometry, runtime, stats, volume, warning};
use aventail_fields::{body, field};

pub mod dose;
pub mod evaluate;
pub mod sampling;
