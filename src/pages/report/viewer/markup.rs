//! The viewer's part of the page.

use super::View;
use base64::{Engine, engine::general_purpose::STANDARD};
use maud::{Markup, PreEscaped, html};
use sha2::{Digest, Sha256};

/// The page's script, the same in every page.
const SCRIPT: &str = concat!(
    "'use strict';\n(() => {\n",
    include_str!("volumes.js"),
    include_str!("planes.js"),
    include_str!("viewer.js"),
    "})();\n"
);

const STYLE: &str = include_str!("viewer.css");

/// What the page may do: show pictures and styles of its own, run the script of the viewer if there
/// is one, and nothing else; no network.
pub(in crate::report) fn policy(view: bool) -> String {
    let script =
        if view { format!(" script-src 'sha256-{}';", STANDARD.encode(Sha256::digest(SCRIPT))) } else { String::new() };
    format!("default-src 'none'; img-src data:;{script} style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'")
}

/// The same of a page whose pictures are files beside it.
pub(in crate::report) fn policy_of_files() -> String {
    policy(false).replace("img-src data:", "img-src 'self' file:")
}

/// The viewer, hidden until its script shows it.
pub(in crate::report) fn section(view: &View) -> Markup {
    html! {
        style { (PreEscaped(STYLE)) }
        section.viewer #viewer hidden {
            h2 { "View the scans" }
            p.failed.note hidden { "This browser cannot show the volumes; use the pictures below." }
            (tools(view.about["shifted"] == true, view.about["landmarks"].as_array().is_some_and(|all| !all.is_empty())))
            p.key { span.seen {} span.scale hidden { b {} i {} b {} } span.note.window {} }
            div.planes {
                (plane("axial"))
                (panel(view.about["mr"] == true))
                (plane("coronal"))
                (plane("sagittal"))
            }
            (notes(view))
        }
        script type="application/json" #view-about { (data(&view.about)) }
        @for (name, bytes) in &view.volumes {
            script type="text/plain" id={ "view-" (name) } { (PreEscaped(STANDARD.encode(bytes))) }
        }
        script { (PreEscaped(SCRIPT)) }
    }
}

/// JSON inside a script element: a `<` could end it, or begin a comment.
fn data(value: &serde_json::Value) -> PreEscaped<String> {
    PreEscaped(value.to_string().replace('<', "\\u003c").replace('>', "\\u003e").replace('&', "\\u0026"))
}

/// `shifted`: planning as scanned is already moved by the couch shift; `marks`: there are landmarks to show.
fn tools(shifted: bool, marks: bool) -> Markup {
    let modes = [
        ("colour", "Colour"),
        ("curtain", "Curtain"),
        ("checker", "Checkerboard"),
        ("blink", "Blink"),
        ("difference", "Difference"),
        ("planning", "Planning"),
        ("fraction", "Fraction"),
    ];
    let flags = [
        ("bonesBefore", "outlines before", "#b0b8c4"),
        ("bonesAfter", "outlines after", "#e8c400"),
        ("arrows", "arrows", ""),
        ("marks", "landmarks", ""),
    ];
    let presets = [
        ("both", "soft tissue and bone"),
        ("soft", "soft tissue"),
        ("bone", "bone"),
        ("lung", "lung"),
        ("auto", "automatic"),
        ("own", "custom"),
    ];
    let maps =
        [("", "none"), ("displacement", "displacement"), ("jacobian", "Jacobian"), ("uncertainty", "uncertainty")];
    html! {
        div.tools {
            span.joined role="group" aria-label="Display mode" {
                @for (mode, name) in modes { button type="button" data-mode=(mode) { (name) } }
            }
            span.joined role="group" aria-label="Planning CT" {
                button type="button" data-moved="scanned" { "as scanned" }
                @if !shifted { button type="button" data-moved="couch" { "couch shift only" } }
                button type="button" data-moved="deformed" { "deformed" }
            }
        }
        div.tools {
            label { "Window" select data-preset { @for (value, name) in presets { option value=(value) { (name) } } } }
            label { "Map" select data-map { @for (value, name) in maps { option value=(value) { (name) } } } }
            @for (flag, name, colour) in flags.into_iter().filter(|(flag, ..)| marks || *flag != "marks") {
                label {
                    input type="checkbox" data-flag=(flag);
                    @if !colour.is_empty() { i.outline style={ "color: " (colour) } {} }
                    (name)
                }
            }
        }
    }
}

fn plane(kind: &str) -> Markup {
    html! {
        div data-plane=(kind) {
            canvas tabindex="0" role="img" aria-label={ (kind) " plane" } {}
            div.slice { output {} input type="range" min="0" step="1" aria-label={ "Slice of the " (kind) " plane" }; }
        }
    }
}

