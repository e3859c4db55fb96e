//! Figures beside the tolerances of AAPM TG-132 and of the literature: pass, review or fail, never a verdict on the whole.
//!
//! TG-132 (Brock et al., Med. Phys. 44 (2017) e43, Table III) gives ranges. A figure passes beyond the stricter end, is to be
//! reviewed inside the range and fails beyond the looser end. A physicist decides; no mark here accepts a registration.

use serde::{Deserialize, Serialize};

/// How a figure stands to its tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mark {
    /// Beyond the stricter end of the tolerance.
    Pass,
    /// Inside the range of tolerances: a person looks.
    Review,
    /// Beyond the looser end.
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

/// One figure beside its tolerance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Checked {
    /// What was measured, and where.
    pub figure: String,
    /// Its value.
    pub value: f64,
    /// Unit of the value; empty for a ratio.
    pub unit: String,
    /// The tolerance in words.
    pub tolerance: String,
    /// Who gives the tolerance.
    pub source: String,
    /// How the value stands to it.
    pub mark: Mark,
}

/// Name of the source of most tolerances.
const TG132: &str = "AAPM TG-132";

fn checked(figure: String, value: f64, unit: &str, tolerance: &str, source: &str, mark: Mark) -> Checked {
    Checked { figure, value, unit: unit.into(), tolerance: tolerance.into(), source: source.into(), mark }
}

/// Pass up to `strict`, review up to `loose`.
fn at_most(value: f64, strict: f64, loose: f64) -> Mark {
    if value <= strict {
        Mark::Pass
    } else if value <= loose {
        Mark::Review
    } else {
        Mark::Fail
    }
}

/// Mean target registration error (2 to 3 mm) and the greatest (5 mm; beyond it is a matter of review).
pub fn landmarks(mean: f64, max: f64) -> [Checked; 2] {
    [
        checked(
            "landmarks, mean residual".into(),
            mean,
            "mm",
            "largest voxel edge, 2 to 3 mm",
            TG132,
            at_most(mean, 2.0, 3.0),
        ),
        checked(
            "landmarks, greatest residual".into(),
            max,
            "mm",
            "5 mm (test data sets)",
            TG132,
            at_most(max, 5.0, f64::INFINITY),
        ),
    ]
}

/// Mean distance to agreement of a structure (2 to 3 mm).
pub fn agreement(name: &str, mean: f64) -> Checked {
    let tolerance = "contouring uncertainty, 2 to 3 mm";
    checked(format!("{name}, mean distance to agreement"), mean, "mm", tolerance, TG132, at_most(mean, 2.0, 3.0))
}

/// Dice of a structure (0.80 to 0.90).
pub fn dice(name: &str, dice: f64) -> Checked {
    let mark = at_most(-dice, -0.9, -0.8);
    checked(format!("{name}, Dice"), dice, "", "contouring uncertainty, 0.80 to 0.90", TG132, mark)
}

/// Folded volume: none is allowed; where only bone contact or a sliding interface folds, a person looks.
pub fn folds(direction: &str, folded_ml: f64, in_contact: usize) -> Checked {
    let mark = match (folded_ml > 0.0, in_contact > 0) {
        (true, _) => Mark::Fail,
        (false, true) => Mark::Review,
        (false, false) => Mark::Pass,
    };
    checked(format!("folded volume, {direction}"), folded_ml, "ml", "no negative Jacobian", TG132, mark)
}

/// 95th percentile of a consistency error (2 to 3 mm).
pub fn consistency(what: &str, p95: f64) -> Checked {
    let tolerance = "largest voxel edge, 2 to 3 mm";
    checked(format!("{what}, 95th percentile"), p95, "mm", tolerance, TG132, at_most(p95, 2.0, 3.0))
}

/// Neighbouring Jacobians that differ by more than 10: errors of the field.
pub fn jumps(direction: &str, count: usize) -> Checked {
    let mark = if count == 0 { Mark::Pass } else { Mark::Review };
    let source = "Bartelheimer 2019, 2.3.2";
    checked(format!("Jacobian jumps above 10, {direction}"), count as f64, "pairs", "none", source, mark)
}

/// Greatest curl: 0 to 5 is physical, 5 to 10 unphysical.
pub fn curl(direction: &str, greatest: f64) -> Checked {
    let mark = at_most(greatest, 5.0, 10.0);
    checked(
        format!("greatest curl, {direction}"),
        greatest,
        "",
        "0 to 5 valid, 5 to 10 unphysical",
        "Schreibmann 2012",
        mark,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_follow_the_ranges() {
        assert_eq!([1.9, 2.5, 3.1].map(|v| agreement("cord", v).mark), [Mark::Pass, Mark::Review, Mark::Fail]);
        assert_eq!([0.95, 0.85, 0.79].map(|v| dice("cord", v).mark), [Mark::Pass, Mark::Review, Mark::Fail]);
        assert_eq!(landmarks(1.0, 6.0).map(|c| c.mark), [Mark::Pass, Mark::Review]);
        let fold = |ml, contact| folds("planning to fraction", ml, contact).mark;
        assert_eq!([fold(0.0, 0), fold(0.0, 3), fold(0.01, 0)], [Mark::Pass, Mark::Review, Mark::Fail]);
        assert_eq!([jumps("", 0).mark, jumps("", 1).mark], [Mark::Pass, Mark::Review]);
        assert_eq!(
            [curl("", 1.0).mark, curl("", 6.0).mark, curl("", 11.0).mark],
            [Mark::Pass, Mark::Review, Mark::Fail]
        );
        assert_eq!(at_most(f64::NAN, 1.0, 2.0), Mark::Fail);
    }
}
