//! Top of the page: whose scans, and the key figures.

use super::super::numbers::{ONE_SCAN, Report, count, utc};
use super::verdict::identity;
use crate::config::InputRole;
use crate::evaluate::agreement::{Agreement, TissueAgreement};
use crate::evaluate::landmark::LandmarkReport;
use crate::evaluate::uncertainty::in_mm;
use crate::fit::DeterminedBy;
use crate::geometry::Grid;
use crate::stats::millilitres;
use crate::warning::counted;
use maud::{Markup, html};
use std::path::Path;

/// Whether the posture was made and no fraction CT was registered.
fn posed(report: &Report) -> bool {
    input(report, InputRole::Fraction).is_none() && report.bones.iter().any(|b| b.determined_by == DeterminedBy::Given)
}

/// What stands in the fraction's place where the posture was made.
const ARTIFICIAL: &str = "artificial posture";

/// File name of an input by its role.
fn input(report: &Report, role: InputRole) -> Option<&Path> {
    report.inputs.iter().find(|i| i.role == role).map(|i| i.path.as_path())
}

/// The case in words.
pub(super) fn title(report: &Report) -> String {
    let name = |role: InputRole| {
        input(report, role).and_then(Path::file_name).map_or(role.to_string(), |n| n.to_string_lossy().into_owned())
    };
    let fraction = if posed(report) { ARTIFICIAL.to_owned() } else { name(InputRole::Fraction) };
    format!("{} \u{2192} {fraction}", name(InputRole::Planning))
}

pub(super) fn header(report: &Report, title: &str) -> Markup {
    let scan = |role: InputRole| {
        html! {
            @match report.inputs.iter().find(|i| i.role == role) {
                Some(input) => (identity(input)),
                None => { "made by aventail, no file" }
            }
        }
    };
    let fraction = if posed(report) {
        html! { (ARTIFICIAL) }
    } else {
        scan(InputRole::Fraction)
    };
    let couch = &report.couch;
    let lies = format!(
        " (the patient lies {}; a couch corrects this the other way; scanner origins included)",
        couch.towards()
    );
    html! {
        header {
            p.brand { "aventail \u{b7} deformable registration report" }
            h1 { span.clip { (title) } }
            dl.case {
                div { dt.planning { "Planning" } dd { (scan(InputRole::Planning)) br; span.note { (grid(&report.planning_grid)) } } }
                div { dt.fraction { "Fraction" } dd { (fraction) br; span.note { (grid(&report.fraction_grid)) @if let Some(kind) = &report.fraction_kind { br; (kind) } } @if report.one_scan() { br; strong { (ONE_SCAN) } } } }
                div { dt { "Couch shift" } dd { (format!("{:.1} mm", couch.shift().norm())) span.note { (lies) br; (matched(report)) } } }
                div { dt { "Made" } dd { (utc(report.created)) span.note { " by aventail " (report.version) } } }
            }
        }
    }
}

/// On what the couch shift is matched, and what it leaves there.
fn matched(report: &Report) -> String {
    let couch = &report.couch;
    let on = match couch.on.as_slice() {
        [] => return couch.chosen.clone(),
        [one] => one.clone(),
        [first, .., last] if couch.on.len() > 3 => format!("{} bones, {first} to {last}", couch.on.len()),
        some => some.join(", "),
    };
    let left = couch.worst().map_or(String::new(), |worst| {
        format!(
            "; leaves up to {:.1} mm rms there ({}), {:.1} mm with a rotation of {:.1}\u{b0}",
            worst.shift_mm,
            worst.bone,
            worst.rotation_mm,
            couch.angle_deg()
        )
    });
    format!("matched on {on}{left}")
}

/// A mean local correlation; a dash where nothing can be compared.
fn correlation(tissue: Option<TissueAgreement>) -> String {
    tissue.map_or("\u{2013}".to_owned(), |t| format!("{:.2}", t.after))
}

