//! One set of rules for every registration and every field: what passes, what a person looks at, what fails.
//!
//! [`Limits`] is the table of limits, [`Verdict`] what a rule says of one figure. Where AAPM TG-132 (Brock et al., Med.
//! Phys. 44 (2017) e43) gives a range, a figure passes beyond the stricter end, is reviewed inside the range and fails
//! beyond the looser end. A physicist decides; no verdict accepts a registration.

mod domain;
mod folds;
mod limits;
mod warned;

pub use domain::Domain;
pub use limits::Limits;
pub use warned::{is_warning, of_warnings};

use serde::{Deserialize, Deserializer, Serialize};

/// How a figure stands to its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mark {
    /// Nothing speaks against it.
    Pass,
    /// A person looks before it is used.
    Review,
    /// Not to be used as it is.
    Fail,
}

impl Mark {
    /// In one word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Review => "review",
            Self::Fail => "fail",
        }
    }
}

/// What a rule says of one figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// What was measured, and where.
    pub name: String,
    /// Its value; no number (`null` in JSON) where it is unknown.
    #[serde(deserialize_with = "number_or_null")]
    pub value: f64,
    /// Unit of the value; empty for a ratio.
    pub unit: String,
    /// The limits in words.
    pub limit: String,
    /// Who gives the limits.
    pub source: String,
    /// How the value stands to them.
    pub verdict: Mark,
    /// Why.
    pub reason: String,
    /// What to do about it; empty where it passes.
    pub remedy: String,
}

/// JSON has no infinite value and none that is no number: it has `null`.
fn number_or_null<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

/// The worst of all verdicts; a pass where there are none.
pub fn overall(verdicts: &[Verdict]) -> Mark {
    verdicts.iter().map(|v| v.verdict).max().unwrap_or(Mark::Pass)
}

/// Those that speak against a registration, the worst first.
pub fn against(verdicts: &[Verdict]) -> Vec<&Verdict> {
    let mut all: Vec<&Verdict> = verdicts.iter().filter(|v| v.verdict > Mark::Pass).collect();
    all.sort_by_key(|v| std::cmp::Reverse(v.verdict));
    all
}

/// Those of measured figures: a warning is a verdict only where it is given, and no rule that could pass.
pub fn measured(verdicts: &[Verdict]) -> impl Iterator<Item = &Verdict> {
    verdicts.iter().filter(|v| !is_warning(v))
}

/// Name of the source of most limits.
const TG132: &str = "AAPM TG-132";

/// One figure and its rule, before it is judged.
struct Figure<'a> {
    name: String,
    value: f64,
    unit: &'a str,
    source: &'a str,
    remedy: &'a str,
}

impl Figure<'_> {
    /// Passes up to the first limit and is reviewed up to the second.
    fn at_most(self, [strict, loose]: [f64; 2]) -> Verdict {
        let mark = if self.value <= strict {
            Mark::Pass
        } else if self.value <= loose {
            Mark::Review
        } else {
            Mark::Fail
        };
        self.ranged(["up to", "beyond"], [strict, loose], mark)
    }

    /// Passes from the first limit on and is reviewed from the second on.
    fn at_least(self, [strict, loose]: [f64; 2]) -> Verdict {
        let mark = if self.value >= strict {
            Mark::Pass
        } else if self.value >= loose {
            Mark::Review
        } else {
            Mark::Fail
        };
        self.ranged(["from", "below"], [strict, loose], mark)
    }

    fn ranged(self, [word, past]: [&str; 2], [strict, loose]: [f64; 2], mark: Mark) -> Verdict {
        let unit = spaced(self.unit);
        let limit = if loose.is_finite() {
            format!("pass {word} {strict}{unit}, review {word} {loose}{unit}")
        } else {
            format!("pass {word} {strict}{unit}, else review")
        };
        let value = format!("{}{unit}", number(self.value));
        let reason = match mark {
            Mark::Pass => format!("{value}: within the limit"),
            Mark::Review => format!("{value}: {past} {strict}{unit}"),
            Mark::Fail => format!("{value}: {past} {loose}{unit}"),
        };
        self.said(limit, mark, reason)
    }

    fn said(self, limit: String, mark: Mark, reason: String) -> Verdict {
        let remedy = if mark == Mark::Pass { String::new() } else { self.remedy.into() };
        let (unit, source) = (self.unit.into(), self.source.into());
        Verdict { name: self.name, value: self.value, unit, limit, source, verdict: mark, reason, remedy }
    }
}

