//! A fit from its start to its end.

use super::FitResult;
use super::level::Level;
use super::scale::Scale;
use super::start::WEAK_START;
use crate::findings;
use crate::geometry::Rigid;
use crate::warning::Warning;

/// A fit before its last pass, which is the longest.
pub(super) struct Begun<'a> {
    pub(super) start: Start,
    pub(super) level: Option<Level<'a>>,
    pub(super) passed: Option<Passed>,
}

/// Where a fit had the bones before its last pass.
pub(super) struct Passed {
    /// Cost there; the less, the more evidence.
    pub(super) cost: f64,
    pub(super) transforms: Vec<Rigid>,
}

impl Begun<'_> {
    /// Evidence so far, as a cost; `None` where the last pass is the only one.
    pub(super) fn cost(&self) -> Option<f64> {
        self.passed.as_ref().map(|p| p.cost)
    }
}

/// What came of a start.
pub(super) struct Tried {
    pub(super) fit: FitResult,
    /// What was known before the last pass.
    pub(super) passed: Option<Passed>,
    /// Share of the bone volume in view that the image determines.
    pub(super) found: f64,
    /// Scale of the fraction.
    pub(super) scale: Scale,
    /// Cost in the end; the less, the more evidence.
    pub(super) cost: f64,
    /// What its start knew of the bones.
    pub(super) guess: Guess,
}

/// A word about a common motion that explains little of the bones' contrast.
pub(super) fn weak_start(share: f64) -> Option<Warning> {
    let problem = || {
        format!(
            "one motion of all bones explains only {:.0} % of their contrast; look at the fusion images",
            100.0 * share
        )
    };
    (share < WEAK_START).then(|| Warning::new(findings::WEAK_START, problem()))
}

/// Where a fit begins.
pub(super) struct Start {
    /// Motion of all bones together, and the share of the bones' contrast that it explains.
    pub(super) common: Rigid,
    pub(super) share: f64,
    pub(super) transforms: Vec<Rigid>,
    /// What is known of each bone.
    pub(super) guess: Guess,
}

/// What a start knows of the bones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Guess {
    /// The common motion alone: bones take over their neighbour's.
    Common,
    /// Each has a guess of its own.
    Each,
    /// Some are given; the others take over their neighbour's.
    Given,
    /// Each has one, of those in view. The rim of a large bone that is not in view must not lead.
    Searched,
}
