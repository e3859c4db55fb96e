//! Many runs side by side: a table of their figures, what stands apart, and each patient's course over the fractions.

mod doses;
mod figures;
mod fractions;
mod gather;
mod odd;
mod page;
mod text;

pub use doses::CourseDose;
pub use fractions::Fractions;
pub use gather::Summary;

use super::numbers::Report;
use crate::config::InputRole;
use crate::error::Result;
use crate::evaluate::verdict::{Mark, Verdict, against, is_warning};
use crate::findings;
use crate::io::write_file;
use crate::warning::Warning;
use figures::KINDS;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// One run of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Member {
    /// Whose it is.
    pub patient: String,
    /// What the fraction is called.
    pub fraction: String,
    /// When the fraction was scanned, `YYYYMMDD`; empty where nothing tells.
    pub date: String,
    /// Its folder as seen from that of the summary.
    #[serde(serialize_with = "crate::io::path_as_text")]
    pub folder: PathBuf,
    /// SHA-256 of its planning CT; empty where its report names no file.
    pub planning_sha256: String,
    /// Version of aventail that made it.
    pub version: String,
    /// Its figures by name, with the unit in the name; nothing where the run has none.
    pub figures: BTreeMap<&'static str, Option<f64>>,
    /// The worst verdict of its own report; nothing in reports of earlier versions.
    pub verdict: Option<Mark>,
    /// What that verdict rests on.
    pub reasons: Vec<String>,
    /// Figures that stand apart from those of the cohort.
    pub stand_apart: Vec<&'static str>,
    /// Codes of its warnings, and of what the summary found of it.
    pub warnings: Vec<String>,
}

/// Why a run is held back: the figure and what is said of it, of a warning what it says.
fn why(verdict: &Verdict) -> String {
    if is_warning(verdict) { verdict.reason.clone() } else { format!("{}: {}", verdict.name, verdict.reason) }
}

impl Member {
    /// Of a report, whose run lies in `folder` as seen from that of the summary.
    pub fn new(patient: String, fraction: String, folder: PathBuf, report: &Report) -> Self {
        let input = |role: InputRole| report.inputs.iter().find(|i| i.role == role);
        let about = input(InputRole::Fraction).and_then(|i| i.about.as_ref());
        let mut warnings: Vec<String> = report.warnings.iter().map(|w| w.code.clone()).collect();
        warnings.dedup();
        let worst = against(&report.verdicts).into_iter().filter(|v| Some(v.verdict) == report.verdict);
        Self {
            patient,
            fraction,
            date: about.map_or(String::new(), |a| a.date.clone()),
            folder,
            planning_sha256: input(InputRole::Planning).map_or(String::new(), |i| i.sha256.clone()),
            version: report.version.clone(),
            figures: KINDS.iter().map(|kind| (kind.key, kind.of(report))).collect(),
            verdict: report.verdict,
            reasons: worst.into_iter().map(why).collect(),
            stand_apart: Vec::new(),
            warnings,
        }
    }

    /// Codes that its own report warns of, or of what the summary alone found of it.
    fn codes(&self, by_summary: bool) -> impl Iterator<Item = &String> {
        self.warnings.iter().filter(move |code| (**code == findings::PLANNING_DIFFERS.code) == by_summary)
    }

    fn figure(&self, key: &str) -> Option<f64> {
        self.figures.get(key).copied().flatten()
    }
}

/// Many runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cohort {
    /// Version of aventail.
    pub version: String,
    /// When it was made, seconds since 1970-01-01 UTC.
    pub created: u64,
    /// The command line.
    pub command: String,
    /// Median of each figure over the runs that have it.
    pub medians: BTreeMap<&'static str, Option<f64>>,
    /// The runs, by patient and then by date and name of the fraction.
    pub runs: Vec<Member>,
    /// Folders of runs that are at work or were stopped.
    pub unfinished: Vec<String>,
    /// What was found of several runs.
    pub warnings: Vec<Warning>,
    /// Doses over the course with their intervals, where they were given.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub doses: Vec<CourseDose>,
}

impl Cohort {
    /// Sorts the runs and finds what stands apart.
    pub fn new(mut runs: Vec<Member>, unfinished: Vec<String>, command: String) -> Self {
        runs.sort_by_cached_key(|m| (natural(&m.patient), m.date.clone(), natural(&m.fraction), m.folder.clone()));
        let mut medians = BTreeMap::new();
        for kind in &KINDS {
            let values: Vec<Option<f64>> = runs.iter().map(|m| m.figure(kind.key)).collect();
            medians.insert(kind.key, odd::median(values.iter().flatten().copied()));
            let apart = odd::outliers(&values, kind.worse, kind.least);
            runs.iter_mut().zip(apart).filter(|(_, apart)| *apart).for_each(|(m, _)| m.stand_apart.push(kind.key));
        }
        let warnings = several_plannings(&mut runs);
        let created = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
        let (version, doses) = (env!("CARGO_PKG_VERSION").into(), Vec::new());
        Self { version, created, command, medians, runs, unfinished, warnings, doses }
    }

