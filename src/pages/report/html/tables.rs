//! Tables of the page: bones, landmarks, Jacobian, inverse and links.

use super::super::FittedPlace;
use super::super::numbers::{Report, count};
use super::paper::{more, printed};
use crate::evaluate::contact::LISTED_MM;
use crate::evaluate::jacobian::JacobianStats;
use crate::evaluate::landmark::LandmarkResidual;
use crate::evaluate::uncertainty::in_mm;
use crate::fit::{BoneFit, DeterminedBy};
use crate::geometry::rotation_angle_deg;
use crate::pipeline::OutlineAgreement;
use crate::warning::counted;
use maud::{Markup, html};

/// Lines of each table that are printed.
const BONES_ON_PAPER: usize = 20;
const LANDMARKS_ON_PAPER: usize = 60;
/// As many lie in two columns; more need three.
const FEW: usize = 30;
const PAIRS_ON_PAPER: usize = 8;
const CELLS_ON_PAPER: usize = 8;
const ORGANS_ON_PAPER: usize = 8;

const MISSING: &str = "\u{2013}";

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or(MISSING.to_owned(), |v| format!("{v:.digits$}"))
}

/// Places where all bones were fitted, with the probability of each.
pub(super) fn places(report: &Report) -> Markup {
    let left = 100.0 - report.places.iter().map(|p| p.probability_percent).sum::<f64>();
    let level = |place: &FittedPlace| match &place.level {
        Some([here, there]) if here != there => format!("{here} would be {there}"),
        Some([here, _]) => format!("{here} is {here}"),
        None => MISSING.to_owned(),
    };
    html! {
        p.note {
            "All bones were fitted at each of these places; the first is the result. The probabilities follow from the evidence, by a law "
            "that random views with known truth gave; " (format!("{left:.0} %")) " is left for places that were not fitted."
        }
        table {
            thead { tr { th { "Place" } th { "Level" } th.n { "From the result" br; "mm" } th.n { "Evidence" } th.n { "Probability" } } }
            tbody {
                @for (n, place) in report.places.iter().enumerate() {
                    tr {
                        td { @if n == 0 { "Result" } @else { (n + 1) } }
                        td { (level(place)) }
                        td.n { (format!("{:.0}", place.apart_mm)) }
                        td.n { (format!("{:.0} %", place.evidence_percent)) }
                        td.n { (format!("{:.0} %", place.probability_percent)) }
                    }
                }
            }
        }
    }
}

/// Places that the search of an unclear start has weighed.
pub(super) fn searched(report: &Report) -> Markup {
    html! {
        p.note {
            "Each bone proposed places, and the joints chose among them. The fit began at the first. One with nearly as much evidence may be "
            "another level of the spine: look at its picture."
        }
        table {
            thead { tr { th { "Place" } th { "Proposed by" } th.n { "Evidence" } th.n { "From the first" br; "mm" } th.n { "Shift (x, y, z)" br; "mm" } } }
            tbody {
                @for (n, place) in report.search.iter().enumerate() {
                    tr {
                        td { (n + 1) }
                        td.wide { (place.proposed_by.join(", ")) }
                        td.n { (format!("{:.0} %", place.evidence_percent)) }
                        td.n { (format!("{:.0}", place.apart_mm)) }
                        td.n { (format!("{:.0}, {:.0}, {:.0}", place.shift_mm.x, place.shift_mm.y, place.shift_mm.z)) }
                    }
                }
            }
        }
    }
}

