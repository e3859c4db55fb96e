//! The numbers of a run: what `report.json` holds and the page shows.

use super::searched::{FittedPlace, SearchedPlace, fitted, searched};
use crate::chainmail::{LinkReport, Pruning};
use crate::config::InputRole;
use crate::error::{Error, Result};
use crate::evaluate::agreement::Agreement;
use crate::evaluate::contact::ContactReport;
use crate::evaluate::couch::CouchMatch;
use crate::evaluate::jacobian::JacobianReport;
use crate::evaluate::landmark::LandmarkReport;
use crate::evaluate::rigidity::BoneRigidity;
use crate::evaluate::uncertainty::UncertaintyReport;
use crate::evaluate::verdict::{Limits, Mark, Verdict, overall};
use crate::field::{ConsistencyReport, InverseReport};
use crate::fit::{BoneFit, DeterminedBy};
use crate::geometry::Grid;
use crate::pipeline::{Case, FractionKind, GuideReached, Outcome, VolumeReached, judge, moves_most};
use crate::provenance::InputFile;
use crate::runtime::{StageTime, peak_memory};
use crate::skeleton::Pose;
use crate::warning::{Warning, counted};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// How a run was started, as far as the outcome does not know it.
#[derive(Debug, Clone, Default)]
pub struct Run {
    /// The command line.
    pub command: String,
    /// The settings it ran with, defaults resolved.
    pub settings: serde_json::Value,
    /// Input files with checksums.
    pub inputs: Vec<InputFile>,
    /// Number of threads.
    pub threads: usize,
    /// Wall time of each stage.
    pub stages: Vec<StageTime>,
    /// Files that were written beside the report.
    pub outputs: Vec<OutputFile>,
    /// By which limits it is judged.
    pub limits: Limits,
}

/// A file that a run wrote.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutputFile {
    /// Its name inside the output folder.
    pub name: String,
    /// What it holds, in words: grid, direction, unit.
    pub what: String,
    /// SHA-256 of its bytes, hexadecimal; empty in reports from before there were any.
    #[serde(default)]
    pub sha256: String,
}

impl OutputFile {
    /// A file that has just been written into `folder`.
    ///
    /// # Errors
    /// [`Error::Read`] when it cannot be read back.
    pub fn written(folder: &Path, name: &str, what: &str) -> Result<Self> {
        let sha256 = crate::io::checksum::sha256_file(folder.join(name))?;
        Ok(Self { name: name.into(), what: what.into(), sha256 })
    }
}

