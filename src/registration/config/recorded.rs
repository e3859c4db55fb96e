//! What a report records of its inputs.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::PathBuf;

/// The roles, each with its name and what it says, from one list.
macro_rules! roles {
    ($($role:ident = $name:literal, $about:literal;)*) => {
        /// What a file is to the run that reads it; as text in kebab-case, which is its option where it has one.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(into = "&'static str", from = "String")]
        pub enum InputRole {
            $(#[doc = $about] $role,)*
            /// What a report of another version names that this one does not know.
            Other,
        }

        impl InputRole {
            /// All but [`InputRole::Other`].
            const KNOWN: &[Self] = &[$(Self::$role),*];

            /// Its name.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$role => $name,)*
                    Self::Other => "other",
                }
            }
        }
    };
}

roles! {
    Planning = "planning", "Planning CT.";
    Bones = "bones", "Bone labels, or a structure set with bones.";
    Fraction = "fraction", "Fraction CT.";
    Labels = "labels", "Names of labels.";
    Organs = "organs", "Labels of organs.";
    Skeleton = "skeleton", "Skeleton in place of the built one.";
    Landmarks = "landmarks", "Evaluation landmarks.";
    BoneLandmarks = "bone-landmarks", "Landmarks on bones.";
    FractionBones = "fraction-bones", "Bone labels in the fraction.";
    FractionLabels = "fraction-labels", "Names of the fraction's bone labels.";
    Guide = "guide", "Guides: structures in planning.";
    FractionGuide = "fraction-guide", "Guides: structures in the fraction.";
    GuideLabels = "guide-labels", "Names of the guides' labels.";
    Start = "start", "Motion that the fit begins with.";
    Structures = "structures", "Structures.";
    Dose = "dose", "Dose.";
    Reference = "reference", "Dose that another one is compared with.";
    Ct = "ct", "CT that a dose is mapped with.";
    Grid = "grid", "Image that a grid is taken from.";
    PageCt = "page-ct", "CT under the dose of a page.";
    DoseCt = "dose-ct", "CT under the compared dose.";
    Mask = "mask", "Mask of what is evaluated.";
    LabelsPlanning = "labels-planning", "Structures drawn on the planning CT.";
    LabelsFraction = "labels-fraction", "Structures drawn on the fraction CT.";
    Samples = "samples", "Samples of a registration.";
    Plan = "plan", "Plan of a study, a curve or postures.";
    Around = "around", "Third scan of the patient, around which errors are measured.";
    Peers = "peers", "Figures of other tools.";
    Pose = "pose", "Pose given by hand.";
    Transforms = "transforms", "Motions of bones.";
    Cbct = "cbct", "Settings of a cone-beam CT.";
    Fit = "fit", "Report of a run whose pose is learnt from.";
    Report = "report", "Report of a run.";
    Case = "case", "Report of the run that a study is of.";
    PlanningToFraction = "planning-to-fraction", "Field on the planning grid, to the fraction.";
    FractionToPlanning = "fraction-to-planning", "Field on the fraction grid, to planning.";
    Fields = "fields", "One of several fields.";
    Field = "field", "A field that is carried along.";
    Compare = "compare", "Another tool's field.";
    Then = "then", "Field onward from the fraction.";
    Direct = "direct", "Field straight to where `then` leads.";
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
        Self::KNOWN.iter().copied().find(|role| role.name() == name).unwrap_or(Self::Other)
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
        for &role in InputRole::KNOWN {
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
