//! A study's tables and pictures: one record per stage, then Markdown, CSV and a page of all.

mod csv;
mod html;
mod markdown;
mod rows;

use super::pictures::{Picture, draw};
use crate::config::StudyPlan;
use crate::error::{Error, Result};
use crate::evaluate::jacobian::JacobianReport;
use crate::io::{write_file, write_json};
use crate::pipeline::{CARRYING, Case, LINKING, Outcome};
use crate::runtime::Runtime;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What a stage gave.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageRecord {
    /// What it depends on: version, settings, inputs and bone motion, as a checksum.
    pub key: String,
    /// Its settings, defaults resolved.
    pub settings: serde_json::Value,
    /// Time to carry the motion to soft tissue, seconds.
    pub seconds: f64,
    /// Number of threads.
    pub threads: usize,
    /// Jacobian characteristics.
    pub jacobian: JacobianReport,
    /// Share of chain-mail links that the result violates, percent.
    pub links_violated_percent: f64,
    /// Largest root mean square departure of a bone from rigid motion, mm.
    pub rigid_rms_mm: f64,
    /// Mean and standard deviation of the landmarks' relative residuals (thesis eq. 4.2, 4.3), when there are landmarks.
    pub residual: Option<(f64, f64)>,
    /// Mean residual after, mm.
    pub residual_mm: Option<f64>,
    /// Tissue voxels of the fraction without an exact pre-image.
    pub no_preimage: usize,
}

/// Pictures that the page shows of each stage.
const SHOWN: [&str; 3] = ["displacement.png", "jacobian.png", "fusion_after.png"];

impl StageRecord {
    /// Gathers a stage's numbers.
    pub fn new(outcome: &Outcome, settings: serde_json::Value, key: String, runtime: &Runtime) -> Self {
        Self {
            key,
            settings,
            seconds: runtime
                .times()
                .iter()
                .filter(|s| [LINKING, CARRYING].contains(&s.stage.as_str()))
                .map(|s| s.seconds)
                .sum(),
            threads: runtime.threads(),
            jacobian: outcome.jacobian_report.clone(),
            links_violated_percent: outcome.links.violated_percent,
            rigid_rms_mm: outcome.rigidity.iter().map(|r| r.rms_mm).fold(0.0, f64::max),
            residual: outcome.landmarks.as_ref().map(|l| (l.mean_of_ratios, l.std_of_ratios)),
            residual_mm: outcome.landmarks.as_ref().map(|l| l.after.mean),
            no_preimage: outcome.inverse.unconverged_tissue,
        }
    }
}

/// Files of a stage in the folder of a study: its record and its pictures.
pub fn stage_files(id: &str) -> Vec<PathBuf> {
    let pictures = SHOWN.iter().map(|p| format!("pictures/{id}_{p}"));
    std::iter::once(format!("stages/{id}.json")).chain(pictures).map(PathBuf::from).collect()
}

/// A stage's record in the folder of a study, if it is there and depends on the same things.
pub fn finished_stage(folder: &Path, id: &str, key: &str) -> Option<StageRecord> {
    let text = std::fs::read(folder.join("stages").join(format!("{id}.json"))).ok()?;
    let record: StageRecord = serde_json::from_slice(&text).ok()?;
    let drawn = SHOWN.iter().all(|p| folder.join("pictures").join(format!("{id}_{p}")).is_file());
    // Records of before the thesis's set was counted have none of its cells.
    (record.key == key && drawn && record.jacobian.all.cells > 0).then_some(record)
}

/// Writes a stage's pictures, then its record, so that a record always has its pictures.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub fn write_stage(folder: &Path, id: &str, case: &Case, outcome: &Outcome, record: &StageRecord) -> Result<()> {
    for part in ["stages", "pictures"] {
        let path = folder.join(part);
        std::fs::create_dir_all(&path)
            .map_err(|e| Error::write(&path, e.to_string(), "choose a folder that you may write to"))?;
    }
    let pictures: Vec<Picture> = draw(case, outcome)?;
    for p in pictures.iter().filter(|p| SHOWN.contains(&p.file)) {
        write_file(folder.join("pictures").join(format!("{id}_{}", p.file)), |out| out.write_all(&p.png))?;
    }
    write_json(folder.join("stages").join(format!("{id}.json")), record)
}

/// Writes the tables of a study, `study.md`, `study.csv` and `study.html`, from the records of its stages by id.
///
/// # Errors
/// [`Error::Write`] when a file cannot be written.
pub fn write_study(
    folder: &Path,
    title: &str,
    plan: &StudyPlan,
    records: &BTreeMap<String, StageRecord>,
) -> Result<String> {
    let text = markdown::page(title, plan, records);
    write_file(folder.join("study.md"), |out| out.write_all(text.as_bytes()))?;
    csv::write(&folder.join("study.csv"), plan, records)?;
    let page = html::page(title, plan, records);
    write_file(folder.join("study.html"), |out| out.write_all(page.as_bytes()))?;
    Ok(text)
}
