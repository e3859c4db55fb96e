//! Everything that aventail warns of or refuses for a reason of its own: a constant for each finding, and the table of all.
//!
//! A finding is raised by [`crate::warning::Warning::new`], [`crate::Error::refused`] or [`crate::Error::failed`], which take
//! its constant, so that nothing is raised that the table does not hold; `tests/findings.rs` proves that everything in the
//! table is raised, as it says it is, and makes `docs/refusals.md` from it.

/// How a finding is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Told {
    /// The run goes on and says so.
    Warned,
    /// Nothing is written.
    Refused,
    /// Refused where it is certain, warned of where it is doubtful.
    RefusedOrWarned,
}

/// One kind of finding.
#[derive(Debug, PartialEq, Eq)]
pub struct Finding {
    /// Stable kebab-case name.
    pub code: &'static str,
    /// How it is told.
    pub told: Told,
    /// Whether a warning of it puts the result itself in doubt, so that the run's verdict asks for a look. The others tell of
    /// files, of what is judged by its figures, or of what is expected.
    pub doubted: bool,
    /// What was found.
    pub reason: &'static str,
    /// What to do about it.
    pub remedy: &'static str,
}

impl Finding {
    /// The finding of a code, as reports hold it.
    pub fn of(code: &str) -> Option<&'static Self> {
        FINDINGS.iter().copied().find(|f| f.code == code)
    }
}

const fn warned(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::Warned, doubted: false, reason, remedy }
}

const fn doubted(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::Warned, doubted: true, reason, remedy }
}

const fn refused(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::Refused, doubted: false, reason, remedy }
}

const fn refused_or_warned(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::RefusedOrWarned, doubted: false, reason, remedy }
}

const fn refused_or_doubted(code: &'static str, reason: &'static str, remedy: &'static str) -> Finding {
    Finding { code, told: Told::RefusedOrWarned, doubted: true, reason, remedy }
}

/// A constant for each finding of a file, and their table.
macro_rules! findings {
    ($table:ident: $($name:ident = $told:ident($code:literal, $reason:literal, $remedy:literal $(,)?);)*) => {
        $(
            #[doc = $reason]
            pub const $name: &crate::findings::Finding = &crate::findings::$told($code, $reason, $remedy);
        )*

        /// Those of this file.
        pub(super) const $table: &[&crate::findings::Finding] = &[$($name),*];
    };
}

mod bones;
mod dicom;
mod dose;
mod fields;
mod files;
mod images;
mod labels;

pub use bones::*;
pub use dicom::*;
pub use dose::*;
pub use fields::*;
pub use files::*;
pub use images::*;
pub use labels::*;

/// All findings, by subject.
pub const FINDINGS: &[&Finding] = &joined::<ALL>();

const PARTS: [&[&Finding]; 7] = [BONES, DICOM, DOSES, FIELDS, FILES, IMAGES, LABELS];

const ALL: usize = BONES.len() + DICOM.len() + DOSES.len() + FIELDS.len() + FILES.len() + IMAGES.len() + LABELS.len();

/// The parts of the table as one.
const fn joined<const N: usize>() -> [&'static Finding; N] {
    let mut all = [BONES[0]; N];
    let (mut n, mut part) = (0, 0);
    while part < PARTS.len() {
        let mut at = 0;
        while at < PARTS[part].len() {
            all[n] = PARTS[part][at];
            (n, at) = (n + 1, at + 1);
        }
        part += 1;
    }
    all
}
