//! What the first of a run's samples add to the registration, in turns: in its report, and on a page of their own.

use super::html::{data_url, head};
use super::pictures::{Picture, of_samples};
use super::viewer::policy;
use crate::error::Result;
use crate::io::write_file;
use crate::pipeline::{Case, Outcome};
use crate::sampling::{SampleSet, SamplingOptions};
use maud::{DOCTYPE, Markup, html};
use std::path::Path;

/// The page's file.
pub const SAMPLES_PAGE: &str = "samples.html";
/// Samples that the page shows at most.
pub const SAMPLES_SHOWN: usize = 3;
/// Their pictures.
const DRAWN: [&str; SAMPLES_SHOWN] = ["sample_1.png", "sample_2.png", "sample_3.png"];
/// They are shown in turns; who wants less motion, and paper, gets one below the other.
pub(super) const STYLE: &str = "
.turns { position: relative; }
.turns figure { margin: 0; }
.turns img { width: 100%; display: block; }
@media screen and (prefers-reduced-motion: no-preference) {
  .turns figure { animation: turn 3.6s step-end infinite; }
  .turns figure + figure { position: absolute; inset: 0; }
  .turns figure:nth-child(2) { animation-delay: -2.4s; }
  .turns figure:nth-child(3) { animation-delay: -1.2s; }
  .turns:hover figure { animation-play-state: paused; }
  @keyframes turn { 0% { opacity: 1; } 33.34% { opacity: 0; } 100% { opacity: 0; } }
}
";

/// The first samples of a run as pages show them.
#[derive(Debug, Clone)]
pub struct ShownSamples {
    pictures: Vec<Picture>,
    options: SamplingOptions,
}

impl ShownSamples {
    /// Draws the first of the samples; `options` are those of all of them.
    ///
    /// # Errors
    /// [`crate::Error::Internal`] when a picture cannot be encoded.
    pub fn draw((case, outcome): (&Case, &Outcome), samples: &SampleSet, options: &SamplingOptions) -> Result<Self> {
        let files = &DRAWN[..DRAWN.len().min(samples.number())];
        Ok(Self { pictures: of_samples(case, outcome, samples, files)?, options: *options })
    }

    /// What they are, and their pictures in turns; a page that has it needs [`STYLE`].
    pub(super) fn section(&self) -> Markup {
        let SamplingOptions { number, seed, scale } = self.options;
        html! {
            p {
                (number) " other registrations that fit about as well (seed " (seed) ", scale " (scale)
                "). The pictures show in turns what the first " (self.pictures.len()) " add to the one that was found: bones move "
                "as wholes, neighbours together, and soft tissue varies over some millimetres. Hold the pointer over the picture "
                "to stop."
            }
            div.turns {
                @for p in &self.pictures {
                    figure { img alt=(p.caption) src=(data_url(&p.png)); figcaption { (p.caption) } }
                }
            }
        }
    }

    /// Writes the page of the samples into `folder`; everything that it needs is inside.
    ///
    /// # Errors
    /// [`crate::Error::Write`] when the file cannot be written.
    pub fn write_page(&self, folder: &Path, command: &str) -> Result<()> {
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                (head("aventail: samples of a registration", STYLE, &policy(false)))
                body {
                    div.sheet {
                        header {
                            p.brand { "aventail \u{b7} samples" }
                            h1 { "How far this registration may be off" }
                        }
                        (self.section())
                    }
                    div.end {
                        pre { span.clip { (command) } }
                        footer {
                            "aventail " (env!("CARGO_PKG_VERSION"))
                            ". Lengths in mm. Calibration: docs/decisions/samples.md."
                        }
                    }
                }
            }
        };
        let page = page.into_string();
        write_file(folder.join(SAMPLES_PAGE), |out| out.write_all(page.as_bytes()))
    }
}
