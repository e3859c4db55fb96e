//! `library.html`: the spread of a library at one glance, then posture by posture.

use super::super::canvas::Canvas;
use super::super::html::{data_url, head};
use super::super::viewer::policy;
use super::gallery::GalleryShown;
use super::{About, Gallery, PostureRecord, histogram};
use crate::error::{Error, Result};
use crate::postures::sources;
use maud::{DOCTYPE, Markup, html};
use std::collections::BTreeSet;

/// Styles beside the common ones.
const STYLE: &str = "
.thumbs { display: grid; grid-template-columns: repeat(4, minmax(0, 1fr)); gap: 10px; margin: 8px 0 20px; }
.thumbs figure img { border-radius: 3px; }
.thumbs figcaption { margin-top: 2px; font-size: 12px; }
.odd { color: var(--warn); font-weight: 600; }
td.tight, th.tight { padding-right: 8px; }
@media (max-width: 820px) { .thumbs { grid-template-columns: repeat(2, minmax(0, 1fr)); } }
";

/// Implausible postures that are told at the top.
const SHOWN: usize = 8;

/// The page of a library; everything it needs is inside.
///
/// # Errors
/// [`Error::Internal`] when a picture cannot be encoded.
pub fn library_page(title: &str, records: &[PostureRecord], gallery: &Gallery, about: &About) -> Result<String> {
    let shown = gallery.shown()?;
    let bars = encoded(&histogram::draw(records))?;
    let odd: Vec<&PostureRecord> = records.iter().filter(|r| !r.plausible).collect();
    Ok(html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("aventail: {title}"), STYLE, &policy(false)))
            body {
                header { p.brand { "aventail \u{b7} library of postures" } h1 { (title) } }
                p { (summary(records, about, odd.len())) }
                @if !odd.is_empty() {
                    ul.warnings {
                        @for r in odd.iter().take(SHOWN) { li { code { (r.name) } "implausible: " (r.why.join("; ")) } }
                        @if odd.len() > SHOWN { li { (odd.len() - SHOWN) " more: see the table" } }
                    }
                }
                h2 { "Spread" }
                @if let [overlay, rest @ ..] = shown.as_slice() {
                    (plate(overlay))
                    div.pair { @for picture in rest { (plate(picture)) } }
                }
                h2 { "How far bones move" }
                p.note { "Displacement of each bone's centroid, couch included; the line is the mean. Heights are of the fullest bin." }
                figure { img alt="histograms of motion per bone" src=(data_url(&bars)); }
                h2 { "Postures" }
                (table(records))
                div.thumbs {
                    @for (name, png) in &gallery.thumbnails {
                        figure { img alt=(name) src=(data_url(png)); figcaption { (name) } }
                    }
                }
                (rejected(about))
                h2 { "Where the usual variation comes from" }
                p.note { "These sources hold for what the plan does not set itself; " (about.plan) " has every number." }
                table {
                    tbody { @for s in sources() { tr { td { b { (s.part) } } td.wide { (s.source) } } } }
                }
                @if !about.warnings.is_empty() {
                    h2 { "Warnings of the planning side" }
                    ul.warnings { @for w in &about.warnings { li { code { (w.code) } (w.message) } } }
                }
                h2 { "Provenance" }
                (provenance(about))
                section.limits {
                    h2 { "Limits" }
                    p {
                        "Research software, not a medical device. Bones move rigidly about the joints of a skeleton that was built from labels; "
                        "soft tissue follows them by a mechanical model, which is a guess. A dose is carried with the tissue and not computed "
                        "anew. What varies, and by how much, comes from a plan, not from this patient."
                    }
                }
                footer { "aventail " (about.version) ". Angles in degrees, lengths in mm." }
            }
        }
    }
    .into_string())
}

fn plate(picture: &GalleryShown) -> Markup {
    html! {
        figure {
            h3 { (picture.title) }
            img alt=(picture.title) src=(data_url(&picture.png));
            figcaption { (picture.caption) }
        }
    }
}