    /// The runs of each patient.
    fn patients(&self) -> impl Iterator<Item = &[Member]> {
        self.runs.chunk_by(|a, b| a.patient == b.patient)
    }

    /// What a person should know, as text for the terminal.
    pub fn terminal_text(&self) -> String {
        text::terminal(self)
    }

    /// Writes `summary.csv` and `summary.html` into `folder`, which exists.
    ///
    /// # Errors
    /// [`crate::error::Error::Write`] when a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        write_file(folder.join("summary.csv"), |out| out.write_all(&text::csv(self)?))?;
        write_file(folder.join("summary.html"), |out| out.write_all(page::page(self).as_bytes()))
    }
}

/// Tells of runs of one patient that were made of different planning CTs: two patients of one name, or a patient planned anew.
/// `runs` are sorted by patient.
fn several_plannings(runs: &mut [Member]) -> Vec<Warning> {
    let mut warnings = Vec::new();
    for patient in runs.chunk_by_mut(|a, b| a.patient == b.patient) {
        let mut by_planning: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for m in patient.iter().filter(|m| !m.planning_sha256.is_empty()) {
            by_planning.entry(&m.planning_sha256).or_default().push(m.folder.display().to_string());
        }
        if by_planning.len() < 2 {
            continue;
        }
        let each: Vec<String> = by_planning
            .iter()
            .map(|(sha256, folders)| {
                format!("{} of SHA-256 {}", folders.join(", "), sha256.get(..12).unwrap_or(sha256))
            })
            .collect();
        let message = format!(
            "{}: its runs use {} planning CTs and may belong to as many patients: {}",
            patient[0].patient,
            each.len(),
            each.join("; ")
        );
        patient.iter_mut().for_each(|m| m.warnings.push(findings::PLANNING_DIFFERS.code.to_owned()));
        warnings.push(Warning::new(findings::PLANNING_DIFFERS, message));
    }
    warnings
}

