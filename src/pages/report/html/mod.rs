//! `report.html`: one self-contained page, pictures first, that a physicist reads top to bottom.
//!
//! The verdict of the rules comes first, and the reviewer's fields, which stay blank.

pub(super) mod paper;
pub(super) mod samples;
mod summary;
mod tables;
pub(super) mod verdict;
mod view;

use super::numbers::{Report, threads, utc};
use super::pictures::{Picture, ShownSamples, is_of_a_place};
use super::viewer::{View, policy, section};
use crate::pipeline::FractionKind;
use crate::provenance::InputFile;
use crate::warning::Warning;
use base64::{Engine, engine::general_purpose::STANDARD};
use maud::{DOCTYPE, Markup, PreEscaped, html};
use verdict::review;
pub use view::view_page;

/// Head of any of our pages: its title, the common styles and `more` of them, and what the page may do (see [`policy`]).
pub(super) fn head(title: &str, more: &str, policy: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta http-equiv="Content-Security-Policy" content=(policy);
            meta name="color-scheme" content="light dark";
            meta name="viewport" content="width=device-width, initial-scale=1";
            title { (title) }
            style { (PreEscaped(include_str!("report.css"))) (PreEscaped(more)) }
        }
    }
}

/// The page of a run; everything it needs is inside.
pub fn page(report: &Report, pictures: &[Picture], view: Option<&View>, samples: Option<&ShownSamples>) -> String {
    let picture = |file: &str| figure(pictures.iter().find(|p| p.file == file));
    let title = summary::title(report);
    let has_landmarks = report.landmarks.is_some();
    let shifted = pictures.iter().any(|p| p.file == "fusion_couch.png");
    html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("aventail: {title}"), samples.map_or("", |_| samples::STYLE), &policy(view.is_some())))
            body {
                // What is in a sheet is on one page of paper; its pictures have the room that is left.
                div.sheet {
                    (summary::header(report, &title))
                    (verdict::verdict(&report.verdicts, &summary::missing(report)))
                    (review())
                    (summary::cards(report))
                    (warnings(&report.warnings, "report.json"))
                    @if let Some(view) = view { (section(view)) }
                    div.together.fill {
                        h2 { "Fusion" }
                        (colour_key(report))
                        div.pair.three[shifted] {
                            (picture("fusion_before.png")) (picture("fusion_couch.png")) (picture("fusion_after.png"))
                        }
                    }
                }
                @if pictures.iter().any(|p| p.file == "fusion_lung.png") {
                    div.pair.screen { (picture("fusion_lung.png")) }
                }
                div.sheet {
                    div.together.fill {
                        h2 { @if report.uncertainty.is_some() { "Deformation and uncertainty" } @else { "Deformation" } }
                        div.pair.four {
                            (picture("displacement.png"))
                            (picture("jacobian.png"))
                            @if report.uncertainty.is_some() { (picture("uncertainty.png")) (tables::trust(report)) }
                        }
                    }
                    @if has_landmarks {
                        div.together.fill {
                            h2 { "Landmarks" }
                            (colour_key(report))
                            div.pair {
                                (picture("landmarks.png"))
                                div.stack { (picture("residuals.png")) (tables::landmark_figures(report)) }
                            }
                        }
                        (tables::landmarks(report))
                    }
                }
                (sampled(samples))
                h2 { "Verdicts" }
                (verdict::table(&report.verdicts, RULES_ON_PAPER))
                h2 { "Bones" }
                (tables::bones(report))
                (searched(report, pictures))
                h2 { "Contact and sliding" }
                (tables::contact(report))
                h2 { "Jacobian" }
                (tables::jacobian(report))
                (tables::volumes(report))
                (tables::guides(report))
                h2 { "Inverse and chain mail" }
                (tables::inverse_and_links(report))
                div.pair.screen { (picture("material.png")) }
                div.screen {
                    h2 { "Time and memory" }
                    (stages(report))
                }
                div.end {
                    h2 { "Provenance" }
                    (provenance(report))
                    (limits())
                    footer { "aventail " (report.version) ", " (utc(report.created)) ". All positions and lengths in mm, LPS world frame." }
                }
            }
        }
    }
    .into_string()
}

