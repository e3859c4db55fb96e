//! Rank 6: the settings of a run. A preset, overlaid with the user's file; complete, serialisable, recorded with every
//! result.
//!
//! `settings` has the complete settings, `presets` what they start from, `legal` what they may be, `file` how a file changes
//! them, and `earlier` what files of earlier versions are read as. Plans of the study and the curve are `study`'s.

mod file;
mod legal;
mod presets;
mod recorded;
mod settings;
mod study;
#[cfg(test)]
mod tests;

pub use file::ConfigFile;
pub use recorded::{InputRole, RecordedInput};
pub use settings::{Config, Modality, OutputOptions, Preset, ScanOptions, SoftTissue};
pub use study::{Published, StudyPlan, StudyStage, StudyTable};
