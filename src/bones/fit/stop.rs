//! Why an optimisation of the fit stopped.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Why the last optimisation that moved a bone stopped. In files it is its words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", from = "String")]
pub enum Stop {
    /// A step moved nothing by the tolerance, and nothing asked for a longer one.
    Converged,
    /// The cost did not fall where its derivatives say that it does, however short the step.
    NoDescent,
    /// It used up so many iterations.
    IterationLimit(u64),
    /// There was none: the bone follows its joint.
    FollowsJoint,
    /// There was none, the bone's motion has a source; or the optimiser had another reason. In words.
    Other(String),
}

const CONVERGED: &str = "converged";
const NO_DESCENT: &str = "converged (no better pose near)";
/// How earlier reports tell it.
const NO_DESCENT_EARLIER: &str = "no descent found";
const ITERATION_LIMIT: &str = "iteration limit ";
const FOLLOWS_JOINT: &str = "follows its joint";

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Converged => f.write_str(CONVERGED),
            Self::NoDescent => f.write_str(NO_DESCENT),
            Self::IterationLimit(most) => write!(f, "{ITERATION_LIMIT}{most}"),
            Self::FollowsJoint => f.write_str(FOLLOWS_JOINT),
            Self::Other(words) => f.write_str(words),
        }
    }
}

impl From<Stop> for String {
    fn from(stop: Stop) -> Self {
        stop.to_string()
    }
}

impl From<String> for Stop {
    fn from(words: String) -> Self {
        let limit = words.strip_prefix(ITERATION_LIMIT).and_then(|most| most.parse().ok());
        match (words.as_str(), limit) {
            (_, Some(most)) => Self::IterationLimit(most),
            (CONVERGED, _) => Self::Converged,
            (NO_DESCENT | NO_DESCENT_EARLIER, _) => Self::NoDescent,
            (FOLLOWS_JOINT, _) => Self::FollowsJoint,
            _ => Self::Other(words),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_gives_back_what_it_was_told() {
        for (stop, words) in [
            (Stop::Converged, "converged"),
            (Stop::NoDescent, "converged (no better pose near)"),
            (Stop::IterationLimit(50), "iteration limit 50"),
            (Stop::FollowsJoint, "follows its joint"),
            (Stop::Other("12 landmarks, 0.40 mm rms".into()), "12 landmarks, 0.40 mm rms"),
        ] {
            assert_eq!(String::from(stop.clone()), words);
            assert_eq!(Stop::from(words.to_owned()), stop);
        }
        assert_eq!(Stop::from("no descent found".to_owned()), Stop::NoDescent);
    }
}