/// How far the images agreed before, bones and soft tissue, in words.
fn before(images: &Agreement) -> String {
    let told = |of: &dyn Fn(TissueAgreement) -> Option<f64>, digits: usize| {
        let one =
            |t: Option<TissueAgreement>| t.and_then(of).map_or("\u{2013}".to_owned(), |v| format!("{v:.digits$}"));
        format!("{} / {}", one(images.bones), one(images.soft_tissue))
    };
    format!(
        "local correlation; as scanned {}, by couch {}; worse than by couch {} %",
        told(&|t| t.before, 2),
        told(&|t| t.couch, 2),
        told(&|t| Some(t.worse_percent), 0)
    )
}

fn grid(grid: &Grid) -> String {
    let [i, j, k] = grid.size();
    let [x, y, z] = grid.spacing().map(|s| (s * 1000.0).round() / 1000.0);
    format!("{i} \u{d7} {j} \u{d7} {k} voxels of {x} \u{d7} {y} \u{d7} {z} mm")
}

/// One key figure.
fn card(what: &str, value: Markup, more: &str) -> Markup {
    html! { div.card { span.what { (what) } b { (value) } div.more { (more) } } }
}

/// What landmarks are off by with the couch shift alone, in words.
fn shifted(l: &LandmarkReport) -> String {
    l.shifted.as_ref().map_or(String::new(), |s| format!("couch shift alone {:.2}; ", s.mean))
}

/// The figures that a reader wants first.
pub(super) fn cards(report: &Report) -> Markup {
    let mm = |v: f64, digits: usize| html! { (format!("{v:.digits$}")) small { " mm" } };
    let j = &report.jacobian;
    let folded = format!(
        "of {} cells; another {} in bone contact, {} where bones slide",
        count(j.body.cells),
        count(j.contact.folded),
        count(j.interface.folded)
    );
    let inverse = &report.inverse;
    let given = report.bones.iter().filter(|b| b.determined_by == DeterminedBy::Given).count();
    let visible = report.bones.iter().filter(|b| b.visible > 0.0).count();
    html! {
        div.cards {
            @if let Some(l) = &report.landmarks {
                (card("Landmarks after, mean", mm(l.after.mean, 2), &format!("before {:.2}; {}worst after {:.2} mm, {}", l.before.mean, shifted(l), l.after.max, counted(l.after.n, "point", "points"))))
            } @else {
                (card("Landmarks", html! { "none" }, "no landmarks were given"))
            }
            @if given > 0 {
                (card("Bones given their motion", html! { (given) small { " of " (report.bones.len()) } }, "no image took part; the others follow their joints"))
            } @else {
                (card("Bones placed by the image", html! { (report.bones_by_image()) small { " of " (report.bones.len()) } }, &format!("{visible} with a part in view that the fit can use; what is not found follows its joint or the skin around it")))
            }
            @if let Some(images) = &report.agreement {
                (card("Images agree at bones / in soft tissue", html! { (correlation(images.bones)) " / " (correlation(images.soft_tissue)) }, &before(images)))
            }
            (card("Folded tissue cells", html! { (count(j.body.folded)) small { (format!(" ({:.4} %)", j.body.folded_percent)) } }, &folded))
            @if let Some(u) = &report.uncertainty {
                (card("Uncertainty of soft tissue, 95th percentile", html! { (in_mm(u.soft_tissue_mm.p95, 1)) small { " mm" } }, &format!("{} have more than 2 mm or are not known", millilitres(u.above_2mm_ml))))
            } @else {
                (card("Inverse, mean residual", mm(inverse.residual_mm.mean, 3), &format!("worst {:.3} mm; {} unconverged, {} folded over", inverse.residual_mm.max, counted(inverse.unconverged_tissue, "tissue voxel", "tissue voxels"), count(inverse.multiple))))
            }
        }
    }
}

/// What the rules could judge and this run did not measure.
pub(super) fn missing(report: &Report) -> Vec<&'static str> {
    let landmarks = report.landmarks.as_ref().is_some_and(|l| l.after.n > 0);
    let known = [
        (landmarks, "target registration error (no landmarks)"),
        (false, "agreement of contours (see aventail evaluate)"),
        (report.uncertainty.is_some(), "uncertainty"),
        (report.agreement.is_some(), "agreement of the images (two kinds of grey values)"),
        (false, "curl (see aventail evaluate)"),
    ];
    known.into_iter().filter(|(known, _)| !known).map(|(_, what)| what).collect()
}