/// What is under the crosshair, and where else to look; `mr`: the fraction has no HU.
fn panel(mr: bool) -> Markup {
    let rows = [
        ("at", "Crosshair, LPS mm"),
        ("fraction", if mr { "Fraction, grey value" } else { "Fraction, HU" }),
        ("deformed", "Planning deformed, HU"),
        ("planning", "Planning undeformed, HU"),
        ("from", "Planning position, LPS mm"),
        ("displacement", "Displacement, mm"),
        ("jacobian", "Jacobian"),
        ("uncertainty", "Uncertainty, mm"),
        ("bone", "Bone"),
    ];
    html! {
        div.panel {
            table { tbody { @for (name, what) in rows { tr { td { (what) } td data-told=(name) {} } } } }
            @for name in ["places", "landmarks", "structures", "bones"] {
                details data-list=(name) hidden open[name == "places"] { summary {} }
            }
        }
    }
}

fn notes(view: &View) -> Markup {
    let edges = |grid: &str| {
        let spacing: Vec<f64> = serde_json::from_value(view.about[grid]["spacing"].clone()).unwrap_or_default();
        let texts = spacing.iter().map(|s| format!("{}", (s * 100.0).round() / 100.0));
        texts.collect::<Vec<_>>().join(" \u{d7} ")
    };
    let whole = view.about["hu"]["step"] == 1.0;
    html! {
        p.note {
            "Click or drag to move the crosshair; arrow keys move it by a voxel. The wheel, Page Up and Page Down scroll through the slices. "
            "Keys: 1 planning as scanned, 2 planning deformed, 3 fraction, 4 colour, 5 curtain, 6 checkerboard, 7 difference, B blink, "
            "M switches the planning CT (as scanned, couch shift only, deformed), O outlines, A arrows, + and \u{2212} (or Ctrl and wheel) zoom. "
            "Drag with the right button, or with Shift, to set window level and width."
        }
        p.note {
            "The planes show voxels of the fraction grid, " (edges("grid")) " mm apart, with "
            @if whole { "every HU value. " } @else { "HU in steps of 4; all HU below \u{2212}900 look alike. " }
            "The undeformed planning CT is interpolated. Displacement (planning to fraction), Jacobian and uncertainty are shown "
            @if whole { "for each voxel." }
            @else { "from the nearest point of a coarser grid, " (edges("coarse")) " mm apart; aventail view shows every voxel." }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::super::embed;
    use super::*;

    #[test]
    fn names_cannot_leave_the_data() {
        let (mut case, mut outcome, _) = example::small();
        let evil = "</script><img src=x onerror=alert(1)><!--";
        case.planning_mut().bones.names.insert(1, evil.into());
        outcome.skeleton.bones[0].name = evil.into();
        outcome.landmarks.as_mut().unwrap().each[0].landmark.name = evil.into();
        outcome.contact.overlaps[0].bones[0] = evil.into();
        let text = section(&embed(&case, &outcome, None).unwrap()).into_string();
        assert!(!text.contains("</script><img") && !text.contains("<!--"));
        let about = text.split("id=\"view-about\"").nth(1).and_then(|rest| rest.split_once('>')).unwrap().1;
        let about = about.split("</script>").next().unwrap();
        let back: serde_json::Value = serde_json::from_str(about).unwrap();
        assert_eq!((&back["names"]["1"], &back["landmarks"][0]["name"]), (&evil.into(), &evil.into()));
    }

    #[test]
    fn landmarks_can_be_shown_where_there_are_some() {
        let (case, mut outcome, _) = example::small();
        let shown = |outcome: &_| section(&embed(&case, outcome, None).unwrap()).into_string();
        assert!(shown(&outcome).contains("data-flag=\"marks\""));
        outcome.landmarks = None;
        assert!(!shown(&outcome).contains("data-flag=\"marks\"") && shown(&outcome).contains("data-flag=\"arrows\""));
    }

    #[test]
    fn the_policy_names_the_script_that_is_there() {
        let (case, outcome, _) = example::small();
        let text = section(&embed(&case, &outcome, None).unwrap()).into_string();
        let script = text.rsplit("<script>").next().unwrap().split("</script>").next().unwrap();
        assert!(policy(true).contains(&STANDARD.encode(Sha256::digest(script))));
        assert!(!policy(false).contains("script"));
        for word in ["fetch(", "XMLHttp", "import(", "innerHTML", "eval(", "</"] {
            assert!(!SCRIPT.contains(word), "{word}");
        }
    }
}
