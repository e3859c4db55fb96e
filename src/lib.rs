//! aventail registers a planning CT to a fraction CT for adaptive radiotherapy.
//!
//! Bones move rigidly, as an articulated skeleton, and are fitted to the fraction CT; a chain mail of
//! soft-tissue elements carries their motion to every voxel. The result is a displacement vector field
//! (DVF) with the evidence for it: landmark residuals, Jacobian characteristics and fusion images.
//!
//! # A registration
//!
//! ```
//! use aventail::phantom::{Phantom, PhantomOptions};
//! use aventail::{Case, Config, Runtime, register};
//!
//! # fn main() -> aventail::Result<()> {
//! let runtime = Runtime::silent()?;
//! let phantom = Phantom::new(&PhantomOptions::default().with_spacing([6.0, 6.0, 6.0]))?;
//! let case = Case::from(phantom); // or Case::new(planning, bones, fraction), as `io` reads them
//! let outcome = register(&case, &Config::default(), &runtime)?;
//!
//! let push = &outcome.push.displacement; // on the planning grid, LPS mm
//! assert_eq!(push.data().len(), case.planning.ct.data().len());
//! let landmarks = outcome.landmarks.expect("the phantom has landmarks");
//! assert!(landmarks.after.mean < 0.4 * landmarks.before.mean);
//! # Ok(())
//! # }
//! ```
//!
//! [`report::save`] writes the same files as a run of the program; [`report::Clinic`] writes DICOM for the planning system;
//! [`field`] carries images, labels and points.
//!
//! # Frames and directions
//!
//! All positions are in the **LPS** world frame in **millimetres**; files are converted at the boundary
//! (`io`) and nowhere else. Two field types keep directions apart:
//!
//! - [`field::PushField`] on the planning grid: planning point `x` goes to `x + u(x)` in the fraction;
//! - [`field::PullField`] on the fraction grid: fraction voxel `y` shows what was at `y + v(y)` in planning.
//!
//! # Rooms
//!
//! Each room imports only from rooms of lower rank; `tests/layers.rs` proves it.
//!
//! ```text
//! 12 cli       arguments, terminal           11 session benchmark  given -> saved
//! 10 report    outcome -> files               9 provenance concepts
//! 8 io phantom                                7 pipeline   case -> outcome
//! 6 config                                    5 fit plausibility postures refine comparator
//! 4 skeleton chainmail evaluate dose sampling
//! 3 field body view                           2 volume     voxels on a grid
//! 1 geometry   grids, rigid transforms        0 error findings warning progress runtime stats
//! ```

pub use aventail_base::{Error, Result, error, findings, geometry, progress, runtime, stats, volume, warning};
pub use aventail_bones::{fit, plausibility, postures, skeleton};
pub use aventail_fields::{body, field, view};
pub use aventail_formats::io;
pub use aventail_measures::{dose, evaluate, sampling};
pub use aventail_pages::{provenance, report};
pub use aventail_registration::{config, pipeline};
pub use aventail_scenes::{concepts, phantom};
pub use aventail_sessions::{benchmark, session};
pub use aventail_tissue::{chainmail, comparator, refine};
pub use config::Config;
pub use pipeline::{Case, Outcome, register};
pub use runtime::Runtime;

pub mod cli;
