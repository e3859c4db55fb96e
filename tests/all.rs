//! The tests of the program and of whole registrations, as one test program: its threads take the
//! next test of any file, so that no core waits for the longest test of each, and what several
//! files need is made once.
//!
//! `cargo test --release --test all capture::` runs those of tests/capture.rs. A new file needs a
//! line here (`tests/layers.rs` looks for it).

mod accuracy;
mod capture;
mod cli;
mod clinic;
mod couch;
mod curve;
mod dicom;
mod docs;
mod dose;
mod evaluate;
mod files;
mod finished;
mod fractions;
mod guide;
mod guides;
mod images;
mod invariance;
mod labels;
mod library;
mod mr;
mod page;
mod phantom;
mod pose;
mod print;
mod real_cases;
#[path = "refusals/main.rs"]
mod refusals;
mod samples;
mod skeleton_on_phantom;
mod slicer;
mod stress;
mod summary;
mod support;
mod sweep;
mod warp;