/// Each bone's motion and how well it is known.
pub(super) fn bones(report: &Report) -> Markup {
    let rigid_rms = |bone: &BoneFit| report.rigidity.iter().find(|r| r.name == bone.name).map(|r| r.rms_mm);
    let own = |n: usize| report.own_motion_mm.get(n).copied();
    let motion: Vec<f64> = (0..report.bones.len()).map(|n| own(n).unwrap_or(0.0)).collect();
    let on_paper = printed(&motion, BONES_ON_PAPER);
    html! {
        p.note {
            "Motion is the displacement of a bone's centre, from planning to fraction; left by couch is the root mean square distance of its points with the couch shift alone, and with its rotation too (bones that the shift is matched on are marked). Scatter is how far noise "
            "would move a bone of these samples, one standard deviation in the worst direction, from the curvature of the cost; real errors are often two to four times as large, "
            "and more where a bone's own image is doubtful. Similarity: 1 best, 0 none; before is with the mean "
            "motion alone. In view, of use: share of the bone that the fit can use; what lies near an end of the fraction is no evidence. Beyond range: how far the joint has left its soft range, in rotation and in shift. Rigid: root mean square departure of the field from rigid motion."
        }
        table {
            thead {
                tr {
                    th { "Bone" } th { "Placed by" } th { "In view," br; "of use" } th.n { "Similarity" } th.n { "Motion" br; "mm" } th.n { "Left by couch" br; "mm" } th.n { "Rotation" br; "deg" }
                    th.n { "Scatter" br; "mm / deg" } th.n { "Beyond" br; "range" } th.n { "Rigid" br; "mm" } th { "Stopped because" }
                }
            }
            tbody {
                @for (n, b) in report.bones.iter().enumerate() {
                    tr.screen[!on_paper[n]] {
                        td { span.short { (b.name) } }
                        td { span.tag.image[b.determined_by == DeterminedBy::Image] { (b.determined_by.name()) } }
                        td { (format!("{:.0} %", 100.0 * b.visible)) span.meter { i style=(format!("width: {:.0}%", 100.0 * b.visible)) {} } }
                        td.n { (number(b.similarity_before, 2)) " \u{2192} " (number(b.similarity_after, 2)) }
                        td.n { (format!("{:.1}", b.motion_mm)) }
                        td.n { (left(report, &b.name)) }
                        td.n { (format!("{:.1}", rotation_angle_deg(&b.transform))) }
                        td.n { (uncertainty(b)) }
                        td.n { @if b.beyond_range.any() { (b.beyond_range) } @else { (MISSING) } }
                        td.n { (rigid_rms(b).map_or(MISSING.to_owned(), |r| format!("{r:.1e}"))) }
                        td.wide { span.short { (b.stop) } }
                    }
                }
            }
        }
        (more(report.bones.len(), BONES_ON_PAPER, ["bone, which moves least on its own", "bones, which move least on their own"], "report.json"))
    }
}

/// What the couch shift leaves of a bone, without and with its rotation; marked where it is matched on the bone.
fn left(report: &Report, bone: &str) -> String {
    let residual = report.couch.residuals.iter().find(|r| r.bone == bone);
    residual.map_or(MISSING.to_owned(), |r| {
        format!("{:.1} / {:.1}{}", r.shift_mm, r.rotation_mm, if r.matched { " \u{2022}" } else { "" })
    })
}

/// A bone without a finite standard deviation is not determined.
fn uncertainty(bone: &BoneFit) -> String {
    if bone.position_sd_mm.is_finite() && bone.rotation_sd_deg.is_finite() {
        let told = |v: f64| if v < 0.01 { "<0.01".to_owned() } else { format!("{v:.2}") };
        format!("{} / {}", told(bone.position_sd_mm), told(bone.rotation_sd_deg))
    } else {
        "open".to_owned()
    }
}

/// Summary of the landmark residuals, with eq. 4.2 and 4.3.
pub(super) fn landmark_figures(report: &Report) -> Markup {
    let Some(l) = &report.landmarks else { return html! {} };
    let row = |what: &str, s: &crate::stats::Summary| {
        html! { tr { td { (what) } td.n { (s.n) } @for v in [s.mean, s.std, s.median, s.p95, s.max] { td.n { (format!("{v:.2}")) } } } }
    };
    html! {
        h3 { "Residuals, mm" }
        table {
            thead { tr { th {} th.n { "points" } th.n { "mean" } th.n { "sd" } th.n { "median" } th.n { "95 %" } th.n { "worst" } } }
            tbody { (row("before", &l.before)) @if let Some(s) = &l.shifted { (row("couch shift alone", s)) } (row("after", &l.after)) }
        }
        table {
            tbody {
                tr { td { "Mean of ratios after / before (thesis eq. 4.2, 4.3)" } td.n { (format!("{:.2} \u{b1} {:.2}", l.mean_of_ratios, l.std_of_ratios)) } }
                tr { td { "Ratio of means after / before" } td.n { (format!("{:.2}", l.ratio_of_means)) } }
            }
        }
        p.note { "Landmarks only evaluate; they never enter the fit." }
    }
}

