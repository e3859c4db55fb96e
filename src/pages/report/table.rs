//! The short table at the end of a run on the terminal.

use super::numbers::{ONE_SCAN, Report, first_words, threads};
use crate::evaluate::agreement::{Agreement, TissueAgreement};
use crate::evaluate::couch::CouchMatch;
use crate::evaluate::jacobian::JacobianReport;
use crate::evaluate::landmark::LandmarkReport;
use crate::evaluate::verdict::{Verdict, against, measured, overall};
use crate::findings::{self, Finding, Told};
use crate::fit::DeterminedBy;
use crate::pipeline::{GuideReached, OutlineAgreement};
use crate::warning::{Warning, counted};
use std::fmt::Write;

/// The figures that matter as a text table: one screen, and the warnings in full.
pub fn terminal_table(report: &Report) -> String {
    let mut rows: Vec<(&str, String)> = vec![("verdict", verdict(&report.verdicts))];
    if let Some(found) = &report.landmarks {
        rows.push(("landmarks", landmarks(found)));
    }
    for (n, guide) in report.guides.iter().take(GUIDES).enumerate() {
        rows.push((if n == 0 { "guides" } else { "" }, guided(guide)));
    }
    if report.guides.len() > GUIDES {
        rows.push(("", format!("and {} more in the report", report.guides.len() - GUIDES)));
    }
    if let Some(images) = &report.agreement {
        rows.push(("images", agreement(images)));
    }
    if let Some(couch) = couch(&report.couch) {
        rows.push(("couch shift", couch));
    }
    rows.push(("bones", bones(report)));
    if let Some(worst) = report.least_rigid() {
        rows.push(("rigidity", format!("{:.1e} mm rms at worst ({})", worst.rms_mm, worst.name)));
    }
    rows.extend(jacobian(&report.jacobian));
    if report.one_scan() && !report.warnings.iter().any(|w| w.is(findings::SAME_SCAN)) {
        rows.insert(1, ("", ONE_SCAN.to_owned()));
    }
    if let Some(kind) = &report.fraction_kind {
        rows.insert(1, ("fraction", kind.to_string()));
    }
    let links = &report.links;
    rows.push((
        "chain mail",
        format!(
            "{:.2} % of {} links violated, mean {:.2} mm, worst {:.2} mm",
            links.violated_percent, links.links, links.mean_excess_mm, links.max_excess_mm
        ),
    ));
    if let Some(waves) = &report.pruning {
        rows.push(("pruning", waves.to_string()));
    }
    let inverse = &report.inverse;
    rows.push((
        "inverse",
        format!(
            "{:.3} mm mean, {:.3} mm worst; {} unconverged, {} folded over",
            inverse.residual_mm.mean,
            inverse.residual_mm.max,
            counted(inverse.unconverged_tissue, "tissue voxel", "tissue voxels"),
            inverse.multiple
        ),
    ));
    let back = &report.consistency.there_and_back_mm;
    rows.push((
        "consistency",
        format!(
            "inverse-consistency error {:.3} mm mean, {:.2} mm worst, 10 mm of bone contact and 5 of sliding left out",
            back.mean, back.max
        ),
    ));
    let memory = report.peak_memory.map_or(String::new(), |b| format!(", {:.2} GB", b as f64 / 1e9));
    rows.push(("run", format!("{:.1} s on {}{memory}", report.seconds(), threads(report.threads))));
    for (n, told) in warnings(&report.warnings).into_iter().enumerate() {
        rows.push((if n == 0 { "warnings" } else { "" }, told));
    }
    rows.iter().fold(String::new(), |mut text, (name, value)| {
        writeln!(text, "  {name:<11} {value}").expect("writing to a string does not fail");
        text
    })
}

/// Jacobian characteristics.
fn jacobian(j: &JacobianReport) -> Vec<(&'static str, String)> {
    let mut rows = Vec::new();
    rows.push((
        "jacobian",
        format!(
            "body mean {:.3}, {:.2} to {:.2}; folded {} of {} cells ({:.4} %)",
            j.body.mean, j.body.min, j.body.max, j.body.folded, j.body.cells, j.body.folded_percent
        ),
    ));
    if j.body.cells == 0 {
        // No cells have no mean.
        rows = vec![("jacobian", "no tissue cell outside contact and interfaces".to_owned())];
    }
    if j.contact.cells + j.interface.cells + j.folded_outside > 0 {
        rows.push((
            "",
            format!(
                "all tissue above -500 HU: folded {} of {} cells, {} in bone contact, {} where bones slide; outside it {}",
                j.all.folded, j.all.cells, j.contact.folded, j.interface.folded, j.folded_outside
            ),
        ));
    }
    if j.across > 0 {
        let told = counted(j.across, "more cell reaches", "more cells reach");
        let told = format!("{told} across where lung or organs slide: the field jumps there");
        rows.push(("", told));
    }
    rows
}

fn landmarks(l: &LandmarkReport) -> String {
    let outside = l.before.n - l.after.n;
    let lost = if outside > 0 { format!(", {outside} outside the planning scan") } else { String::new() };
    format!(
        "{:.2} -> {}{:.2} mm mean, {:.2} mm worst, {}{lost}",
        l.before.mean,
        l.shifted.as_ref().map_or(String::new(), |s| format!("{:.2} (couch shift) -> ", s.mean)),
        l.after.mean,
        l.after.max,
        counted(l.after.n, "point", "points")
    )
}

/// Guides that the terminal tells of.
const GUIDES: usize = 5;