/// The numbers of a run. Lengths in mm, positions in LPS mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of aventail.
    pub version: String,
    /// When the report was made, seconds since 1970-01-01 UTC.
    pub created: u64,
    /// The command line.
    pub command: String,
    /// The folder that it was written into, without links; the run may have been moved since.
    #[serde(default)]
    pub folder: String,
    /// Input files with checksums, their paths as seen from the folder of the report.
    pub inputs: Vec<InputFile>,
    /// The settings it ran with, defaults resolved.
    pub settings: serde_json::Value,
    /// The worst of the verdicts. Earlier reports lack it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Mark>,
    /// What the rules say of each figure that has a limit, and of warnings that count.
    #[serde(default)]
    pub verdicts: Vec<Verdict>,
    /// Grid of the planning CT.
    pub planning_grid: Grid,
    /// Grid of the fraction CT.
    pub fraction_grid: Grid,
    /// Mean motion of all that the scans show, at the middle of the planning scan, planning to fraction.
    #[serde(alias = "couch_shift")]
    pub common_shift: Vector3<f64>,
    /// The couch shift, matched on bones, and what it leaves of each.
    #[serde(default)]
    pub couch: CouchMatch,
    /// What kind of image the fraction is; nothing where images took no part in soft tissue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fraction_kind: Option<FractionKind>,
    /// Each bone's fit.
    pub bones: Vec<BoneFit>,
    /// Motion of each bone's centroid apart from the couch shift, mm, in the order of the bones.
    #[serde(default)]
    pub own_motion_mm: Vec<f64>,
    /// Places of all bones that a search has proposed, best first; nothing where a quick start was enough.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub search: Vec<SearchedPlace>,
    /// Places where all bones were fitted, the result first; nothing where that is the only one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<FittedPlace>,
    /// Motion of each joint, in the order of the bones.
    pub pose: Pose,
    /// How rigidly the field moves each bone.
    pub rigidity: Vec<BoneRigidity>,
    /// Jacobian characteristics.
    pub jacobian: JacobianReport,
    /// Bones that overlap or come apart, and skin on skin.
    #[serde(default)]
    pub contact: ContactReport,
    /// Volumes that were asked to change.
    #[serde(default)]
    pub volume_changes: Vec<VolumeReached>,
    /// Structures that guided.
    #[serde(default)]
    pub guides: Vec<GuideReached>,
    /// How far the result may be trusted, when it was asked for.
    pub uncertainty: Option<UncertaintyReport>,
    /// How far the images agree, where a fraction was registered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<Agreement>,
    /// Waves that were pruned, and the most that this can change; where a bound is known.
    #[serde(default, alias = "let_go")]
    pub pruning: Option<Pruning>,
    /// Chain-mail links.
    pub links: LinkReport,
    /// Quality of the inverse.
    pub inverse: InverseReport,
    /// Planning to fraction and back through both fields.
    pub consistency: ConsistencyReport,
    /// Landmark residuals, when landmarks were given.
    pub landmarks: Option<LandmarkReport>,
    /// Warnings.
    pub warnings: Vec<Warning>,
    /// Wall time of each stage.
    pub stages: Vec<StageTime>,
    /// Number of threads.
    pub threads: usize,
    /// Peak resident memory, bytes, where the system tells.
    pub peak_memory: Option<u64>,
    /// Files that were written beside the report.
    pub outputs: Vec<OutputFile>,
}

impl Report {
    /// Reads the `report.json` of a run; `remedy`: what to do where it is none.
    ///
    /// # Errors
    /// [`Error::Read`] when the file cannot be read or is no report.
    pub fn read(path: &Path, remedy: &str) -> Result<Self> {
        let text = std::fs::read(path).map_err(|e| Error::read(path, e.to_string(), remedy))?;
        serde_json::from_slice(&text).map_err(|e| Error::read(path, format!("it is no report of a run ({e})"), remedy))
    }

    /// As JSON for machines; its code is made here, once.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when a value has no JSON.
    pub fn json(&self) -> Result<String> {
        crate::io::json(self)
    }

    /// Gathers the numbers of a run; peak memory and time are of now.
    pub fn new(case: &Case, outcome: &Outcome, run: &Run) -> Self {
        let verdicts = judge(case, outcome, &run.limits);
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            created: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs()),
            command: run.command.clone(),
            folder: String::new(),
            inputs: run.inputs.clone(),
            settings: run.settings.clone(),
            verdict: Some(overall(&verdicts)),
            verdicts,
            planning_grid: case.planning.ct.grid().clone(),
            fraction_grid: case.fraction.ct.grid().clone(),
            common_shift: outcome.common_shift,
            couch: outcome.couch.clone(),
            fraction_kind: outcome.kind.clone(),
            bones: outcome.bone_fits.clone(),
            own_motion_mm: outcome.own_motion_mm(),
            search: searched(outcome),
            places: fitted(outcome),
            pose: outcome.pose.clone(),
            rigidity: outcome.rigidity.clone(),
            jacobian: outcome.jacobian_report.clone(),
            contact: outcome.contact.clone(),
            volume_changes: outcome.volume_changes.clone(),
            guides: outcome.guides.clone(),
            uncertainty: outcome.uncertainty.as_ref().map(|u| u.1),
            agreement: outcome.agreement,
            pruning: outcome.pruning,
            links: outcome.links,
            inverse: outcome.inverse,
            consistency: outcome.consistency,
            landmarks: outcome.landmarks.clone(),
            warnings: outcome.warnings.clone(),
            stages: run.stages.clone(),
            threads: run.threads,
            peak_memory: peak_memory(),
            outputs: run.outputs.clone(),
        }
    }

    /// Wall time of all stages, seconds.
    pub fn seconds(&self) -> f64 {
        self.stages.iter().map(|s| s.seconds).sum()
    }

    /// Largest departure of any bone from rigid motion, root mean square, mm, and the bone.
    pub fn least_rigid(&self) -> Option<&BoneRigidity> {
        self.rigidity.iter().max_by(|a, b| a.rms_mm.total_cmp(&b.rms_mm))
    }

    /// The bone that moves most apart from the couch shift, and how far, mm.
    pub fn moves_most(&self) -> Option<(&BoneFit, f64)> {
        let n = moves_most(&self.bones, &self.own_motion_mm)?;
        Some((self.bones.get(n)?, *self.own_motion_mm.get(n)?))
    }

    /// Whether planning and fraction are one scan by their bytes: a slip, or a test that nothing moves.
    pub fn one_scan(&self) -> bool {
        let of = |role: InputRole| self.inputs.iter().find(|i| i.role == role).map(|i| (&i.sha256, &i.entry));
        of(InputRole::Planning).is_some_and(|planning| of(InputRole::Fraction) == Some(planning))
    }

    /// Number of bones that the image determined.
    pub fn bones_by_image(&self) -> usize {
        self.bones.iter().filter(|b| b.determined_by == DeterminedBy::Image).count()
    }
}