/// Each landmark with its residuals as numbers and as dots on one scale.
pub(super) fn landmarks(report: &Report) -> Markup {
    let Some(l) = &report.landmarks else { return html! {} };
    let top = l.before.max.max(l.after.max).max(1e-9);
    let residual: Vec<f64> = l.each.iter().map(|r| r.after.unwrap_or(f64::INFINITY)).collect();
    let on_paper = printed(&residual, LANDMARKS_ON_PAPER);
    html! {
        p.key {
            span { i.dot-before style="border-radius: 50%" {} "before" }
            span { i.dot-after style="border-radius: 50%" {} "after" }
            span.note { (format!("scale 0 to {top:.1} mm")) }
        }
        div.rows.dense[l.each.len() > FEW] { table {
            thead { tr { th.n { "#" } th { "Landmark" } th.n { "before mm" } th.n { "after mm" } th.n.screen { "ratio" } th { "residual" } } }
            tbody {
                @for (i, r) in l.each.iter().enumerate() {
                    tr.screen[!on_paper[i]] {
                        td.n { (i + 1) }
                        td.wide { span.short { (r.landmark.name) } }
                        td.n { (format!("{:.2}", r.before)) }
                        td.n { (number(r.after, 2)) }
                        td.n.screen { (number(r.after.filter(|_| r.before > 0.0).map(|a| a / r.before), 2)) }
                        td { (dots(r, top)) }
                    }
                }
            }
        } }
        (more(l.each.len(), LANDMARKS_ON_PAPER, ["landmark with a smaller residual", "landmarks with smaller residuals"], "landmarks.csv"))
    }
}

fn dots(r: &LandmarkResidual, top: f64) -> Markup {
    let share = |mm: f64| 100.0 * mm / top;
    html! {
        div.track {
            @if let Some(after) = r.after {
                u style=(format!("left: {:.1}%; width: {:.1}%", share(after.min(r.before)), share((after - r.before).abs()))) {}
            }
            i.dot-before style=(format!("left: {:.1}%", share(r.before))) {}
            @if let Some(after) = r.after { i.dot-after style=(format!("left: {:.1}%", share(after))) {} }
        }
    }
}

/// How far the result may be trusted.
pub(super) fn trust(report: &Report) -> Markup {
    let Some(u) = &report.uncertainty else { return html! {} };
    let s = &u.soft_tissue_mm;
    html! {
        div {
            p.note {
                "Estimated, not measured: it tells where to look first (Spearman 0.5 to 0.6), and is no interval. On the four posed CTs that it was "
                "tuned on, 66 to 87 % of errors lie below it and 99 % below three times as much; on phantoms, whose tissue also moves "
                "where no image shows it, 34 to 52 % and 86 to 94 %; in a breathing chest without --organs 30 % and 79 % (docs/validation.md)."
            }
            table {
                thead { tr { th { "Soft tissue" } th {} } }
                tbody {
                    tr { td { "Median" } td.n { (in_mm(s.median, 2)) " mm" } }
                    tr { td { "95th percentile" } td.n { (in_mm(s.p95, 2)) " mm" } }
                    tr { td { "Mean, greatest of what is known" } td.n { (format!("{:.2}, {:.2} mm", s.mean, s.max)) } }
                    tr { td { "Above 2 mm or not known" } td.n { (format!("{:.1} ml", u.above_2mm_ml)) } }
                    tr { td { "Images say nothing" } td.n { (format!("{:.1} %", u.without_images_percent)) } }
                    @if u.unknown_percent > 0.0 {
                        tr { td { "Not known (above 30 mm)" } td.n { (format!("{:.1} %", u.unknown_percent)) } }
                    }
                    @if let Some(lung) = &u.lung {
                        tr { td { (format!("Lung ({:.0} ml): median", lung.ml)) } td.n { (in_mm(lung.mm.median, 2)) " mm" } }
                        tr { td { "Lung: 95th percentile" } td.n { (in_mm(lung.mm.p95, 2)) " mm" } }
                        tr { td { "Lung: above 2 mm or not known" } td.n { (format!("{:.1} ml", lung.above_2mm_ml)) } }
                    }
                }
            }
        }
    }
}