/// A unit behind a number.
fn spaced(unit: &str) -> String {
    if unit.is_empty() { String::new() } else { format!(" {unit}") }
}

/// A value with as many digits as a verdict needs.
fn number(value: f64) -> String {
    match value.abs() {
        v if v >= 10.0 => format!("{value:.1}"),
        v if v >= 0.1 || v == 0.0 => format!("{value:.2}"),
        v if v >= 0.001 => format!("{value:.4}"),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::Summary;

    fn mark(verdict: &Verdict) -> Mark {
        verdict.verdict
    }

    #[test]
    fn verdicts_follow_the_ranges() {
        let limits = Limits::default();
        let agreement = |mm| mark(&limits.agreement("cord", mm, 1.0));
        assert_eq!([1.9, 2.5, 3.1].map(agreement), [Mark::Pass, Mark::Review, Mark::Fail]);
        let dice = |share| mark(&limits.dice("cord", share));
        assert_eq!([0.95, 0.85, 0.79].map(dice), [Mark::Pass, Mark::Review, Mark::Fail]);
        let landmarks = |mean, max| {
            let after = Summary { n: 9, mean, max, ..Summary::default() };
            limits.landmarks(&after, 1.0).map(|v| v.verdict)
        };
        assert_eq!(landmarks(1.0, 6.0), [Mark::Pass, Mark::Review]);
        assert_eq!(landmarks(4.0, 4.5), [Mark::Fail, Mark::Pass]);
        assert_eq!([0, 1].map(|n| mark(&limits.jumps("", n))), [Mark::Pass, Mark::Review]);
        assert_eq!([1.0, 6.0, 11.0].map(|c| mark(&limits.curl("", c))), [Mark::Pass, Mark::Review, Mark::Fail]);
        assert_eq!(
            [0.1, 1.5, 4.0].map(|mm| mark(&limits.rigidity("skull", mm))),
            [Mark::Pass, Mark::Review, Mark::Fail]
        );
        // What is no number never passes.
        assert_eq!((agreement(f64::NAN), dice(f64::NAN)), (Mark::Fail, Mark::Fail));
    }

    #[test]
    fn a_figure_between_voxels_of_coarse_scans_is_looked_at_and_does_not_fail() {
        let limits = Limits::default();
        let consistency = |mm, voxel| mark(&limits.consistency("there and back", mm, voxel));
        assert_eq!(
            [consistency(3.5, 2.0), consistency(3.5, 4.0), consistency(4.5, 4.0)],
            [Mark::Fail, Mark::Review, Mark::Fail]
        );
    }

    #[test]
    fn the_worst_verdict_counts_and_every_one_tells_why_and_what_to_do() {
        let limits = Limits::default();
        let all = [limits.dice("cord", 0.95), limits.dice("parotid", 0.7), limits.dice("brain", 0.85)];
        assert_eq!((overall(&all), overall(&all[..1]), overall(&[])), (Mark::Fail, Mark::Pass, Mark::Pass));
        let worst: Vec<&str> = against(&all).iter().map(|v| v.name.as_str()).collect();
        assert_eq!(worst, ["parotid, Dice", "brain, Dice"]);
        for v in &all {
            assert!(!v.reason.is_empty() && !v.limit.is_empty(), "{v:?}");
            assert_eq!(v.remedy.is_empty(), v.verdict == Mark::Pass, "{v:?}");
        }
        assert_eq!(all[1].reason, "0.70: below 0.8");
        assert_eq!(all[0].limit, "pass from 0.9, review from 0.8");
    }
}