/// What is said where [`Report::one_scan`] holds.
pub(super) const ONE_SCAN: &str = "planning and fraction are one and the same scan: nothing had to move";

/// The first words of a text, in so many letters about; nothing where it is no longer than that.
pub(super) fn first_words(text: &str, letters: usize) -> Option<&str> {
    let (end, _) = text.char_indices().nth(letters)?;
    Some(text[..end].rsplit_once(' ').map_or(&text[..end], |(head, _)| head))
}

/// A number of threads in words.
pub(super) fn threads(n: usize) -> String {
    counted(n, "thread", "threads")
}

/// A count with its thousands set apart by thin spaces, as `2 118 297`.
pub(super) fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

/// Date and time in UTC, as `2026-11-21 03:05 UTC`, of seconds since 1970.
pub(super) fn utc(seconds: u64) -> String {
    // Civil date from day number: Hinnant, "chrono-compatible low-level date algorithms", with years from March.
    let (days, rest) = (seconds / 86_400 + 719_468, seconds % 86_400);
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    let year = 400 * era + year_of_era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02} {:02}:{:02} UTC", rest / 3_600, rest / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::example;

    #[test]
    fn dates() {
        assert_eq!(utc(0), "1970-01-01 00:00 UTC");
        assert_eq!(utc(951_782_399), "2000-02-28 23:59 UTC");
        assert_eq!(utc(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(utc(1_795_230_300), "2026-11-21 03:05 UTC");
    }

    #[test]
    fn thousands_stand_apart() {
        assert_eq!([0, 999, 1_000, 2_118_297].map(count), ["0", "999", "1\u{202f}000", "2\u{202f}118\u{202f}297"]);
    }

    #[test]
    fn one_scan_in_place_of_two_is_told() {
        let (case, outcome, mut run) = example::small();
        assert!(!Report::new(&case, &outcome, &run).one_scan());
        let planning = run.inputs[0].sha256.clone();
        run.inputs[2].sha256 = planning;
        let report = Report::new(&case, &outcome, &run);
        assert!(report.one_scan() && super::super::table::terminal_table(&report).contains(ONE_SCAN));
    }

    #[test]
    fn json_round_trip() {
        let (case, outcome, run) = example::small();
        let report = Report::new(&case, &outcome, &run);
        let text = serde_json::to_string(&report).unwrap();
        let back: Report = serde_json::from_str(&text).unwrap();
        assert_eq!(back, report);
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value["inputs"][0]["sha256"].as_str().unwrap().len(), 64);
        assert_eq!(value["settings"], run.settings);
    }
}
