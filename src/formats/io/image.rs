//! Scalar images: reading CT and dose, writing them and masks, in any of the formats.

use super::gzip::Payload;
use super::load::load;
use super::raster::require_finite;
use super::values::{Contents, Meaning, Values};
use super::voxels::Layout;
use super::{Loaded, atomic, dicom, metaimage, nifti, nrrd};
use crate::error::{Error, Result};
use crate::field::FieldFormat;
use crate::volume::{Mask, Spans, Volume};
use std::path::Path;

/// How an image's values are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// As they are, float32.
    Float32,
    /// Rounded to int16, as CT numbers are.
    Int16,
}

/// How files are written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WriteOptions {
    /// Gzip level, 0 (none) to 9 (smallest). Level 1 looks for nothing but runs of a byte in fields, whose numbers repeat
    /// nothing else.
    pub gzip_level: u32,
    /// Free text for the header, for example what the image is; NIfTI keeps 79 bytes of it.
    pub description: String,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self { gzip_level: 1, description: "aventail".into() }
    }
}

/// Reads a 3-D scalar image, LPS mm, with slope and offset applied: a file, a DICOM CT series in HU by its folder, by a slice
/// or by `FOLDER#NUMBER`, or a DICOM dose in Gy.
///
/// # Errors
/// [`Error::Read`] when the file is missing, damaged or of an unknown format; [`Error::Input`] when it is not 3-D and
/// scalar, when its geometry cannot be used, or when voxels are NaN or infinite: such a CT has no value that would be
/// right everywhere, so the user chooses one; of DICOM also as [`super::dicom::read_series`] and
/// [`super::dicom::read_doses`].
pub fn read_image(path: impl AsRef<Path>) -> Result<Loaded<Volume<f32>>> {
    let path = path.as_ref();
    if dicom::is_place(path) {
        return dicom::read_image(path);
    }
    load(path, |raster| {
        let (image, odd) = raster.scalar(path)?;
        require_finite(path, image, odd, f32::is_finite)
    })
}

/// Reads an image that may be an MR: as [`read_image`], but of DICOM also an MR series, in its own grey values.
///
/// # Errors
/// As [`read_image`].
pub fn read_scan(path: impl AsRef<Path>) -> Result<Loaded<Volume<f32>>> {
    let path = path.as_ref();
    if dicom::is_place(path) { dicom::read_scan(path) } else { read_image(path) }
}

/// Reads a dose: as [`read_image`], but of DICOM only an RT Dose, the one in a folder, or those of a plan's beams, summed.
///
/// # Errors
/// As [`read_image`] and [`super::dicom::read_doses`].
pub fn read_dose(path: impl AsRef<Path>) -> Result<Loaded<Volume<f32>>> {
    let path = path.as_ref();
    if dicom::is_place(path) { dicom::read_dose_image(path) } else { read_image(path) }
}

/// Writes a scalar image; the extension of `path` chooses the format.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written, [`Error::Usage`] when its extension is unknown,
/// [`Error::Input`] when a value does not fit into int16.
pub fn write_image(path: impl AsRef<Path>, image: &Volume<f32>, stored: Stored, options: &WriteOptions) -> Result<()> {
    let path = path.as_ref();
    let values = match stored {
        Stored::Float32 => Values::Float(image.data()),
        Stored::Int16 => {
            let fits = |v: &f32| (f32::from(i16::MIN)..=f32::from(i16::MAX)).contains(v);
            if let Some(first) = image.data().iter().position(|v| !fits(v)) {
                let at = image.grid().voxel(first);
                let problem = format!("value {} at voxel {at:?} does not fit into int16", image.data()[first]);
                return Err(Error::input(path.display().to_string(), problem, "write the image as float32"));
            }
            Values::Rounded(image.data())
        }
    };
    let contents = Contents {
        grid: image.grid(),
        values,
        meaning: Meaning::Scalar,
        description: &options.description,
        extension: None,
    };
    write(path, &contents, options.gzip_level)
}

/// Writes a map as float32; the extension of `path` chooses the format.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written, [`Error::Usage`] when its extension is unknown.
pub fn write_map(path: impl AsRef<Path>, map: &Spans<f32>, options: &WriteOptions) -> Result<()> {
    let description = &options.description;
    let contents = Contents {
        grid: map.grid(),
        values: Values::Spans(map),
        meaning: Meaning::Scalar,
        description,
        extension: None,
    };
    write(path.as_ref(), &contents, options.gzip_level)
}

/// Writes a mask as uint8, 1 inside; the extension of `path` chooses the format.
///
/// # Errors
/// As [`write_image`].
pub fn write_mask(path: impl AsRef<Path>, mask: &Mask, options: &WriteOptions) -> Result<()> {
    let description = &options.description;
    let contents = Contents {
        grid: mask.grid(),
        values: Values::Mask(mask.data()),
        meaning: Meaning::Scalar,
        description,
        extension: None,
    };
    write(path.as_ref(), &contents, options.gzip_level)
}

/// Writes contents of any kind in the format that the extension names.
pub(super) fn write(path: &Path, contents: &Contents<'_>, level: u32) -> Result<()> {
    let format = FieldFormat::of(path)?;
    let layout = if format == FieldFormat::Nifti { Layout::Planar } else { Layout::Interleaved };
    // Values are the unit where components lie apart, voxels where they lie together.
    let together = if layout == Layout::Interleaved { contents.values.components() } else { 1 };
    let fill = |range: std::ops::Range<usize>, out: &mut Vec<u8>| {
        contents.values.fill(layout, range.start * together..range.end * together, out);
    };
    let compress = level > 0 && (format == FieldFormat::Nrrd || is_gz(path));
    let header = match format {
        FieldFormat::MetaImage => metaimage::header(contents),
        FieldFormat::Nrrd => nrrd::header(contents, compress),
        _ => nifti::header(path, contents)?,
    };
    let item_bytes = together * contents.values.element().size();
    let noisy = matches!(contents.values, Values::Vectors(_));
    let mut payload = Payload { header, items: contents.values.len() / together, item_bytes, noisy, fill: &fill };
    atomic::write_file(path, |out| match format {
        FieldFormat::Nifti if is_gz(path) => payload.write_gzip(out, level),
        FieldFormat::Nrrd if compress => {
            // Only the values are compressed.
            out.write_all(&std::mem::take(&mut payload.header))?;
            payload.write_gzip(out, level)
        }
        _ => payload.write_plain(out),
    })
}

fn is_gz(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"))
}
