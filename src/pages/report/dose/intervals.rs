//! How far a carried dose may be off, by samples of its registration: tables, text and CSV.

use super::DoseTable;
use super::page::{BROKEN, KEPT, UNDECIDED};
use crate::dose::{Decision, DoseLimit, DvhBand, FigureBand};
use crate::evaluate::Direction;
use serde::Serialize;

/// Figures that the page's table leaves out.
const LEFT_OUT: [&str; 4] = ["D98", "D50", "Dmin", "Dmax"];

/// What samples of registrations tell of a dose that these carried.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SampledDose {
    /// How many samples.
    pub number: usize,
    /// Seed of each registration's samples.
    pub seeds: Vec<u64>,
    /// Deviation of each component over the map of uncertainty, of each registration.
    pub scales: Vec<f64>,
    /// Direction of the dose.
    pub direction: Direction,
    /// Greatest standard deviation, Gy.
    pub greatest_sd_gy: f64,
    /// Mean standard deviation where the dose is steep (more than 1 % of its maximum per mm), Gy.
    pub steep_sd_gy: f64,
    /// Of several fractions: percent of the variance there that is due to what they have in common (the planning scan, its labels,
    /// the model), which no further fraction averages out. Not told of one fraction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub common_percent: Option<f64>,
    /// Each structure's figures with their intervals, and its curve's band.
    pub structures: Vec<DvhBand>,
    /// What limits say.
    pub limits: Vec<LimitDecision>,
}

/// A limit with what it says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LimitDecision {
    /// The limit.
    #[serde(flatten)]
    pub limit: DoseLimit,
    /// The figure, Gy or percent.
    pub found: f64,
    /// Lower end of its 90 % interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// What follows.
    pub decision: Decision,
}

/// What is said of a limit.
fn word(decision: Decision) -> &'static str {
    match decision {
        Decision::Kept => KEPT,
        Decision::Undecided => UNDECIDED,
        Decision::Broken => BROKEN,
    }
}

impl SampledDose {
    /// The tables of limits and intervals, where there are structures.
    pub fn tables(&self) -> Vec<DoseTable> {
        let limits = (!self.limits.is_empty()).then(|| self.limits());
        let intervals = (!self.structures.is_empty()).then(|| self.intervals());
        limits.into_iter().chain(intervals).collect()
    }

    /// Lines of `dvh_intervals.csv`: structure, figure, unit, value, low, high.
    pub(super) fn lines(&self) -> impl Iterator<Item = [String; 6]> {
        let text = |v: f64| if v.is_nan() { String::new() } else { format!("{v:.4}") };
        let of = move |s: &DvhBand, f: &FigureBand| {
            [s.name.clone(), f.figure.clone(), f.unit.to_owned(), text(f.value), text(f.low), text(f.high)]
        };
        self.structures.iter().flat_map(move |s| s.figures.iter().map(move |f| of(s, f)))
    }

    /// A structure a line: each figure with its interval.
    fn intervals(&self) -> DoseTable {
        // As many as the page is wide; all are in the JSON file.
        fn shown(s: &DvhBand) -> Vec<&FigureBand> {
            s.figures.iter().filter(|f| !LEFT_OUT.contains(&f.figure.as_str())).collect()
        }
        let row = |s: &DvhBand| {
            let cell = |f: &FigureBand| format!("{:.2} ({:.2}\u{2013}{:.2})", f.value, f.low, f.high);
            std::iter::once(s.name.clone()).chain(shown(s).into_iter().map(cell)).collect()
        };
        let first = self.structures.first().map(shown).unwrap_or_default();
        let heads = first.iter().map(|f| format!("{}, {}", f.figure, f.unit));
        DoseTable {
            title: "Figures with their 90 % intervals".into(),
            note: format!(
                "Each figure of the registration that was found, and in brackets its 90 % interval over {} samples of the \
                 registration's error; D98, D50, Dmin and Dmax are in the JSON file beside this page. Outlines and dose are taken for right.{}",
                self.number,
                self.common_percent.map_or(String::new(), |percent| format!(
                    " Of the variance in steep dose {percent:.0} % is common to the fractions: more of them do not average it out."
                ))
            ),
            head: std::iter::once("structure".to_owned()).chain(heads).collect(),
            rows: self.structures.iter().map(row).collect(),
        }
    }

    /// What the limits say.
    fn limits(&self) -> DoseTable {
        let row = |d: &LimitDecision| {
            let word = word(d.decision);
            let figure = format!("{:.2} ({:.2} to {:.2})", d.found, d.low, d.high);
            vec![d.limit.structure.clone(), d.limit.text(), figure, word.into()]
        };
        DoseTable {
            title: "Limits".into(),
            note: "Undecided: the limit lies within the figure's 90 % interval.".into(),
            head: ["structure", "limit", "found", "decision"].map(str::to_owned).into(),
            rows: self.limits.iter().map(row).collect(),
        }
    }

    /// For the terminal.
    pub fn text(&self) -> String {
        let mut text = format!(
            "  over {} samples the dose deviates by {:.2} Gy at most (one standard deviation), {:.2} Gy on the mean where it is steep\n",
            self.number, self.greatest_sd_gy, self.steep_sd_gy
        );
        if let Some(percent) = self.common_percent {
            text += &format!(
                "  {percent:.0} % of that variance is common to the fractions: more of them do not average it out\n"
            );
        }
        for s in &self.structures {
            let named = |f: &&FigureBand| ["mean", "D95", "D0.03cc"].contains(&f.figure.as_str());
            let cell = |f: &FigureBand| format!("{} {:.2} (90 %: {:.2} to {:.2})", f.figure, f.value, f.low, f.high);
            let cells: Vec<String> = s.figures.iter().filter(named).map(cell).collect();
            text += &format!("  {}: {} Gy\n", s.name, cells.join(", "));
        }
        for d in &self.limits {
            let word = word(d.decision);
            text += &format!(
                "  limit {} {}: {word} ({:.2}, 90 %: {:.2} to {:.2})\n",
                d.limit.structure,
                d.limit.text(),
                d.found,
                d.low,
                d.high
            );
        }
        text
    }
}
