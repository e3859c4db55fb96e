//! Rank 5: whether inputs can be what they are said to be, before anything long begins.
//!
//! In come images (HU) and bone labels on the planning grid, LPS mm; out go refusals and warnings. Nothing here moves
//! anything. What the fraction's bones say of it, mirrored or stretched, is judged by the fit.

mod hounsfield;
mod labels;
mod levels;
mod sides;

pub use hounsfield::{in_hounsfield, no_hounsfield};
pub use labels::labels_on_bone;
pub use levels::levels_by_landmarks;
pub use sides::sides_and_levels;

use crate::error::{Error, Result};
use crate::warning::Warning;
use serde::{Deserialize, Serialize};

/// What the checks of the inputs may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckOptions {
    /// Refuse what cannot be; else it is warned of with the same words.
    pub refuse: bool,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { refuse: true }
    }
}

impl CheckOptions {
    /// A judgement as these options want it told.
    ///
    /// # Errors
    /// The judgement's own, where it may refuse.
    pub fn told(self, judged: Result<Vec<Warning>>) -> Result<Vec<Warning>> {
        match judged {
            Err(error @ Error::Input { .. }) if !self.refuse => match error.finding() {
                Some(finding) => Ok(vec![Warning::new(finding, error.to_string())]),
                None => Err(error),
            },
            judged => judged,
        }
    }
}
