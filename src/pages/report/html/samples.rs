//! The first samples of a registration, in turns.

use super::super::pictures::ShownSamples;
use super::data_url;
use crate::sampling::SamplingOptions;
use maud::{Markup, html};

/// They are shown in turns; who wants less motion, and paper, gets one below the other.
pub(in crate::report) const STYLE: &str = "
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

/// What samples are, and the pictures of the first of them in turns; a page that has it needs [`STYLE`].
pub(in crate::report) fn turns(samples: &ShownSamples) -> Markup {
    let SamplingOptions { number, seed, scale } = samples.options;
    html! {
        p {
            (number) " other registrations that fit about as well (seed " (seed) ", scale " (scale)
            "). The pictures show in turn what the first " (samples.pictures.len()) " add to the one that was found: bones move "
            "as wholes, neighbours together, and soft tissue varies over some millimetres. Hold the pointer over the picture "
            "to stop."
        }
        div.turns {
            @for p in &samples.pictures {
                figure { img alt=(p.caption) src=(data_url(&p.png)); figcaption { (p.caption) } }
            }
        }
    }
}
