//! Rank 11: from inputs, in files or memory, to saved results. Program, Python package and workflow all use it.
//!
//! A [`Request`] names what is given. [`Session::open`] reads the planning side, once; [`Session::register_all`] registers the
//! fractions one after the other and passes on each [`Registered`], which [`Registered::save`] writes. [`pose`] makes one from
//! a given motion. Progress and interruption are the [`Runtime`](crate::runtime::Runtime)'s.

pub mod fields;
mod fraction;
pub mod frames;
mod headers;
mod modality;
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
pub use source::{LabelSources, Names, Source, bones, image, landmarks, structures};
pub use start::split;