/// Where samples were drawn with the run: the first of them.
fn sampled(samples: Option<&ShownSamples>) -> Markup {
    html! {
        @if let Some(samples) = samples {
            div.screen {
                h2 { "Samples of the error" }
                (samples::turns(samples))
            }
        }
    }
}

/// What a search has weighed, with its rivals.
fn searched(report: &Report, pictures: &[Picture]) -> Markup {
    html! {
        @if !report.places.is_empty() {
            h2 { "Places" }
            (tables::places(report))
        }
        @if !report.search.is_empty() {
            h2 { "Search" }
            (tables::searched(report))
            div.pair.screen {
                @for place in pictures.iter().filter(|p| is_of_a_place(p.file)) { (figure(Some(place))) }
            }
        }
    }
}

/// What the colours of every fusion mean.
fn colour_key(report: &Report) -> Markup {
    if report.fraction_kind.as_ref().is_some_and(FractionKind::unlike) {
        return html! { p.key { "Squares show planning and fraction in turn: where both agree, skin and bones continue from square to square." } };
    }
    html! {
        p.key {
            span { i style="background: var(--blue)" {} "planning CT blue" }
            span { i style="background: var(--orange)" {} "fraction orange" }
            span { i style="background: #9aa0a8" {} "equal content grey" }
        }
    }
}

/// A PNG as the source of a picture inside the page.
pub(super) fn data_url(png: &[u8]) -> Markup {
    // Nothing in it needs escaping, which would look at every letter.
    PreEscaped(format!("data:image/png;base64,{}", STANDARD.encode(png)))
}

/// A picture as part of the page; nothing when it was not drawn.
fn figure(picture: Option<&Picture>) -> Markup {
    html! {
        @if let Some(p) = picture {
            figure {
                h3 { (p.title) }
                img alt=(p.title) src=(data_url(&p.png));
                figcaption { (p.caption) }
            }
        }
    }
}

/// Kinds of warnings that are printed, and warnings of one kind.
const ON_PAPER: [usize; 2] = [4, 2];
/// Rules that are printed.
const RULES_ON_PAPER: usize = 13;
/// Inputs that are printed.
const INPUTS_ON_PAPER: usize = 10;

/// Warnings by kind; `file`: where all of them are.
pub(in crate::report) fn warnings(all: &[Warning], file: &str) -> Markup {
    let [most, each] = ON_PAPER;
    let kinds: Vec<&[Warning]> = all.chunk_by(|a, b| a.code == b.code).collect();
    let missing: usize = kinds.iter().skip(most).map(|kind| kind.len()).sum();
    html! {
        @if !all.is_empty() {
            h3 { "Warnings" }
            ul.warnings {
                @for (kind, of_one_kind) in kinds.iter().enumerate() {
                    li.screen[kind >= most] { div.clip {
                        code { (of_one_kind[0].code) }
                        @for (n, w) in of_one_kind.iter().enumerate() { span.screen[n >= each] { (reason(w)) } }
                        @if of_one_kind.len() > each { span.paper { "and " (of_one_kind.len() - each) " more" } }
                    } }
                }
            }
            (paper::more(missing, 0, ["warning", "warnings"], file))
        }
    }
}

/// A warning's words; of a refusal that was let through without its code and remedy, which stand in the verdict.
fn reason(warning: &Warning) -> &str {
    warning.message.split(&format!(" [{}]", warning.code)).next().unwrap_or(&warning.message)
}

/// Wall time of each stage as bars.
fn stages(report: &Report) -> Markup {
    let longest = report.stages.iter().map(|s| s.seconds).fold(1e-9, f64::max);
    let memory = report.peak_memory.map_or(String::new(), |b| format!(", at most {:.2} GB of memory", b as f64 / 1e9));
    html! {
        p { (format!("{:.1} s in all on {}{memory}.", report.seconds(), threads(report.threads))) }
        div.bars {
            @for s in &report.stages {
                span { (s.stage) }
                i style=(format!("width: {:.1}%", 100.0 * s.seconds / longest)) {}
                span { (format!("{:.2} s", s.seconds)) }
            }
        }
    }
}