/// Organs that were asked to change their volume.
pub(super) fn volumes(report: &Report) -> Markup {
    html! {
        @if !report.volume_changes.is_empty() {
            table {
                thead { tr { th { "Volume after over before" } th.n { "asked" } th.n { "reached" } } }
                tbody {
                    @for (n, v) in report.volume_changes.iter().enumerate() {
                        tr.screen[n >= ORGANS_ON_PAPER] { td { span.short { (v.organ) } } td.n { (format!("{:.3}", v.factor)) } td.n { (number(v.reached, 3)) } }
                    }
                }
            }
            (more(report.volume_changes.len(), ORGANS_ON_PAPER, ["organ", "organs"], "report.json"))
        }
    }
}

/// Structures that guided, and how near their outlines come.
pub(super) fn guides(report: &Report) -> Markup {
    let told = |a: &Option<OutlineAgreement>| {
        a.map_or_else(|| "-".to_owned(), |a| format!("{:.3}, {:.2}, {:.2}", a.dice, a.mean_mm, a.p95_mm))
    };
    let images = |pair: Option<[f64; 2]>| pair.map_or_else(|| "-".to_owned(), |[a, b]| format!("{a:.2}, {b:.2}"));
    html! {
        @if !report.guides.is_empty() {
            table {
                thead { tr { th { "Guide (Dice; mean and 95 % distance, mm)" } th.n { "ml" } th.n { "without guides" } th.n { "with guides" } th.n { "image correlation" } } }
                tbody {
                    @for (n, g) in report.guides.iter().enumerate() {
                        tr.screen[n >= ORGANS_ON_PAPER] {
                            td { span.short { (g.name) } }
                            td.n { (format!("{:.1} → {:.1}", g.planning_ml, g.fraction_ml)) }
                            td.n { (told(&g.before)) }
                            td.n { (told(&g.after)) }
                            td.n { (images(g.images)) }
                        }
                    }
                }
            }
            (more(report.guides.len(), ORGANS_ON_PAPER, ["guide", "guides"], "report.json"))
        }
    }
}

/// Gaps that grow by less are not shown, mm.
const SHOWN_GROWTH_MM: f64 = 0.5;