/// How near the outlines of a structure come.
fn guided(guide: &GuideReached) -> String {
    let told = |a: &Option<OutlineAgreement>| {
        a.map_or("not seen".to_owned(), |a| format!("Dice {:.2}, {:.1} mm ({:.1})", a.dice, a.mean_mm, a.p95_mm))
    };
    let name = first_words(&guide.name, 30).unwrap_or(&guide.name);
    format!("{name}: {} -> {}, mean (95 %)", told(&guide.before), told(&guide.after))
}

/// Warnings that the terminal tells.
const WARNED: usize = 8;
/// Letters of a line of warning.
const LETTERS: usize = 100;

/// Each warning in full, those that put the result in doubt first.
fn warnings(all: &[Warning]) -> Vec<String> {
    let doubt = |w: &Warning| Finding::of(&w.code).map_or((false, false), |f| (f.told == Told::Refused, f.doubted));
    let mut ordered: Vec<&Warning> = all.iter().collect();
    ordered.sort_by_key(|w| std::cmp::Reverse(doubt(w)));
    let mut lines: Vec<String> = ordered.iter().take(WARNED).flat_map(|w| in_lines(w)).collect();
    if ordered.len() > WARNED {
        lines.push(format!("and {} more in the report", ordered.len() - WARNED));
    }
    lines
}

/// Code and words of a warning, in lines; all but the first stand further in.
fn in_lines(warning: &Warning) -> Vec<String> {
    let mut lines = vec![format!("{}:", warning.code)];
    for word in warning.message.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= LETTERS => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(format!("  {word}")),
        }
    }
    lines
}

/// Local correlation of the images, as scanned, with the couch shift and registered.
fn agreement(images: &Agreement) -> String {
    let told = |value: Option<f64>| value.map_or("?".to_owned(), |v| format!("{v:.2}"));
    let of = |(name, tissue): (&str, Option<TissueAgreement>)| {
        tissue.map(|t| format!("{name} {} -> {} (couch shift) -> {:.2}", told(t.before), told(t.couch), t.after))
    };
    let parts: Vec<String> =
        [("bones", images.bones), ("soft tissue", images.soft_tissue)].into_iter().filter_map(of).collect();
    if parts.is_empty() { "nothing to compare".to_owned() } else { format!("local correlation: {}", parts.join("; ")) }
}

/// The couch shift, and what it leaves of the bones that it is matched on.
fn couch(couch: &CouchMatch) -> Option<String> {
    let worst = couch.worst()?;
    Some(format!(
        "patient lies {} mm by {}; leaves {:.1} rms ({}), {:.1} turned {:.1} deg",
        couch.towards(),
        counted(couch.on.len(), "bone", "bones"),
        worst.shift_mm,
        worst.bone,
        worst.rotation_mm,
        couch.angle_deg()
    ))
}

/// Verdicts that the line names.
const NAMED: usize = 3;

/// The overall verdict and what speaks against a pass, in one line.
pub(super) fn verdict(verdicts: &[Verdict]) -> String {
    let reasons = against(verdicts);
    let mut text = overall(verdicts).name().to_uppercase();
    if reasons.is_empty() {
        write!(text, " ({})", counted(measured(verdicts).count(), "rule", "rules"))
            .expect("writing to a string does not fail");
    } else {
        let named: Vec<&str> = reasons.iter().take(NAMED).map(|v| v.name.as_str()).collect();
        let more = reasons.len().checked_sub(NAMED + 1).map_or(String::new(), |n| format!(" and {} more", n + 1));
        write!(text, ": {}{more}", named.join("; ")).expect("writing to a string does not fail");
    }
    text
}

fn bones(report: &Report) -> String {
    let by = |way: DeterminedBy| report.bones.iter().filter(|b| b.determined_by == way).count();
    let most = report.moves_most().map_or(String::new(), |(bone, mm)| {
        format!("; {}'s centre moves most, {mm:.1} mm apart from the couch shift", bone.name)
    });
    let given = match by(DeterminedBy::Given) {
        0 => format!("{} found in the image", by(DeterminedBy::Image)),
        n => format!("{n} given"),
    };
    let by_skin = match by(DeterminedBy::Skin) {
        0 => String::new(),
        n => format!(", {n} placed by the skin"),
    };
    format!("{given}{by_skin}, {} follow their joints{most}", by(DeterminedBy::Joint))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::example;

    #[test]
    fn fits_one_screen_and_tells_the_figures() {
        let (case, outcome, run) = example::small();
        let report = Report::new(&case, &outcome, &run);
        let text = terminal_table(&report);
        assert!(text.lines().count() <= 15 && text.lines().all(|l| l.chars().count() <= 120), "{text}");
        let landmarks = report.landmarks.as_ref().unwrap();
        assert!(
            text.contains(&format!("{:.2} -> {:.2} mm mean", landmarks.before.mean, landmarks.after.mean))
                && text.contains("verdict"),
            "{text}"
        );
        assert!(text.contains("bone contact") && text.contains("skull's centre moves most"), "{text}");
    }
    #[test]
    fn a_warning_is_told_to_its_end() {
        let (case, mut outcome, run) = example::small();
        let words = format!("{} {}", "some word or other".repeat(12), "and at last what to do about it");
        outcome.warnings = vec![Warning::new(findings::BONE_IN_PIECES, words.clone())];
        let text = terminal_table(&Report::new(&case, &outcome, &run));
        let told = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(told.contains(&words) && text.lines().all(|l| l.chars().count() <= 120), "{text}");
    }

    #[test]
    fn names_with_commas_stay_whole() {
        let limits = crate::evaluate::verdict::Limits::default();
        let told = verdict(&[limits.dice("cord", 0.1), limits.dice("parotid", 0.1)]);
        assert_eq!(told, "FAIL: cord, Dice; parotid, Dice");
    }
}
