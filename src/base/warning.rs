//! Warnings: legal but unusual findings that the user should know of, on screen and in the report.

use serde::{Deserialize, Serialize};

/// One warning: a short stable code for machines, a message for people.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// Stable kebab-case name of the kind of warning, for example `bone-in-pieces`.
    pub code: String,
    /// What was found, with values, and what to do about it.
    pub message: String,
}

impl Warning {
    /// A warning from its code, which is one of [`crate::findings::FINDINGS`], and message.
    pub fn new(code: impl Into<String>, message: impl Into<String>) -> Self {
        Self { code: code.into(), message: message.into() }
    }
}
