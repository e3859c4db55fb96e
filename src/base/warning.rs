//! Warnings: legal but unusual findings that the user should know of, on screen and in the report.

use crate::findings::Finding;
use serde::{Deserialize, Serialize};

/// A number with what is counted, in its one form or its other: `1 voxel lies`, `3 voxels lie`.
pub fn counted(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

/// One warning: a short stable code for machines, a message for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Stable kebab-case name of the kind of warning, for example `bone-in-pieces`; text, so that reports of other versions
    /// can be read.
    pub code: String,
    /// What was found, with values, and what to do about it.
    pub message: String,
}

impl Warning {
    /// A warning of a finding, one of the constants of [`crate::findings`].
    pub fn new(finding: &Finding, message: impl Into<String>) -> Self {
        Self { code: finding.code.into(), message: message.into() }
    }

    /// Whether this warning is of that finding.
    pub fn is(&self, finding: &Finding) -> bool {
        self.code == finding.code
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_one() {
        let told = [0, 1, 2].map(|n| counted(n, "voxel lies", "voxels lie"));
        assert_eq!(told, ["0 voxels lie", "1 voxel lies", "2 voxels lie"]);
    }
}
