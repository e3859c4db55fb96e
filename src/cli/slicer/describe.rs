//! What the module tells Slicer of itself: the XML of the convention for command-line modules.
//!
//! Source: SlicerExecutionModel, `ModuleDescriptionParser.cxx`. Volumes and transforms reach a module as temporary files
//! whose names end in the first of `fileExtensions`; a transform node read from an image is a field of the parent's grid
//! that leads to where data lie, which is the pull field.

use maud::{Markup, PreEscaped, html};

/// Kinds of parameters that the module has.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Tag {
    Image,
    LabelMap,
    Transform,
    File,
    Directory,
    Integer,
    Choice(&'static [&'static str]),
}

/// One parameter: its flag is `--` and its name.
pub(super) struct Parameter {
    pub(super) name: &'static str,
    label: &'static str,
    description: &'static str,
    tag: Tag,
    input: bool,
    default: &'static str,
}

const fn input(name: &'static str, label: &'static str, description: &'static str, tag: Tag) -> Parameter {
    Parameter { name, label, description, tag, input: true, default: "" }
}

const fn output(name: &'static str, label: &'static str, description: &'static str, tag: Tag) -> Parameter {
    Parameter { name, label, description, tag, input: false, default: "" }
}

/// The panels of the module.
pub(super) const PANELS: [(&str, &str, &[Parameter]); 3] = [
    (
        "Scans",
        "The planning CT with its bone labels, and the fraction CT (CT of the day)",
        &[
            input("planning", "Planning CT", "Planning CT in HU", Tag::Image),
            input(
                "bones",
                "Bones of the planning CT",
                "File of bone labels with names on the planning grid: a segmentation saved as .seg.nrrd, or \
                 TotalSegmentator's .nii.gz",
                Tag::File,
            ),
            input("fraction", "Fraction CT", "Fraction CT (CT of the day) in HU, on any grid", Tag::Image),
            input(
                "labels",
                "Names of the labels",
                "Only if the bone file has no names: a JSON file with them, {\"labels\": {\"1\": \"skull\"}}",
                Tag::File,
            ),
        ],
    ),
    (
        "Results",
        "Choose at least one result; only the chosen ones are made",
        &[
            output(
                "transform",
                "Transform: planning to fraction",
                "Grid transform for the planning CT, its segmentations, models and points: moves them to the fraction",
                Tag::Transform,
            ),
            output(
                "inverse",
                "Transform: fraction to planning",
                "Grid transform for the fraction CT, its segmentations, models and points: moves them to the planning CT",
                Tag::Transform,
            ),
            output("warped", "Planning CT on the fraction", "Deformed planning CT on the fraction's grid", Tag::Image),
            output(
                "warpedBones",
                "Bones on the fraction",
                "Deformed bone labels on the fraction's grid",
                Tag::LabelMap,
            ),
            output(
                "jacobian",
                "Jacobian",
                "Jacobian determinant (volume after / volume before) on the planning grid; -1 where the field folds",
                Tag::Image,
            ),
            output(
                "uncertainty",
                "Uncertainty, mm",
                "Estimated error in mm on the planning grid: on posed CTs two thirds of errors were smaller; -1 where unknown",
                Tag::Image,
            ),
            output(
                "report",
                "Folder of the report",
                "Folder for all result files; open report.html in it before you use the transforms",
                Tag::Directory,
            ),
        ],
    ),
    (
        "Settings",
        "Options of the registration",
        &[
            Parameter {
                default: "balanced",
                ..input(
                    "speed",
                    "Speed",
                    "balanced: recommended; fast: less accurate, and no uncertainty",
                    Tag::Choice(&["fast", "balanced"]),
                )
            },
            input(
                "landmarks",
                "Landmarks",
                "Points known in both scans (CSV); they measure the error and do not change the result",
                Tag::File,
            ),
            input("config", "Settings", "Settings file of aventail (TOML); it replaces Speed", Tag::File),
            Parameter {
                default: "0",
                ..input("threads", "Threads", "Number of threads; 0: one per core", Tag::Integer)
            },
        ],
    ),
];

/// The description.
pub(super) fn xml() -> String {
    let body = html! {
        executable {
            category { "Registration" }
            title { "Articulated Registration (aventail)" }
            description {
                "Deformable registration of a planning CT to a fraction CT for adaptive radiotherapy. Bones move rigidly as a "
                "skeleton with joints; soft tissue follows them. Research software, not a medical device."
            }
            version { (env!("CARGO_PKG_VERSION")) }
            documentation-url {}
            license { (env!("CARGO_PKG_LICENSE")) }
            contributor { "The aventail authors" }
            acknowledgements {}
            @for (label, description, parameters) in PANELS {
                parameters {
                    label { (label) }
                    description { (description) }
                    @for p in parameters { (parameter(p)) }
                }
            }
        }
    };
    format!("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n{}\n", body.into_string())
}

fn parameter(p: &Parameter) -> Markup {
    let channel = if p.input { "input" } else { "output" };
    // The macro has no names that are found at run time.
    let (tag, attributes) = match p.tag {
        Tag::Image => ("image", " fileExtensions=\".nii.gz\""),
        Tag::LabelMap => ("image", " type=\"label\" fileExtensions=\".nii.gz\""),
        Tag::Transform => ("transform", " type=\"nonlinear\" fileExtensions=\".nrrd\""),
        Tag::File => ("file", ""),
        Tag::Directory => ("directory", ""),
        Tag::Integer => ("integer", ""),
        Tag::Choice(_) => ("string-enumeration", ""),
    };
    let choices: &[&str] = if let Tag::Choice(choices) = p.tag { choices } else { &[] };
    html! {
        (PreEscaped(format!("<{tag}{attributes}>")))
        name { (p.name) }
        label { (p.label) }
        description { (p.description) }
        longflag { (p.name) }
        @if !matches!(p.tag, Tag::Integer | Tag::Choice(_)) { channel { (channel) } }
        @if !p.default.is_empty() { default { (p.default) } }
        @for choice in choices { element { (choice) } }
        (PreEscaped(format!("</{tag}>")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_once_there_and_legal() {
        let all: Vec<&str> = PANELS.iter().flat_map(|(_, _, p)| p.iter().map(|p| p.name)).collect();
        let distinct: std::collections::BTreeSet<&&str> = all.iter().collect();
        assert_eq!(distinct.len(), all.len());
        // The parser of the convention takes letters, digits and underscores, and a letter first.
        assert!(all.iter().all(|n| n.starts_with(char::is_alphabetic) && n.chars().all(char::is_alphanumeric)));
    }
}