/// The files that were read, with their checksums.
pub(in crate::report) fn inputs(inputs: &[InputFile], file: &str) -> Markup {
    html! {
        table {
            thead { tr { th { "Input" } th { "File" } th { "SHA-256" } } }
            tbody {
                @for (n, input) in inputs.iter().enumerate() {
                    tr.screen[n >= INPUTS_ON_PAPER] {
                        td { (input.role) }
                        td.wide { div.clip { (input.path.display()) @if let Some(about) = &input.about { br; (about) } } }
                        td.mono { (input.sha256) }
                    }
                }
            }
        }
        (paper::more(inputs.len(), INPUTS_ON_PAPER, ["file", "files"], file))
    }
}

fn provenance(report: &Report) -> Markup {
    let settings = serde_json::to_string_pretty(&report.settings).unwrap_or_default();
    html! {
        (inputs(&report.inputs, "report.json"))
        @if !report.outputs.is_empty() {
            table.screen {
                thead { tr { th { "Output" } th { "What it holds" } } }
                tbody { @for o in &report.outputs { tr { td.mono { (o.name) } td.wide { (o.what) } } } }
            }
        }
        h3.screen { "Command" }
        pre.screen { (report.command) }
        details.screen { summary { "Settings, defaults resolved" } pre { (settings) } }
    }
}

