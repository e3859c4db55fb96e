//! What a report records of its inputs.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::PathBuf;

/// What a file is to the run that reads it; as text in kebab-case, which is its option where it has one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "&'static str", from = "String")]
pub enum InputRole {
    /// Planning CT.
    Planning,
    /// Bone labels, or a structure set with bones.
    Bones,
    /// Fraction CT.
    Fraction,
    /// Names of labels.
    Labels,
    /// Labels of organs.
    Organs,
    /// Skeleton in place of the built one.
    Skeleton,
    /// Evaluation landmarks.
    Landmarks,
    /// Landmarks on bones.
    BoneLandmarks,
    /// Motion that the fit begins with.
    Start,
    /// Structures.
    Structures,
    /// Dose.
    Dose,
    /// Dose that another one is compared with.
    Reference,
    /// CT that a dose is mapped with.
    Ct,
    /// Image that a grid is taken from.
    Grid,
    /// CT under the dose of a page.
    PageCt,
    /// CT under the compared dose.
    DoseCt,
    /// Mask of what is evaluated.
    Mask,
    /// Structures drawn on the planning CT.
    LabelsPlanning,
    /// Structures drawn on the fraction CT.
    LabelsFraction,
    /// Plan of a study, a curve or postures.
    Plan,
    /// Figures of other tools.
    Peers,
    /// Pose given by hand.
    Pose,
    /// Motions of bones.
    Transforms,
    /// Settings of a cone-beam CT.
    Cbct,
    /// Report of a run whose pose is learnt from.
    Fit,
    /// Report of a run.
    Report,
    /// Report of the run that a study is of.
    Case,
    /// Field on the planning grid, to the fraction.
    PlanningToFraction,
    /// Field on the fraction grid, to planning.
    FractionToPlanning,
    /// One of several fields.
    Fields,
    /// A field that is carried along.
    Field,
    /// Another tool's field.
    Compare,
    /// Field onward from the fraction.
    Then,
    /// Field straight to where `then` leads.
    Direct,
    /// What a report of another version names that this one does not know.
    Other,
}

impl InputRole {
    /// All but [`InputRole::Other`].
    const KNOWN: [Self; 34] = [
        Self::Planning,
        Self::Bones,
        Self::Fraction,
        Self::Labels,
        Self::Organs,
        Self::Skeleton,
        Self::Landmarks,
        Self::BoneLandmarks,
        Self::Start,
        Self::Structures,
        Self::Dose,
        Self::Reference,
        Self::Ct,
        Self::Grid,
        Self::PageCt,
        Self::DoseCt,
        Self::Mask,
        Self::LabelsPlanning,
        Self::LabelsFraction,
        Self::Plan,
        Self::Peers,
        Self::Pose,
        Self::Transforms,
        Self::Cbct,
        Self::Fit,
        Self::Report,
        Self::Case,
        Self::PlanningToFraction,
        Self::FractionToPlanning,
        Self::Fields,
        Self::Field,
        Self::Compare,
        Self::Then,
        Self::Direct,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Planning => "planning",
            Self::Bones => "bones",
            Self::Fraction => "fraction",
            Self::Labels => "labels",
            Self::Organs => "organs",
            Self::Skeleton => "skeleton",
            Self::Landmarks => "landmarks",
            Self::BoneLandmarks => "bone-landmarks",
            Self::Start => "start",
            Self::Structures => "structures",
            Self::Dose => "dose",
            Self::Reference => "reference",
            Self::Ct => "ct",
            Self::Grid => "grid",
            Self::PageCt => "page-ct",
            Self::DoseCt => "dose-ct",
            Self::Mask => "mask",
            Self::LabelsPlanning => "labels-planning",
            Self::LabelsFraction => "labels-fraction",
            Self::Plan => "plan",
            Self::Peers => "peers",
            Self::Pose => "pose",
            Self::Transforms => "transforms",
            Self::Cbct => "cbct",
            Self::Fit => "fit",
            Self::Report => "report",
            Self::Case => "case",
            Self::PlanningToFraction => "planning-to-fraction",
            Self::FractionToPlanning => "fraction-to-planning",
            Self::Fields => "fields",
            Self::Field => "field",
            Self::Compare => "compare",
            Self::Then => "then",
            Self::Direct => "direct",
            Self::Other => "other",
        }
    }
}

impl fmt::Display for InputRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl From<InputRole> for &'static str {
    fn from(role: InputRole) -> Self {
        role.name()
    }
}

impl From<String> for InputRole {
    fn from(name: String) -> Self {
        Self::KNOWN.into_iter().find(|role| role.name() == name).unwrap_or(Self::Other)
    }
}

/// One input of an earlier run, as its report records it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct RecordedInput {
    /// What it was to that run.
    pub role: InputRole,
    /// Where it lies, seen from the folder of the report, or as it was given.
    pub path: PathBuf,
    /// SHA-256 of the file then.
    pub sha256: String,
    /// What was given behind `#`.
    #[serde(default)]
    pub entry: Option<String>,
}

impl RecordedInput {
    /// The path as it was given, with what stood behind `#`.
    pub fn given(&self) -> PathBuf {
        let mut path = self.path.clone().into_os_string();
        if let Some(entry) = &self.entry {
            path.push("#");
            path.push(entry);
        }
        path.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_role_is_read_as_it_is_written_and_strange_ones_are_other() {
        for role in InputRole::KNOWN {
            let text = serde_json::to_string(&role).unwrap();
            assert_eq!(text, format!("\"{}\"", role.name()));
            assert_eq!(serde_json::from_str::<InputRole>(&text).unwrap(), role);
        }
        assert_eq!(serde_json::from_str::<InputRole>("\"of the future\"").unwrap(), InputRole::Other);
        let debug: Vec<String> = InputRole::KNOWN.iter().map(|r| format!("{r:?}").to_lowercase()).collect();
        let names: Vec<String> = InputRole::KNOWN.iter().map(|r| r.name().replace('-', "")).collect();
        assert_eq!(debug, names, "names are the variants' own");
    }
}