/// Bones that overlap, joints that open, skin on skin.
pub(super) fn contact(report: &Report) -> Markup {
    let c = &report.contact;
    let opening: Vec<_> = c.joints.iter().filter(|j| j.growth_mm() > SHOWN_GROWTH_MM).collect();
    html! {
        p.note {
            "Bones do not overlap. Labels do, and so does the true motion of a jaw, by some tenths of a millimetre to one; where it is more, look at label, joint and fit. Depth is what exceeds the overlap in the "
            "planning CT, from " (format!("{LISTED_MM} mm")) " on; a gap is the least distance of two surfaces. Labels are known to about half a voxel."
        }
        div.pair {
            @if c.overlaps.is_empty() {
                p { "No bones overlap by " (format!("{LISTED_MM} mm")) " or more." }
            } @else {
                table {
                    thead { tr { th { "Overlapping bones" } th.n { "Depth" br; "mm" } th.n { "At (fraction)" br; "LPS mm" } } }
                    tbody {
                        @for (n, o) in c.overlaps.iter().enumerate() {
                            tr.screen[n >= PAIRS_ON_PAPER] { td { span.short { (o.bones[0]) ", " (o.bones[1]) } } td.n { (format!("{:.2}", o.depth_mm)) } td.n { (format!("{:.0}, {:.0}, {:.0}", o.at.x, o.at.y, o.at.z)) } }
                        }
                    }
                }
            }
            @if opening.is_empty() {
                p { "No joint opens by more than " (format!("{SHOWN_GROWTH_MM} mm")) "." }
            } @else {
                table {
                    thead { tr { th { "Joints that open" } th.n { "Gap before" br; "mm" } th.n { "after" br; "mm" } th.n { "soft range" br; "mm" } } }
                    tbody {
                        @for (n, j) in opening.iter().enumerate() {
                            tr.screen[n >= PAIRS_ON_PAPER] { td { span.short { (j.bones[0]) ", " (j.bones[1]) } } @for v in [j.planning_mm, j.fraction_mm, j.play_mm] { td.n { (format!("{v:.2}")) } } }
                        }
                    }
                }
            }
        }
        (more(c.overlaps.len().max(opening.len()), PAIRS_ON_PAPER, ["pair", "pairs"], "report.json"))
        p {
            @if c.skin_voxels == 0 { "Skin passes through skin nowhere." }
            @else { "Skin passes through skin in " (format!("{:.2} ml", c.skin_ml)) " (" (count(c.skin_voxels)) (form(c.skin_voxels, " fraction voxel", " fraction voxels")) ", skin_contact.nii.gz)." }
        }
    }
}

/// The five characteristics of thesis Tab. 2 and what lies around them.
pub(super) fn jacobian(report: &Report) -> Markup {
    let j = &report.jacobian;
    let uneven = |s: &JacobianStats| s.folded > 0 || s.min < 0.999 || s.max > 1.001;
    let (shown, rigid): (Vec<_>, Vec<_>) = j.bones.iter().partition(|(_, s)| uneven(s));
    html! {
        p.note {
            "Volume after over before, per cell of the planning grid; tissue is body above -500 HU. The first row has all of it, as the thesis's Tab. 2; the others are parts. J<0 counts all cells, the other figures the "
            "positive ones. Contact cells have corners in two or more bones: where rigid bones slide or meet, even the truth folds. Interface cells lie where "
            "declared pairs of bones slide on each other."
        }
        table {
            thead {
                tr {
                    th { "Cells" } th.n { "number" } th.n { "folded" } th.n { "J<0 %" } th.n { "J>2 %" } th.n { "J<0.5 %" } th.n { "mean" } th.n { "max" }
                    th.n { "min" } th.n { "1 %" } th.n { "99 %" }
                }
            }
            tbody {
                (jacobian_row("All tissue above -500 HU", &j.all))
                (jacobian_row("Tissue outside contact and interfaces", &j.body))
                (jacobian_row("Soft tissue", &j.soft_tissue))
                (jacobian_row("Bone contact", &j.contact))
                @if j.interface.cells > 0 { (jacobian_row("Sliding interfaces", &j.interface)) }
                @for (n, (name, s)) in shown.iter().enumerate() { (row_of_cells(name, s, n >= CELLS_ON_PAPER)) }
            }
        }
        (more(shown.len(), CELLS_ON_PAPER, ["bone", "bones"], "report.json"))
        p {
            @if !rigid.is_empty() { "Inside " (counted(rigid.len(), "bone", "bones")) " every Jacobian is 1 within 0.001. " }
            @if j.folded_outside > 0 {
                (count(j.folded_outside)) (form(j.folded_outside, " more cell of the written field folds", " more cells of the written field fold")) " outside tissue, in air and beyond the patient. "
            }
            @if j.across > 0 {
                (count(j.across)) (form(j.across, " more cell reaches", " more cells reach")) " across a surface along which lung or organs slide: the field jumps there, and no figure counts it. "
            }
            (count(j.digital_folded)) (form(j.digital_folded, " soft-tissue cell fails", " soft-tissue cells fail")) " the stricter digital criterion (any of 10 tetrahedra not positive; Liu et al., Int. J. Comput. Vis. 2024). "
            (count(j.jumps_above_10)) (form(j.jumps_above_10, " pair of neighbouring cells differs", " pairs of neighbouring cells differ")) " by more than 10."
        }
    }
}

