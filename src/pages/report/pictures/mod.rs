//! The pictures of a report. Each kind is one PNG of axial, coronal and sagittal plane at one scale, with its legend.

mod bones;
pub(super) mod displacement;
mod figure;
mod focus;
mod fusion;
mod jacobian;
mod landmarks;
pub(super) mod legend;
pub(super) mod residuals;
mod scene;
mod shown;
pub(super) mod uncertainty;

use super::canvas::Canvas;
use super::plane::WIDTH;
use super::plot;
use crate::chainmail::Material;
use crate::concepts::transfer_functions;
use crate::error::Result;
use crate::io::write_file;
use crate::pipeline::{Case, Outcome};
pub use figure::{FigureKind, FigureOf, figure};
pub(super) use focus::{focus, in_the_patient};
pub(super) use fusion::{LEAST_SHIFT_MM, is_of_a_place};
use rayon::prelude::*;
use scene::PictureScene;
pub(super) use scene::shift_before;
pub use shown::{SAMPLES_SHOWN, ShownSamples};
use std::path::Path;

/// One picture, encoded, with what the page says about it.
#[derive(Debug, Clone)]
pub struct Picture {
    /// File name without folder, for example `fusion_after.png`.
    pub file: &'static str,
    /// Its heading.
    pub title: &'static str,
    /// What it shows and how to read it.
    pub caption: String,
    /// The PNG file.
    pub png: Vec<u8>,
}

/// Draws every picture of a run; those of landmarks only when there are any.
///
/// # Errors
/// [`crate::error::Error::Internal`] when a picture cannot be encoded.
pub fn draw(case: &Case, outcome: &Outcome) -> Result<Vec<Picture>> {
    let scene = PictureScene::new(case, outcome);
    let mut kinds: Vec<Draw<'_>> =
        vec![Box::new(fusion::before), Box::new(fusion::after), Box::new(displacement::draw), Box::new(jacobian::draw)];
    if let Some((map, _)) = &outcome.uncertainty {
        kinds.push(Box::new(|scene| uncertainty::draw(scene, map)));
    }
    if let Some(report) = outcome.landmarks.as_ref().filter(|r| r.after.n > 0) {
        kinds.push(Box::new(|scene| landmarks::draw(scene, report)));
        kinds.push(Box::new(|_| residuals::draw(report)));
    }
    let sometimes = |draw: fn(&PictureScene<'_>) -> Option<Plate>| draw(&scene).map(Plate::encoded).transpose();
    let (pictures, (couch, lung)) = rayon::join(
        || kinds.par_iter().map(|draw| draw(&scene).encoded()).collect::<Result<Vec<_>>>(),
        || rayon::join(|| sometimes(fusion::couch), || sometimes(fusion::lung)),
    );
    let mut pictures = pictures?;
    pictures.extend([couch?, lung?].into_iter().flatten());
    let places = fusion::places(&scene).into_par_iter().map(Plate::encoded);
    pictures.extend(places.collect::<Result<Vec<_>>>()?);
    Ok(pictures)
}

/// The material transfer function of the run; nothing when its settings do not hold one.
///
/// # Errors
/// [`crate::error::Error::Internal`] when the picture cannot be encoded.
pub(super) fn material(settings: &serde_json::Value) -> Result<Option<Picture>> {
    let Ok(material) = serde_json::from_value::<Material>(settings["chainmail"]["material"].clone()) else {
        return Ok(None);
    };
    let plate = Plate {
        file: "material.png",
        title: "Material transfer function",
        caption: "Least and greatest length of a link and its greatest sideways shift, times its rest length."
            .to_owned(),
        canvas: plot::draw(&transfer_functions(&material), WIDTH, WIDTH * 3 / 5),
    };
    plate.encoded().map(Some)
}

/// Writes each picture into `folder`, which exists.
///
/// # Errors
/// [`crate::error::Error::Write`] when a file cannot be written.
pub(super) fn write(folder: &Path, pictures: &[Picture]) -> Result<()> {
    pictures.iter().try_for_each(|p| write_file(folder.join(p.file), |out| out.write_all(&p.png)))
}

/// Bytes of a picture at most, so that a page of nine stays small.
const MOST_BYTES: usize = 450_000;

/// Draws one kind of picture.
type Draw<'a> = Box<dyn Fn(&PictureScene<'_>) -> Plate + Sync + 'a>;

/// A picture before encoding.
pub(super) struct Plate {
    file: &'static str,
    title: &'static str,
    caption: String,
    pub(super) canvas: Canvas,
}

impl Plate {
    fn encoded(self) -> Result<Picture> {
        let png =
            self.canvas.png_within(MOST_BYTES).map_err(|e| crate::Error::Internal(format!("{}: {e}", self.file)))?;
        Ok(Picture { file: self.file, title: self.title, caption: self.caption, png })
    }
}
