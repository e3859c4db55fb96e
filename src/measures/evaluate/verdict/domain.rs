//! Where a field is measured: what a rule says of tissue it cannot say of air.

use super::{Mark, Verdict};
use serde::{Deserialize, Serialize};

/// Where regularity and consistency of a field are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Domain {
    /// In the tissue of the patient.
    #[default]
    Tissue,
    /// In the mask that was given.
    Mask,
    /// Everywhere, air included, since nothing tells where tissue is.
    Grid,
}

impl Domain {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tissue => "tissue",
            Self::Mask => "given mask",
            Self::Grid => "whole grid, air included",
        }
    }

    /// A verdict on what was measured there. Folds, jumps and gaps of a field in air harm nobody: of the whole grid none fails,
    /// and a person looks at it.
    pub fn judged(self, verdict: Verdict) -> Verdict {
        if self != Self::Grid {
            return verdict;
        }
        let name = match verdict.name.contains(self.name()) {
            true => verdict.name,
            false => format!("{}, {}", verdict.name, self.name()),
        };
        let (mark, reason) = match verdict.verdict {
            Mark::Fail => (Mark::Review, format!("{}; not failed, since air counts, too", verdict.reason)),
            mark => (mark, verdict.reason),
        };
        Verdict { name, verdict: mark, reason, ..verdict }
    }
}