/// The form of a word that a number asks for.
fn form<'a>(n: usize, one: &'a str, many: &'a str) -> &'a str {
    if n == 1 { one } else { many }
}

fn jacobian_row(name: &str, s: &JacobianStats) -> Markup {
    row_of_cells(name, s, false)
}

fn row_of_cells(name: &str, s: &JacobianStats, on_screen_alone: bool) -> Markup {
    html! {
        tr.screen[on_screen_alone] {
            td { span.short { (name) } } td.n { (count(s.cells)) } td.n { (count(s.folded)) }
            @for v in [s.folded_percent, s.above_2_percent, s.below_half_percent, s.mean, s.max, s.min, s.p1, s.p99] {
                // No cells have no figures.
                td.n { (number((s.cells > 0).then_some(v), 3)) }
            }
        }
    }
}

/// Quality of the pull field, and links outside their valid region.
pub(super) fn inverse_and_links(report: &Report) -> Markup {
    let (inverse, links) = (&report.inverse, &report.links);
    let share = |n: usize| format!("{} ({:.2} %)", count(n), 100.0 * n as f64 / inverse.voxels.max(1) as f64);
    let (r, back) = (&inverse.residual_mm, &report.consistency.there_and_back_mm);
    html! {
        div.pair {
            table {
                thead { tr { th { "Inverse (pull field, fraction grid)" } th {} } }
                tbody {
                    tr { td { "Residual, mean / 95 % / worst" } td.n { (format!("{:.4} / {:.4} / {:.4} mm", r.mean, r.p95, r.max)) } }
                    tr { td { "Inverse-consistency error (planning to fraction and back) beyond 10 mm from bone contact and 5 mm from sliding surfaces, mean / 95 % / worst" } td.n { (format!("{:.3} / {:.3} / {:.3} mm", back.mean, back.p95, back.max)) } }
                    tr { td { "Of those, beyond the limit that soft tissue is moved to (consistency.limit_mm; before it was moved)" } td.n { (count(report.consistency.beyond)) " (" (count(report.consistency.beyond_before)) ") of " (count(back.n)) } }
                    tr { td { "Voxels inverted, of all in the fraction's grid (shares are of these)" } td.n { (count(r.n)) " of " (count(inverse.voxels)) } }
                    tr { td { "Not converged" } td.n { (share(inverse.unconverged)) } }
                    tr { td { "Not converged, in tissue" } td.n { (share(inverse.unconverged_tissue)) } }
                    tr { td { "Of those, shown as outside the planning scan" } td.n { (inverse.strayed) } }
                    tr { td { "Worst residual where not converged" } td.n { (format!("{:.2} mm", inverse.unconverged_max_mm)) } }
                    tr { td { "More than one pre-image" } td.n { (share(inverse.multiple)) } }
                    tr { td { "Pre-image outside the planning scan" } td.n { (share(inverse.outside)) } }
                }
            }
            table {
                thead { tr { th { "Chain-mail links" } th {} } }
                tbody {
                    tr { td { "Links" } td.n { (count(links.links)) } }
                    tr { td { "Outside min, max or shear" } td.n { (format!("{} ({:.3} %)", count(links.violated), links.violated_percent)) } }
                    tr { td { "Excess, mean / 95 % / worst" } td.n { (format!("{:.3} / {:.3} / {:.3} mm", links.mean_excess_mm, links.p95_excess_mm, links.max_excess_mm)) } }
                    @if let Some(waves) = &report.pruning {
                        tr { td { "Bones whose influence was pruned where it hardly weighs" } td.n { (waves.waves) " of " (waves.of) } }
                        tr { td { "Weight of one there / change of a node by all of them, at most" } td.n { (format!("{:.4} % / {:.2} mm", waves.each_percent, waves.most_mm)) } }
                    }
                }
            }
        }
    }
}
