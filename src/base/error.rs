//! The one error type. Every message names the file or thing, the value found and what to do about it.
//!
//! Variants hold paths, names and texts only, never domain types, so that every room can raise them.

use crate::findings::Finding;
use std::path::{Path, PathBuf};

/// Result with aventail's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What went wrong, by cause. [`Error::exit_code`] gives each cause its process exit code.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The command line or the configuration asks for something that does not exist or cannot be.
    #[error("{problem}\n  remedy: {remedy}")]
    Usage {
        /// What is wrong, with the value found.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A file is missing, truncated, or not in a format that can be read.
    #[error("cannot read {}: {problem}\n  remedy: {remedy}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What is wrong, with the value found.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// The inputs were read but do not fit the task or each other.
    #[error("{what}: {problem}{}\n  remedy: {remedy}", bracketed(*finding))]
    Input {
        /// What kind of finding it is, where it is one.
        finding: Option<&'static Finding>,
        /// The file or thing at fault.
        what: String,
        /// What is wrong, with the value found.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A result cannot be written.
    #[error("cannot write {}: {problem}\n  remedy: {remedy}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// The registration itself has no trustworthy answer, for example images without overlap.
    #[error("registration failed: {problem}{}\n  remedy: {remedy}", bracketed(*finding))]
    Registration {
        /// What kind of finding it is, where it is one.
        finding: Option<&'static Finding>,
        /// What is wrong, with the value found.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A defect of aventail: something that cannot happen did.
    #[error("internal error: {0}\n  remedy: this is a defect of aventail; please report it with the command line")]
    Internal(String),
}

/// A finding's code behind a message.
fn bracketed(finding: Option<&Finding>) -> String {
    finding.map_or_else(String::new, |f| format!(" [{}]", f.code))
}

/// Letters of a line that a message shows at most.
const LONGEST: usize = 600;
/// So many of them are its last: there a program's words say why it failed.
const LAST: usize = 200;

/// A text whose lines lose their middle: of a wrong file one line may be megabytes.
fn clipped(text: String) -> String {
    if text.len() <= LONGEST {
        return text;
    }
    let clip = |line: &str| {
        let letters = line.char_indices().map(|(at, _)| at);
        let (mut first, mut last) = (letters.clone().skip(LONGEST - LAST), letters.rev());
        match (first.next(), first.nth(LAST), last.nth(LAST - 1)) {
            (Some(end), Some(_), Some(start)) => format!("{} ... {}", &line[..end], &line[start..]),
            _ => line.to_owned(),
        }
    };
    text.lines().map(clip).collect::<Vec<_>>().join("\n")
}

impl Error {
    /// [`Error::Usage`] from texts.
    pub fn usage(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Usage { problem: clipped(problem.into()), remedy: remedy.into() }
    }
    /// [`Error::Read`] from a path and texts.
    pub fn read(path: impl AsRef<Path>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Read { path: path.as_ref().into(), problem: clipped(problem.into()), remedy: remedy.into() }
    }
    /// [`Error::Input`] from texts.
    pub fn input(what: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Input { finding: None, what: what.into(), problem: clipped(problem.into()), remedy: remedy.into() }
    }
    /// [`Error::Input`] of a finding, one of the constants of [`crate::findings`].
    pub fn refused(
        finding: &'static Finding,
        what: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Input { finding: Some(finding), what: what.into(), problem: problem.into(), remedy: remedy.into() }
    }
    /// [`Error::Write`] from a path and texts.
    pub fn write(path: impl AsRef<Path>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Write { path: path.as_ref().into(), problem: problem.into(), remedy: remedy.into() }
    }
    /// [`Error::Registration`] from texts.
    pub fn registration(problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Registration { finding: None, problem: problem.into(), remedy: remedy.into() }
    }
    /// [`Error::Registration`] of a finding, one of the constants of [`crate::findings`].
    pub fn failed(finding: &'static Finding, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Registration { finding: Some(finding), problem: problem.into(), remedy: remedy.into() }
    }
    /// The finding that this error tells of, where it is one.
    pub fn finding(&self) -> Option<&'static Finding> {
        match self {
            Self::Input { finding, .. } | Self::Registration { finding, .. } => *finding,
            _ => None,
        }
    }
    /// Whether this error is of that finding.
    pub fn is(&self, finding: &Finding) -> bool {
        self.finding() == Some(finding)
    }
    /// The code of the finding for machines; empty where there is none.
    pub fn code(&self) -> &'static str {
        self.finding().map_or("", |f| f.code)
    }

    /// What is wrong, with the value found; without the file or thing at fault, which [`Error::what`] names.
    pub fn problem(&self) -> &str {
        match self {
            Self::Usage { problem, .. }
            | Self::Read { problem, .. }
            | Self::Input { problem, .. }
            | Self::Write { problem, .. }
            | Self::Registration { problem, .. }
            | Self::Internal(problem) => problem,
        }
    }

    /// The file or thing at fault, where one is.
    pub fn what(&self) -> Option<String> {
        match self {
            Self::Read { path, .. } | Self::Write { path, .. } => Some(path.display().to_string()),
            Self::Input { what, .. } => Some(what.clone()),
            Self::Usage { .. } | Self::Registration { .. } | Self::Internal(_) => None,
        }
    }

    /// What the user can do; of a defect nothing but to report it.
    pub fn remedy(&self) -> &str {
        match self {
            Self::Usage { remedy, .. }
            | Self::Read { remedy, .. }
            | Self::Input { remedy, .. }
            | Self::Write { remedy, .. }
            | Self::Registration { remedy, .. } => remedy,
            Self::Internal(_) => "report it with the command line",
        }
    }

    /// Process exit code of this cause: 1 internal, 2 usage, 3 unreadable file, 4 unsuitable input,
    /// 5 unwritable output, 6 registration failed.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Internal(_) => 1,
            Self::Usage { .. } => 2,
            Self::Read { .. } => 3,
            Self::Input { .. } => 4,
            Self::Write { .. } => 5,
            Self::Registration { .. } => 6,
        }
    }
}
