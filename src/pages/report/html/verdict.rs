//! The first screen of every page: the verdict with its reasons, whose scans they are, and where a person signs.

use super::super::numbers::first_words;
use super::paper::more;
use crate::evaluate::verdict::{Mark, Verdict, against, measured, overall};
use crate::io::dicom::About;
use crate::provenance::InputFile;
use crate::warning::counted;
use maud::{Markup, html};

/// Reasons that the first screen tells; the table has all.
const SHOWN: usize = 5;
/// Reasons that its print tells.
const PRINTED: usize = 3;
/// Letters of a reason on the first screen, about.
const LETTERS: usize = 260;

/// The overall verdict with what speaks against a pass; `missing` names what was not measured.
pub(in crate::report) fn verdict(verdicts: &[Verdict], missing: &[&str]) -> Markup {
    let (mark, reasons) = (overall(verdicts), against(verdicts));
    let passed = measured(verdicts).filter(|v| v.verdict == Mark::Pass).count();
    let (of, warned) = (measured(verdicts).count(), verdicts.len() - measured(verdicts).count());
    let head = match mark {
        Mark::Pass => "No measured figure speaks against it",
        Mark::Review => "Look at it before you use it",
        Mark::Fail => "Not to be used as it is",
    };
    html! {
        section.verdict.(mark.name()) {
            p.head { b.mark { (mark.name()) } span { (head) } }
            @if !reasons.is_empty() {
                ul {
                    @for (n, v) in reasons.iter().take(SHOWN).enumerate() {
                        li.(v.verdict.name()).screen[n >= PRINTED] {
                            b { (v.verdict.name()) ", " (v.name) } ": " (shortened(&v.reason)) " "
                            span.remedy { (sentence(&v.remedy)) }
                        }
                    }
                    @if reasons.len() > SHOWN { li.screen { (others(reasons.len() - SHOWN)) } }
                    @if reasons.len() > PRINTED { li.paper { (others(reasons.len() - PRINTED)) } }
                }
            }
            p.note {
                (passed) " of " (counted(of, "rule passes", "rules pass"))
                @if warned > 0 { "; " (counted(warned, "warning counts", "warnings count")) " beside them" }
                @if !missing.is_empty() { "; not measured here: " (missing.join(", ")) }
                ". The rules and their limits are in the table below; a person decides."
            }
        }
    }
}

/// Says how many reasons are told elsewhere.
fn others(n: usize) -> String {
    format!("and {n} more in the table of verdicts")
}

/// The first sentences of a long reason.
fn shortened(text: &str) -> String {
    let text = text.trim_end_matches('.');
    first_words(text, LETTERS).map_or_else(|| format!("{text}."), |head| format!("{head} \u{2026}"))
}

/// A remedy as a sentence.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().map(|c| c.to_uppercase().to_string()).unwrap_or_default();
    let end = if text.ends_with('.') { "" } else { "." };
    format!("{first}{}{end}", letters.as_str())
}

/// Every rule with its value and limit, those that do not pass first; as many as `on_paper` are printed.
pub(in crate::report) fn table(verdicts: &[Verdict], on_paper: usize) -> Markup {
    let mut all: Vec<&Verdict> = verdicts.iter().collect();
    all.sort_by_key(|v| std::cmp::Reverse(v.verdict));
    html! {
        p.note.screen {
            "Where AAPM TG-132 (Brock et al., Med. Phys. 44 (2017) e43, Table III, as others quote it) gives a range, a figure passes beyond the "
            "stricter end, is reviewed inside it and fails beyond the looser end; check it against the report itself and your protocol. "
            "The limits can be set: [verdict] in the settings."
        }
        table.verdicts {
            thead { tr { th { "Verdict" } th { "Figure" } th { "Value and reason" } th { "Limit" } th.screen { "Source" } } }
            tbody {
                @for (n, v) in all.iter().enumerate() {
                    tr.screen[n >= on_paper] {
                        td { b.(v.verdict.name()) { (v.verdict.name()) } }
                        td.wide { div.clip { (v.name) } }
                        td.wide { div.clip { (v.reason) } }
                        td { div.clip { (v.limit) } }
                        td.screen { (v.source) }
                    }
                }
            }
        }
        (more(all.len(), on_paper, ["rule", "rules"], "on the screen"))
    }
}

/// Whose scan and which series an input is, where it says so itself; else its file.
pub(in crate::report) fn identity(input: &InputFile) -> Markup {
    html! {
        @match &input.about {
            Some(about) => {
                @if let Some(patient) = &about.patient { b { (or_none(&patient.name)) } ", number " (or_none(&patient.id)) br; }
                span.clip { (series(about)) } br;
                span.note.clip { (input.path.display()) }
            }
            None => { span.clip { (input.path.display()) } }
        }
    }
}

/// Study and series of a scan with their dates.
fn series(about: &About) -> String {
    let number = about.number.map_or(String::new(), |n| format!(" {n}"));
    let what = if about.description.is_empty() { String::new() } else { format!(" ({})", about.description) };
    format!("study of {}, series{number} of {}{what}", day(&about.study_date), day(&about.date))
}

/// A DICOM date as `2026-11-21`; other texts as they are.
fn day(date: &str) -> String {
    let digits = date.len() == 8 && date.bytes().all(|b| b.is_ascii_digit());
    if digits { format!("{}-{}-{}", &date[..4], &date[4..6], &date[6..]) } else { or_none(date).to_owned() }
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}

/// Fields that only a person fills in.
pub(in crate::report) fn review() -> Markup {
    html! {
        section.sign {
            div.choice { b { "Decision" } span { "accept" } span { "accept with limits" } span { "reject" } }
            div.line { span { "Purpose, remarks" } span.blank {} span { "Name" } span.blank {} span { "Date" } span.blank {} }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::verdict::Limits;

    #[test]
    fn the_worst_reason_stands_first_and_is_escaped() {
        let limits = Limits::default();
        let all = [limits.dice("cord", 0.95), limits.dice("<b>brain", 0.85), limits.agreement("lung", 9.0, 1.0)];
        let text = verdict(&all, &["landmarks"]).into_string();
        assert!(text.contains("class=\"verdict fail\"") && text.contains("not measured here: landmarks"), "{text}");
        let at = |what: &str| text.find(what).unwrap_or_else(|| panic!("{what} is not in {text}"));
        assert!(at("lung, mean distance") < at("&lt;b&gt;brain, Dice") && !text.contains("cord"));
        assert!(text.contains("1 of 3 rules pass") && text.contains("Compare the mapped contour"));
        let pass = verdict(&all[..1], &[]).into_string();
        assert!(pass.contains("class=\"verdict pass\"") && !pass.contains("<ul>") && !pass.contains("not measured"));
    }

    #[test]
    fn scans_of_a_clinic_are_named_by_patient_study_and_series() {
        let about = About {
            patient: None,
            study_date: "20261121".into(),
            number: Some(3),
            description: "neck".into(),
            date: String::new(),
            series: "1.2".into(),
            frame_of_reference: "1.3".into(),
            slices: 80,
        };
        assert_eq!(series(&about), "study of 2026-11-21, series 3 of none (neck)");
    }
}