fn encoded(canvas: &Canvas) -> Result<Vec<u8>> {
    let mut png = Vec::new();
    canvas.write_small_png(&mut png).map_err(|e| Error::Internal(format!("the histograms: {e}")))?;
    Ok(png)
}

fn summary(records: &[PostureRecord], about: &About, odd: usize) -> String {
    let chosen = records.iter().filter(|r| r.chosen.is_some()).count();
    let most = records.iter().filter_map(PostureRecord::greatest).max_by(|a, b| a.1.total_cmp(&b.1));
    let most =
        most.map_or(String::new(), |(bone, mm)| format!(" The greatest motion of a bone is {mm:.1} mm ({bone})."));
    format!(
        "{} postures: {chosen} chosen, {} drawn with seed {} from {} independent numbers. {} implausible, {} drawn and not \
         kept.{most}",
        records.len(),
        about.sampled,
        about.seed,
        about.dimensions,
        odd,
        about.rejected.len()
    )
}

/// A number that may be nothing.
fn figure(v: f64) -> String {
    let v = (v * 10.0).round() / 10.0 + 0.0;
    format!("{v:.1}")
}

/// The parameters of every posture.
fn table(records: &[PostureRecord]) -> Markup {
    let organs: BTreeSet<&str> = records.iter().flat_map(|r| &r.volumes).map(|v| v.organ.as_str()).collect();
    html! {
        table {
            thead {
                tr {
                    th.tight { "Posture" } th.n.tight { "Couch left, back, up mm" } th.n.tight { "Couch turns \u{b0}" }
                    th.n.tight { "Neck flexion, lateral, axial \u{b0}" } th.n.tight { "Jaw \u{b0}" }
                    @for organ in &organs { th.n.tight { (organ) } }
                    th.n.tight { "Most moved bone mm" } th.n.tight { "Overlap mm" } th.n.tight { "Folded" } th.tight { "" }
                }
            }
            tbody { @for r in records { (row(r, &organs)) } }
        }
    }
}

fn row(r: &PostureRecord, organs: &BTreeSet<&str>) -> Markup {
    let volume =
        |organ: &str| r.volumes.iter().find(|v| v.organ == organ).map_or(1.0, |v| v.reached.unwrap_or(v.factor));
    let list = |v: &[f64]| v.iter().map(|v| figure(*v)).collect::<Vec<_>>().join(", ");
    let (bone, mm) = r.greatest().unwrap_or(("", 0.0));
    html! {
        tr {
            td.tight { (r.name) @if let Some(name) = &r.chosen { " " em { (name) } } }
            td.n.tight { (list(&r.totals.couch[3..])) } td.n.tight { (list(&r.totals.couch[..3])) }
            td.n.tight { (list(&r.totals.neck_deg)) } td.n.tight { (figure(r.totals.jaw_deg)) }
            @for organ in organs { td.n.tight { (format!("{:.2}", volume(organ))) } }
            td.n.tight { (bone) " " (figure(mm)) } td.n.tight { (figure(r.deepest_mm())) } td.n.tight { (r.jacobian.folded) }
            td.tight { @if !r.plausible { span.odd { "implausible" } } @else if r.held > 0 { span.note { (r.held) " held" } } }
        }
    }
}

fn rejected(about: &About) -> Markup {
    html! {
        @if !about.rejected.is_empty() {
            h3 { "Drawn and not kept" }
            table {
                thead { tr { th { "Draw" } th { "Why" } } }
                tbody { @for r in &about.rejected { tr { td.n { (r.draw) } td.wide { (r.why.join("; ")) } } } }
            }
        }
    }
}

fn provenance(about: &About) -> Markup {
    let settings = serde_json::to_string_pretty(&about.settings).unwrap_or_default();
    html! {
        table {
            thead { tr { th { "Input" } th { "File" } th { "SHA-256" } } }
            tbody {
                @for i in &about.inputs { tr { td { (i.role) } td.wide { (i.path.display()) } td.mono { (i.sha256) } } }
            }
        }
        h3 { "Command" }
        pre { (about.command) }
        details { summary { "Settings, defaults resolved" } pre { (settings) } }
    }
}
