//! The page of a run's samples: what the first of them add to the registration, in turns.

use super::html::{head, samples as section};
use super::pictures::ShownSamples;
use super::viewer::policy;
use crate::error::Result;
use crate::io::write_file;
use maud::{DOCTYPE, html};
use std::path::Path;

/// The page's file.
pub const SAMPLES_PAGE: &str = "samples.html";

/// Writes the page of samples of a run into `folder`; everything that it needs is inside.
///
/// # Errors
/// [`crate::Error::Write`] when the file cannot be written.
pub fn write_samples_page(folder: &Path, samples: &ShownSamples, command: &str) -> Result<()> {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head("aventail: samples of a registration", section::STYLE, &policy(false)))
            body {
                div.sheet {
                    header {
                        p.brand { "aventail \u{b7} samples" }
                        h1 { "How far this registration may be off" }
                    }
                    (section::turns(samples))
                }
                div.end {
                    pre { span.clip { (command) } }
                    footer { "aventail " (env!("CARGO_PKG_VERSION")) ". Lengths in mm. Calibration: docs/decisions/samples.md." }
                }
            }
        }
    };
    let page = page.into_string();
    write_file(folder.join(SAMPLES_PAGE), |out| out.write_all(page.as_bytes()))
}
