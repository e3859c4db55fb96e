//! The page that `aventail view` serves: the viewer with every voxel, and nothing else.

use super::super::viewer::{embed_whole, policy, section};
use super::head;
use crate::config::InputRole;
use crate::error::Result;
use crate::pipeline::{Case, Outcome};
use crate::provenance::Provenance;
use crate::volume::contour::Contours;
use maud::{DOCTYPE, html};
use std::path::Path;

/// The page of a run; everything it needs is inside. `contours`: structures of the planning CT, to be shown before and after.
///
/// # Errors
/// [`crate::Error::Internal`] when a volume cannot be packed.
pub fn view_page(
    case: &Case,
    outcome: &Outcome,
    provenance: &Provenance,
    contours: Option<&Contours>,
) -> Result<String> {
    let view = embed_whole(case, outcome, contours)?;
    let name = |role: InputRole| {
        provenance.file(role).and_then(Path::file_name).map_or(role.to_string(), |n| n.to_string_lossy().into_owned())
    };
    let title = format!("{} \u{2192} {}", name(InputRole::Planning), name(InputRole::Fraction));
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("aventail: {title}"), "", &policy(true)))
            body {
                header { p.brand { "aventail \u{b7} every voxel of the fraction" } h1 { (title) } }
                (section(&view))
                footer { "Verdict and figures are in report.html of the run." }
            }
        }
    };
    Ok(page.into_string())
}
