//! Displacement fields as files: float32 LPS mm vectors that ITK, ANTs, greedy, plastimatch and Slicer read alike.

use super::Loaded;
use super::image::{WriteOptions, write};
use super::raster::{load, require_finite};
use super::values::{Contents, Values};
use crate::error::Result;
use crate::field::{PullField, PushField};
use crate::volume::Volume;
use std::path::Path;

/// Reads a displacement field, LPS mm.
///
/// NIfTI of intent 1007 is LPS and 1006 is RAS, as ITK has it; NiftyReg's displacement and deformation fields are known by
/// their `NREG_TRANS`. MetaImage and NRRD vectors are LPS. The file does not tell which way a field points.
///
/// # Errors
/// [`crate::Error::Input`] for anything else, above all 4-D files and intent 0, which other tools read wrongly without a word;
/// and when a component is NaN or infinite. [`crate::Error::Read`] when the file cannot be read.
pub fn read_field(path: impl AsRef<Path>) -> Result<Loaded<Volume<[f32; 3]>>> {
    let path = path.as_ref();
    load(path, |raster| {
        let (field, odd) = raster.displacements(path)?;
        require_finite(path, field, odd, |v: [f32; 3]| v.iter().all(|c| c.is_finite()))
    })
}

/// Writes a displacement field, LPS mm; the extension of `path` chooses the format. `options.description` should tell
/// the direction, as [`write_push`] and [`write_pull`] do.
///
/// # Errors
/// [`crate::Error::Write`] when the file cannot be written, [`crate::Error::Usage`] when its extension is unknown.
pub fn write_field(path: impl AsRef<Path>, field: &Volume<[f32; 3]>, options: &WriteOptions) -> Result<()> {
    let description = &options.description;
    let contents = Contents {
        grid: field.grid(),
        values: Values::Vectors(field.data()),
        labels: false,
        description,
        extension: None,
    };
    write(path.as_ref(), &contents, options.gzip_level)
}

/// Writes a push field with its direction in the header's text.
///
/// # Errors
/// As [`write_field`].
pub fn write_push(path: impl AsRef<Path>, field: &PushField, gzip_level: u32) -> Result<()> {
    let description = "aventail planning_to_fraction: planning x goes to fraction x+u(x), LPS mm";
    write_field(path, &field.displacement, &WriteOptions { gzip_level, description: description.into() })
}

/// Writes a pull field with its direction in the header's text.
///
/// # Errors
/// As [`write_field`].
pub fn write_pull(path: impl AsRef<Path>, field: &PullField, gzip_level: u32) -> Result<()> {
    let description = "aventail fraction_to_planning: fraction y shows planning y+v(y), LPS mm";
    write_field(path, &field.displacement, &WriteOptions { gzip_level, description: description.into() })
}