fn limits() -> Markup {
    html! {
        section.limits {
            h2 { "Limits" }
            p {
                "aventail is research software and not a medical device. The field is a model: bones are placed by the image, "
                "soft tissue follows them through the chain mail and, where both CTs show contrast, the images; in uniform tissue its "
                "motion is only the mechanical model's estimate. Tissue that appears or vanishes is not modelled. Landmarks test only the places where they lie; a Jacobian without "
                "folds shows that the field is regular, not that it is right. TG-132 gives no tolerance for carrying dose."
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{draw, example};
    use super::*;
    use crate::evaluate::jacobian::JacobianStats;
    use crate::evaluate::uncertainty::{SoftTissue, UncertaintyReport};
    use crate::evaluate::verdict::of_warnings;
    use crate::findings;
    use crate::fit::{Hypothesis, Place};
    use crate::geometry::Rigid;

    #[test]
    fn places_that_a_search_has_weighed_are_told_and_rivals_drawn() {
        let (case, mut outcome, run) = example::small();
        assert!(!page(&Report::new(&case, &outcome, &run), &[], None, None).contains("<h2>Search</h2>"));
        let bones = outcome.skeleton.bones.len();
        let place = |cost: f64, x: f64| Hypothesis {
            transforms: vec![Rigid::translation(x, 0.0, 0.0); bones],
            evidence: vec![1.0; bones],
            root: 0,
            cost,
            apart_mm: x,
            proposed_by: vec![0],
        };
        outcome.weighed.hypotheses = vec![place(-80.0, 0.0), place(-68.0, 31.0), place(-20.0, 55.0)];
        let report = Report::new(&case, &outcome, &run);
        let told: Vec<(f64, f64)> = report.search.iter().map(|p| (p.evidence_percent, p.shift_mm.x)).collect();
        assert_eq!(told, [(100.0, 0.0), (85.0, 31.0), (25.0, 55.0)]);
        let pictures = draw(&case, &outcome).unwrap();
        let places: Vec<&str> = pictures.iter().map(|p| p.file).filter(|f| is_of_a_place(f)).collect();
        assert_eq!(places, ["fusion_place_2.png"], "the third has too little evidence");
        let page = page(&report, &pictures, None, None);
        assert!(
            page.contains("<h2>Search</h2>") && page.contains("85 %") && page.contains("Second place of the search")
        );
        let read: Report = serde_json::from_str(&report.json().unwrap()).unwrap();
        assert_eq!(read.search, report.search);
    }

    #[test]
    fn places_where_the_bones_were_fitted_have_their_probabilities() {
        let (case, mut outcome, run) = example::small();
        let bones = outcome.skeleton.bones.len();
        let place = |cost: f64, z: f64, probability: f64| Place {
            transforms: vec![Rigid::translation(0.0, 0.0, z); bones],
            cost,
            found: 1.0,
            seen: vec![[1.0, 0.7]; bones],
            probability,
            apart_mm: z,
        };
        outcome.weighed.places = vec![place(-80.0, 0.0, 0.9)];
        assert!(Report::new(&case, &outcome, &run).places.is_empty(), "one place alone is no choice");
        outcome.weighed.places.push(place(-60.0, 18.0, 0.08));
        let report = Report::new(&case, &outcome, &run);
        let told: Vec<_> = report.places.iter().map(|p| (p.evidence_percent, p.probability_percent)).collect();
        assert_eq!(told, [(100.0, 90.0), (75.0, 8.0)]);
        assert_eq!(report.places.iter().map(|p| p.apart_mm.round() as i32).collect::<Vec<_>>(), [0, 18]);
        let page = page(&report, &[], None, None);
        assert!(page.contains("<h2>Places</h2>") && page.contains("75 %") && page.contains("2 % is left"), "{page}");
        let read: Report = serde_json::from_str(&report.json().unwrap()).unwrap();
        assert_eq!(read.places, report.places);
    }

    #[test]
    fn page_is_self_contained_and_holds_the_figures() {
        let (case, outcome, run) = example::small();
        let report = Report::new(&case, &outcome, &run);
        let pictures = draw(&case, &outcome).unwrap();
        assert_eq!(pictures.len(), 6);
        let page = page(&report, &pictures, None, None);
        for outside in ["http:", "https:", "src=\"/", "url(", "<script", "<link"] {
            assert!(!page.contains(outside), "{outside}");
        }
        assert_eq!(page.matches("data:image/png;base64,").count(), 6);
        let landmarks = report.landmarks.as_ref().unwrap();
        let figures = [
            format!("{:.2}", landmarks.before.mean),
            format!("{:.2}", landmarks.after.mean),
            "skull: 2 pieces, &lt;largest&gt; 98 %".to_owned(), // escaped
            report.inputs[0].sha256.clone(),
            run.command.clone(),
            "landmark_7".to_owned(),
        ];
        for figure in figures {
            assert!(page.contains(&figure), "{figure}");
        }
        assert!(page.find("<img").unwrap() < page.find("<table").unwrap(), "pictures come before tables");
        assert!(!page.to_lowercase().contains("approved"));
    }

    #[test]
    fn what_is_unknown_and_what_is_empty_has_no_figure() {
        let (case, outcome, run) = example::small();
        let mut report = Report::new(&case, &outcome, &run);
        let known = SoftTissue { n: 9, mean: 8.0, median: Some(4.5), max: 29.92, ..SoftTissue::default() };
        let unknown = UncertaintyReport { soft_tissue_mm: known, unknown_percent: 40.0, ..Default::default() };
        report.uncertainty = Some(unknown);
        report.jacobian.contact = JacobianStats::default();
        let page = page(&report, &[], None, None);
        assert!(page.contains("95th percentile</td><td class=\"n\">&gt; 30 mm"), "{page}");
        assert!(page.contains("Mean, greatest of what is known</td><td class=\"n\">8.00, 29.92 mm"), "{page}");
        let row = page.split("Bone contact</span>").nth(1).unwrap().split("</tr>").next().unwrap();
        assert_eq!(row.matches("\u{2013}").count(), 8, "no cell has no mean: {row}");
        assert!(page.contains("Inside 1 bone every") || page.contains("Inside 2 bones every"), "{page}");
        assert!(page.contains("so does the true motion of a jaw") && !page.contains("cannot overlap"));
        assert!(page.contains("In view,<br>of use"));
        let read: Report = serde_json::from_str(&report.json().unwrap()).unwrap();
        assert_eq!(read.uncertainty, Some(unknown));
    }

    #[test]
    fn warnings_are_no_rules_that_pass() {
        let (case, outcome, run) = example::small();
        let mut report = Report::new(&case, &outcome, &run);
        let rules = report.verdicts.len();
        report.verdicts.extend(of_warnings(&[Warning::new(findings::LABEL_DOUBTFUL, "skull")]));
        let page = page(&report, &[], None, None);
        assert!(page.contains(&format!(" of {rules} rules pass; 1 warning counts beside them")), "{page}");
    }

    #[test]
    fn a_run_without_landmarks_has_no_landmark_section() {
        let (case, mut outcome, run) = example::small();
        outcome.landmarks = None;
        let pictures = draw(&case, &outcome).unwrap();
        let page = page(&Report::new(&case, &outcome, &run), &pictures, None, None);
        assert_eq!(pictures.len(), 4);
        assert!(!page.contains("<h2>Landmarks</h2>"));
    }
}
