//! Plans of a study: which settings are run side by side, in which tables, beside which published numbers.

use super::{Config, ConfigFile};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::collections::HashSet;
use std::path::Path;

/// Tables of a study.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyPlan {
    /// The tables, in the order of the page.
    #[serde(rename = "table")]
    pub tables: Vec<StudyTable>,
}

/// Stages that are compared in one table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyTable {
    /// Heading.
    pub title: String,
    /// Where the published numbers come from.
    pub source: String,
    /// Its rows.
    #[serde(rename = "stage")]
    pub stages: Vec<StudyStage>,
}

/// One way to carry the bones' motion to soft tissue.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyStage {
    /// Name of its files; stages of the same name are the same and run once.
    pub id: String,
    /// What it is, in words.
    pub name: String,
    /// Settings, overlaid on those of the preset that they name.
    pub settings: Map<String, Value>,
    /// The published numbers of the same stage, as far as there are any.
    #[serde(default)]
    pub published: Vec<Published>,
}

/// Numbers that a publication gives for one patient; Jacobian characteristics as its Tab. 2 defines them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// Whose.
    pub patient: String,
    /// J < 0, percent of all voxels.
    pub folded: Option<f64>,
    /// J > 2, percent of positive ones.
    pub above_2: Option<f64>,
    /// J < 0.5, percent of positive ones.
    pub below_half: Option<f64>,
    /// Mean of the positive ones.
    pub mean: Option<f64>,
    /// Greatest.
    pub max: Option<f64>,
    /// Mean relative residual.
    pub residual_mean: Option<f64>,
    /// Its standard deviation.
    pub residual_std: Option<f64>,
    /// Time as printed, minutes:seconds.
    pub time: Option<String>,
}

/// The plan that makes the tables of the thesis again.
const THESIS: &str = include_str!("../../../data/study.toml");

/// The plan of the curve of error against run time.
const CURVE: &str = include_str!("../../../data/curve.toml");

impl StudyPlan {
    /// Settings that cost time, each varied alone.
    ///
    /// # Errors
    /// Never: a test resolves the shipped plan.
    pub fn curve() -> Result<Self> {
        Self::parse(CURVE).map_err(Error::Internal)
    }

    /// Tables 3 to 11 of the thesis.
    ///
    /// # Errors
    /// Never: a test resolves the shipped plan.
    pub fn thesis() -> Result<Self> {
        Self::parse(THESIS).map_err(Error::Internal)
    }

    /// Reads a plan.
    ///
    /// # Errors
    /// [`Error::Read`] when the file is missing or no plan.
    pub fn read(path: &Path) -> Result<Self> {
        let remedy = "data/study.toml of the sources is an example of a plan";
        let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e.to_string(), remedy))?;
        Self::parse(&text).map_err(|e| Error::read(path, e, remedy))
    }

    fn parse(text: &str) -> Result<Self, String> {
        let plan: Self = toml::from_str(text.trim_start_matches('\u{feff}')).map_err(|e| e.to_string())?;
        let mut known: Vec<&StudyStage> = Vec::new();
        for stage in plan.tables.iter().flat_map(|t| &t.stages) {
            let legal = !stage.id.is_empty() && stage.id.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
            if !legal {
                return Err(format!("stage id {:?} names a file: use letters, digits and hyphens", stage.id));
            }
            if known.iter().any(|k| k.id == stage.id && k.settings != stage.settings) {
                return Err(format!("stage {} appears twice with different settings", stage.id));
            }
            known.push(stage);
        }
        Ok(plan)
    }

    /// Each stage once, with its complete settings.
    ///
    /// # Errors
    /// [`Error::Usage`], naming the stage, when its settings are not legal.
    pub fn stages(&self) -> Result<Vec<(&StudyStage, Config)>> {
        let mut seen = HashSet::new();
        let once = self.tables.iter().flat_map(|t| &t.stages).filter(|s| seen.insert(s.id.as_str()));
        once.map(|stage| {
            let file = ConfigFile { settings: stage.settings.clone(), ..ConfigFile::default() };
            let config = file
                .resolve(None)
                .map_err(|e| Error::usage(format!("stage {}: {e}", stage.id), "change the plan's settings"))?;
            Ok((stage, config))
        })
        .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_curve_varies_settings_that_differ_from_the_default() {
        let plan = StudyPlan::curve().unwrap();
        for (stage, config) in plan.stages().unwrap() {
            assert_eq!(config == Config::default(), stage.id == "default", "{}", stage.id);
        }
        assert!(plan.tables.iter().all(|t| t.stages.iter().any(|s| s.settings.is_empty())));
    }

    #[test]
    fn the_shipped_plan_is_legal_and_has_the_tables_of_the_thesis() {
        let plan = StudyPlan::thesis().unwrap();
        let stages = plan.stages().unwrap();
        assert!(plan.tables.len() >= 5 && stages.len() >= 16, "{} stages", stages.len());
        // What is not the same stage is not the same settings.
        for (n, (a, x)) in stages.iter().enumerate() {
            for (b, y) in &stages[..n] {
                assert_ne!(x, y, "{} and {}", a.id, b.id);
            }
        }
    }

    #[test]
    fn plans_with_faults_are_refused_by_name() {
        let plan = |id: &str, more: &str| {
            format!(
                "[[table]]\ntitle = 'T'\nsource = ''\n[[table.stage]]\nid = '{id}'\nname = 'n'\nsettings = {{}}\n{more}"
            )
        };
        assert!(StudyPlan::parse(&plan("a/b", "")).unwrap_err().contains("a/b"));
        let twice = "[[table.stage]]\nid = 'a'\nname = 'm'\nsettings = { preset = 'thesis' }\n";
        assert!(StudyPlan::parse(&plan("a", twice)).unwrap_err().contains("twice"));
        let bad = StudyPlan::parse(&plan("a", "").replace("{}", "{ chainmail = { exponent = -1.0 } }")).unwrap();
        assert!(bad.stages().unwrap_err().to_string().contains("stage a"));
    }
}
