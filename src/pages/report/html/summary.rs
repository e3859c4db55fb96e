//! Top of the page: case, key figures, and the figures beside TG-132's tolerances.

use super::super::numbers::{Report, count, utc};
use crate::geometry::Grid;
use maud::{Markup, html};
use std::path::Path;

/// Whether the posture was made and no fraction CT was registered.
fn posed(report: &Report) -> bool {
    input(report, "fraction").is_none() && report.bones.iter().any(|b| b.determined_by == "given")
}

/// What stands in the fraction's place where the posture was made.
const ARTIFICIAL: &str = "artificial posture";

/// File name of an input by its role.
fn input<'a>(report: &'a Report, role: &str) -> Option<&'a Path> {
    report.inputs.iter().find(|i| i.role == role).map(|i| i.path.as_path())
}

/// The case in words.
pub(super) fn title(report: &Report) -> String {
    let name = |role: &str| {
        input(report, role).and_then(Path::file_name).map_or(role.to_owned(), |n| n.to_string_lossy().into_owned())
    };
    let fraction = if posed(report) { ARTIFICIAL.to_owned() } else { name("fraction") };
    format!("{} \u{2192} {fraction}", name("planning"))
}

pub(super) fn header(report: &Report, title: &str) -> Markup {
    let path = |role: &str| input(report, role).map_or(String::new(), |p| p.display().to_string());
    let fraction = if posed(report) { ARTIFICIAL.to_owned() } else { path("fraction") };
    // Adding 0 turns the minus of a zero away.
    let s = report.couch_shift.map(|c| (c * 10.0).round() / 10.0 + 0.0);
    html! {
        header {
            p.brand { "aventail \u{b7} deformable registration report" }
            h1 { (title) }
            dl.case {
                div { dt.planning { "Planning" } dd { (path("planning")) br; span.note { (grid(&report.planning_grid)) } } }
                div { dt.fraction { "Fraction" } dd { (fraction) br; span.note { (grid(&report.fraction_grid)) @if let Some(kind) = &report.fraction_kind { br; (kind) } } } }
                div { dt { "Couch shift" } dd { (format!("{:.1} mm", s.norm())) span.note { (format!(" (left {:.1}, back {:.1}, head {:.1}; scanner origins included)", s.x, s.y, s.z)) } } }
                div { dt { "Made" } dd { (utc(report.created)) span.note { " by aventail " (report.version) } } }
            }
        }
    }
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
    let given = report.bones.iter().filter(|b| b.determined_by == "given").count();
    let visible = report.bones.iter().filter(|b| b.visible > 0.0).count();
    html! {
        div.cards {
            @if let Some(l) = &report.landmarks {
                (card("Landmarks after, mean", mm(l.after.mean, 2), &format!("before {:.2}; worst after {:.2} mm, {} points", l.before.mean, l.after.max, l.after.n)))
            } @else {
                (card("Landmarks", html! { "none" }, "no landmarks were given"))
            }
            @if given > 0 {
                (card("Bones given their motion", html! { (given) small { " of " (report.bones.len()) } }, "no image took part; the others follow their joints"))
            } @else {
                (card("Bones placed by the image", html! { (report.bones_by_image()) small { " of " (report.bones.len()) } }, &format!("{visible} at least partly in view; the others follow their joints")))
            }
            (card("Folded tissue cells", html! { (count(j.body.folded)) small { (format!(" ({:.3} %)", j.body.folded_percent)) } }, &folded))
            (card("Inverse, mean residual", mm(inverse.residual_mm.mean, 3), &format!("worst {:.3} mm; {} tissue voxels unconverged, {} folded over", inverse.residual_mm.max, count(inverse.unconverged_tissue), count(inverse.multiple))))
            (card("Links violated", html! { (format!("{:.2}", report.links.violated_percent)) small { " %" } }, &format!("mean excess {:.2} mm, worst {:.2} mm", report.links.mean_excess_mm, report.links.max_excess_mm)))
        }
    }
}

/// Figures of the run beside the tolerances of AAPM TG-132, without a verdict.
pub(super) fn tolerances(report: &Report) -> Markup {
    let voxel = [&report.planning_grid, &report.fraction_grid].iter().flat_map(|g| g.spacing()).fold(0.0, f64::max);
    let (j, back) = (&report.jacobian, &report.consistency.there_and_back_mm);
    html! {
        p.note {
            "Tolerances as AAPM TG-132 (Brock et al., Med. Phys. 44 (2017) e43) is commonly quoted; check them against the report "
            "itself and your own protocol. Largest voxel edge here: " (format!("{voxel:.1} mm")) ". No verdict is drawn."
        }
        table {
            thead { tr { th { "Figure" } th { "This run" } th { "TG-132" } } }
            tbody {
                @if let Some(l) = &report.landmarks {
                    tr {
                        td { "Target registration error, " (l.after.n) " landmarks" }
                        td { (format!("mean {:.2}, 95 % {:.2}, worst {:.2} mm", l.after.mean, l.after.p95, l.after.max)) }
                        td { "largest voxel edge, about 2\u{2013}3 mm" }
                    }
                }
                tr {
                    td { "Jacobian, tissue outside bone contact and sliding interfaces" }
                    td { (format!("{} cells not positive; 1 % {:.2}, 99 % {:.2}, largest {:.2}", count(j.body.folded), j.body.p1, j.body.p99, j.body.max)) }
                    td { "no negative values; deviation from 1 as clinically expected" }
                }
                tr {
                    td { "Consistency, there and back" }
                    td { (format!("mean {:.3}, 95 % {:.3}, worst {:.3} mm away from bone contact", back.mean, back.p95, back.max)) }
                    td { "largest voxel edge, about 2\u{2013}3 mm" }
                }
                tr {
                    td { "Contours: mean distance to agreement, Dice" }
                    td { "not measured in this run" }
                    td { "within contouring uncertainty; about 2\u{2013}3 mm, 0.80\u{2013}0.90" }
                }
            }
        }
    }
}
