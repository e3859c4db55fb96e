//! Crate of aventail: plain types, geometry and volumes: what everything else stands on.
//!
//! The program and its documentation are in the package `aventail`, which re-exports these rooms.

pub mod error;
pub mod findings;
pub mod geometry;
pub mod parallel;
pub mod progress;
pub mod runtime;
pub mod stats;
pub mod volume;
pub mod warning;

pub use error::{Error, Result};
