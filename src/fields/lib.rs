//! Crate of aventail: displacement fields in both directions, and the patient in a CT.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

use aventail_base::{error, findings, geometry, stats, volume, warning};

pub mod body;
pub mod field;
pub mod view;