/// A name in the order that people give it: runs of digits count as numbers.
fn natural(name: &str) -> Vec<(String, u64)> {
    let mut parts = vec![(String::new(), 0)];
    for c in name.chars() {
        let (text, number) = parts.last_mut().map_or((true, 0), |p: &mut (String, u64)| (p.1 == 0, p.1));
        match (c.to_digit(10), parts.last_mut()) {
            (Some(digit), Some(last)) => last.1 = number.saturating_mul(10).saturating_add(u64::from(digit)),
            (None, Some(last)) if text => last.0.extend(c.to_lowercase()),
            _ => parts.push((c.to_lowercase().collect(), 0)),
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;
    use crate::evaluate::uncertainty::UncertaintyReport;

    /// Runs of as many patients and fractions, of which the run at `bad` has large residuals.
    fn cohort(patients: usize, fractions: usize, bad: Option<usize>) -> Cohort {
        let (case, outcome, run) = example::small();
        let report = Report::new(&case, &outcome, &run);
        let mut runs = Vec::new();
        for n in 0..patients * fractions {
            let mut report = report.clone();
            if let Some(l) = &mut report.landmarks {
                l.after.mean = if bad == Some(n) { 9.0 } else { 0.5 + 0.01 * (n % 7) as f64 };
            }
            let (patient, fraction) = (format!("P{}", n / fractions + 1), format!("fraction_{}", n % fractions + 9));
            runs.push(Member::new(patient, fraction, format!("../r{n}").into(), &report));
        }
        runs.reverse();
        Cohort::new(runs, Vec::new(), "aventail summary".into())
    }

    #[test]
    fn names_are_in_the_order_of_their_numbers() {
        let mut names = ["P10", "P9", "p1", "P1b", "P", "10", "9"];
        names.sort_by_cached_key(|n| natural(n));
        assert_eq!(names, ["9", "10", "P", "p1", "P1b", "P9", "P10"]);
    }

    #[test]
    fn the_run_that_stands_apart_is_found_and_shown_first() {
        let cohort = cohort(12, 3, Some(17));
        let odd: Vec<(usize, &Member)> =
            cohort.runs.iter().enumerate().filter(|(_, m)| !m.stand_apart.is_empty()).collect();
        assert_eq!(odd.len(), 1);
        let (place, odd) = odd[0];
        assert_eq!((place, odd.patient.as_str(), odd.fraction.as_str()), (17, "P6", "fraction_11"));
        assert_eq!(odd.stand_apart, ["landmarks_mean_mm"]);
        assert!(cohort.terminal_text().contains("P6, fraction_11: landmarks, mean 9.00 mm"));
        let page = page::page(&cohort);
        let first = page.find("P6, fraction_11").unwrap();
        assert!(first < page.find("<table").unwrap() && page.contains("href=\"../r17/report.html\""));
        assert!(!page.contains("http:") && !page.contains("https:") && !page.contains("<script"));
    }

    #[test]
    fn runs_of_one_name_with_several_planning_cts_are_told() {
        let (case, outcome, run) = example::small();
        let report = Report::new(&case, &outcome, &run);
        let member = |patient: &str, n: usize, sha256: &str| {
            let mut m = Member::new(patient.into(), format!("fx{n}"), format!("../r{n}").into(), &report);
            m.planning_sha256 = sha256.into();
            m
        };
        let [a, b] = ["a".repeat(64), "b".repeat(64)];
        let runs = vec![
            member("P1", 1, &a),
            member("P2", 2, &a),
            member("P1", 3, &b),
            member("P2", 4, ""),
            member("P2", 5, &a),
        ];
        let cohort = Cohort::new(runs, Vec::new(), "aventail summary".into());
        let [one] = cohort.warnings.as_slice() else { panic!("{:?}", cohort.warnings) };
        assert!(one.is(findings::PLANNING_DIFFERS) && one.message.starts_with("P1: ") && one.message.contains("../r3"));
        let told = |m: &Member| m.warnings.iter().any(|w| w == "planning-differs");
        assert_eq!(cohort.runs.iter().filter(|m| told(m)).count(), 2);
        assert!(cohort.runs.iter().all(|m| told(m) == (m.patient == "P1")));
        assert!(cohort.terminal_text().contains("P1: its runs use 2 planning CTs"));
        // The runs' own warnings are counted apart from what the summary found.
        let own = report.warnings.len().min(1) * 5;
        assert!(cohort.terminal_text().contains(&format!("{own} with warnings of their own")));
        assert!(cohort.terminal_text().contains("the summary itself finds something of 2: planning-differs"));
        let page = page::page(&cohort);
        assert!(!page.contains("Every run warns of <code>planning-differs"));
        assert!(page.find("2 planning CTs").unwrap() < page.find("<table").unwrap());
        assert!(String::from_utf8(text::csv(&cohort).unwrap()).unwrap().contains("planning-differs"));
    }

    #[test]
    fn what_is_unknown_is_told_and_stands_apart() {
        let (case, outcome, run) = example::small();
        let mut report = Report::new(&case, &outcome, &run);
        let mut of = |n: usize| {
            let mut u = UncertaintyReport::default();
            u.soft_tissue_mm.p95 = if n == 3 { None } else { Some(2.0 + 0.1 * n as f64) };
            report.uncertainty = Some(u);
            Member::new("P1".into(), format!("fx{n}"), format!("../r{n}").into(), &report)
        };
        let cohort = Cohort::new((0..6).map(&mut of).collect(), Vec::new(), "aventail summary".into());
        let odd: Vec<&str> =
            cohort.runs.iter().filter(|m| !m.stand_apart.is_empty()).map(|m| m.fraction.as_str()).collect();
        assert_eq!(odd, ["fx3"]);
        let text = cohort.terminal_text();
        assert!(text.contains("P1, fx3: uncertainty, 95th percentile > 30 mm (median 2.30"), "{text}");
        let page = page::page(&cohort);
        assert!(page.contains("&gt; 30") && page.contains("of a bone found in the image"), "{page}");
        let written = serde_json::to_value(&cohort).unwrap();
        assert!(written["runs"][3]["figures"]["uncertainty_p95_mm"].is_null());
    }

    #[test]
    fn a_reason_names_its_figure() {
        let (case, outcome, run) = example::small();
        let mut report = Report::new(&case, &outcome, &run);
        report.verdicts = vec![crate::evaluate::verdict::Limits::default().dice("cord", 0.1)];
        report.verdict = Some(Mark::Fail);
        let member = Member::new("P1".into(), "fx1".into(), "../r1".into(), &report);
        assert_eq!(member.reasons, ["cord, Dice: 0.10: below 0.8"]);
    }

    #[test]
    fn every_run_and_figure_is_in_the_table() {
        let cohort = cohort(4, 2, None);
        let table = String::from_utf8(text::csv(&cohort).unwrap()).unwrap();
        let mut lines = table.lines();
        let header: Vec<&str> = lines.next().unwrap().split(',').collect();
        assert_eq!(header.len(), 5 + KINDS.len() + 2);
        let column = header.iter().position(|h| *h == "landmarks_mean_mm").unwrap();
        let values: Vec<f64> = lines.map(|l| l.split(',').nth(column).unwrap().parse().unwrap()).collect();
        assert_eq!(values.len(), 8);
        assert!((values[3] - 0.53).abs() < 1e-9, "{values:?}");
        assert!(cohort.runs.iter().all(|m| m.stand_apart.is_empty()));
    }
}
