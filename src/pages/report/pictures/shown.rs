//! The first samples of a registration, drawn for pages.

use super::{Picture, PictureScene, Plate, displacement};
use crate::error::Result;
use crate::pipeline::{Case, Outcome};
use crate::sampling::{SampleSet, SamplingOptions};

/// Samples that pages show at most.
pub const SAMPLES_SHOWN: usize = 3;
/// Their pictures.
const DRAWN: [&str; SAMPLES_SHOWN] = ["sample_1.png", "sample_2.png", "sample_3.png"];

/// What each of the first samples adds to the registration, a picture each at one scale.
#[derive(Debug, Clone)]
pub struct ShownSamples {
    pub(in crate::report) pictures: Vec<Picture>,
    pub(in crate::report) options: SamplingOptions,
}

impl ShownSamples {
    /// Draws the first of the samples; `options` are those of all of them.
    ///
    /// # Errors
    /// [`crate::Error::Internal`] when a picture cannot be encoded.
    pub fn draw(case: &Case, outcome: &Outcome, samples: &SampleSet, options: &SamplingOptions) -> Result<Self> {
        let files = &DRAWN[..DRAWN.len().min(samples.number())];
        let plates = displacement::of_samples(&PictureScene::new(case, outcome), samples, files);
        Ok(Self { pictures: plates.into_iter().map(Plate::encoded).collect::<Result<_>>()?, options: *options })
    }
}
