//! What a report says of a series that was read.

use super::image::describe_series;
use super::is_dicom_path;
use super::series::Patient;
use crate::warning::counted;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::Path;

/// Whose series it is, and which.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct About {
    /// The patient; `None` where the identity is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patient: Option<Patient>,
    /// Study date, `YYYYMMDD`; empty where the identity is left out or nothing is said.
    pub study_date: String,
    /// Series Number, if there is one.
    pub number: Option<i32>,
    /// Series Description.
    pub description: String,
    /// Series date, `YYYYMMDD`.
    pub date: String,
    /// Series Instance UID.
    pub series: String,
    /// Frame of Reference UID.
    pub frame_of_reference: String,
    /// Its slices.
    pub slices: usize,
}

impl About {
    /// Of a CT or MR series; `None` where the path is no DICOM or no such series.
    pub fn of(path: &Path) -> Option<Self> {
        let (series, _) = is_dicom_path(path).then(|| describe_series(path).ok()).flatten()?;
        Some(Self {
            patient: Some(series.patient),
            study_date: series.study.date,
            number: series.number,
            description: series.description,
            date: series.date,
            series: series.uid,
            frame_of_reference: series.frame_of_reference,
            slices: series.slices.len(),
        })
    }

    /// Without the patient and what was written about the study and the series by hand.
    pub fn anonymous(self) -> Self {
        Self { patient: None, description: String::new(), ..self }
    }
}

impl fmt::Display for About {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut words = Vec::new();
        if let Some(patient) = &self.patient {
            words.push(format!("patient {}, number {}", or_none(&patient.name), or_none(&patient.id)));
        }
        words.push(format!("study of {}", or_none(&self.study_date)));
        let number = self.number.map_or("without number".into(), |n| n.to_string());
        words.push(format!("series {number} of {}, {}", or_none(&self.date), counted(self.slices, "slice", "slices")));
        if !self.description.is_empty() {
            words.push(self.description.clone());
        }
        f.write_str(&words.join("; "))
    }
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}
