//! Rank 11: from what is given, files or memory, to saved results. The one way of program, Python package and workflow.
//!
//! A [`Request`] names what is given. [`Session::open`] reads the planning side, once; [`Session::register_all`] registers the
//! fractions one after the other and hands each [`Registered`] on, which [`Registered::save`] writes. [`pose`] makes one of a
//! motion that is given. Progress and interruption are the [`Runtime`](crate::runtime::Runtime)'s.

pub mod fields;
mod fraction;
pub mod frames;
mod headers;
mod planning;
mod posing;
mod registered;
mod registering;
mod samples;
mod source;
mod start;

pub use fraction::FractionSources;
pub use headers::{judge, within_memory};
pub use planning::{BonesBy, PlanningSources};
pub use posing::{MotionSource, PoseRequest, pose};
pub use registered::{Beside, Registered};
pub use registering::{Request, Session};
pub use samples::{DrawnSamples, SAMPLES_FOLDER, Sampled, write_samples};
pub use source::{Names, Source, bones, image, landmarks, structures};
pub use start::split;
