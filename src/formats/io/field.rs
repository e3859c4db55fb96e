//! Displacement fields as files: float32 LPS mm vectors that ITK, ANTs, greedy, plastimatch and Slicer read alike.

use super::Loaded;
use super::dicom::registration;
use super::image::{WriteOptions, write};
use super::load::load;
use super::raster::require_finite;
use super::values::{Contents, Meaning, Values};
use crate::error::{Error, Result};
use crate::field::{FieldFormat, PullField, PushField};
use crate::volume::Volume;
use std::borrow::Cow;
use std::path::Path;

/// A displacement field and its file.
pub type FieldFile = Loaded<Volume<[f32; 3]>>;

/// Reads a displacement field, LPS mm.
///
/// NIfTI of intent 1007 is LPS and 1006 is RAS, as ITK has it; NiftyReg's displacement and deformation fields are known by
/// their `NREG_TRANS`. MetaImage and NRRD vectors are LPS. The file does not tell which way a field points. A DICOM
/// Deformable Spatial Registration is read as well; it joins frames of reference, see [`read_field_between`].
///
/// # Errors
/// [`Error::Input`] for anything else, above all 4-D files and intent 0, which other tools read wrongly without a word;
/// and when a component is NaN or infinite. [`Error::Read`] when the file cannot be read.
pub fn read_field(path: impl AsRef<Path>) -> Result<FieldFile> {
    read_field_between(path).map(|(field, _)| field)
}

/// [`read_field`], also with the frames of reference (DICOM UIDs) whose points it takes and where they arrive, where the
/// file is a Deformable Spatial Registration.
///
/// # Errors
/// As [`read_field`], and [`registration::read_deformable`].
pub fn read_field_between(path: impl AsRef<Path>) -> Result<(FieldFile, Option<[String; 2]>)> {
    let path = path.as_ref();
    match registration::kind_of(path) {
        None => {}
        Some(registration::Kind::Deformable) => {
            return registration::read_field(path).map(|(field, frames)| (field, Some(frames)));
        }
        Some(registration::Kind::Rigid) => {
            let problem = "it is a Spatial Registration, one rigid transform, and a displacement field is asked for";
            let remedy =
                "give a Deformable Spatial Registration, or make a field of it with `aventail warp --out-field`";
            return Err(Error::input(path.display().to_string(), problem, remedy));
        }
    }
    let field = load(path, |raster| {
        let (field, odd) = raster.displacements(path)?;
        require_finite(path, field, odd, |v: [f32; 3]| v.iter().all(|c| c.is_finite()))
    })?;
    Ok((field, None))
}

/// Writes a displacement field, LPS mm, in the layout of `format`. `options.description` should tell the direction, as
/// [`direction`] words it.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written, [`Error::Usage`] when the extension of `path` is not the format's.
pub fn write_field(
    path: impl AsRef<Path>,
    field: &Volume<[f32; 3]>,
    format: FieldFormat,
    options: &WriteOptions,
) -> Result<()> {
    let path = path.as_ref();
    if FieldFormat::of(path)? != format.container() {
        let problem = format!("{}: its extension is not that of the field format", path.display());
        return Err(Error::usage(problem, format!("name it .{}, or choose another --dvf-format", format.extension())));
    }
    let grid = field.grid();
    let ras = |&[x, y, z]: &[f32; 3]| [-x, -y, z];
    let stored: Cow<'_, [[f32; 3]]> = match format {
        FieldFormat::Nifti | FieldFormat::MetaImage | FieldFormat::Nrrd => field.data().into(),
        FieldFormat::Dispvect | FieldFormat::NiftyregDisplacement => field.data().iter().map(ras).collect(),
        FieldFormat::NiftyregDeformation => {
            let positions = field.data().iter().enumerate().map(|(n, u)| {
                let here = grid.centre(grid.voxel(n));
                ras(&std::array::from_fn(|a| (here[a] + f64::from(u[a])) as f32))
            });
            positions.collect()
        }
    };
    let contents = Contents {
        grid,
        values: Values::Vectors(&stored),
        meaning: Meaning::Field(format),
        description: &options.description,
        extension: None,
    };
    write(path, &contents, options.gzip_level)
}

/// Header text of a field on the grid of frame `from` that takes its points to frame `to`.
pub fn direction(from: &str, to: &str, format: FieldFormat) -> String {
    format!("aventail {from}_to_{to}: {from} x goes to {to} x+u(x), {}", format.vectors())
}

/// The frames that a field joins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldFrames {
    /// Whose points it takes.
    pub from: String,
    /// Where they arrive.
    pub to: String,
}

impl FieldFrames {
    /// Of two names.
    pub fn new(from: impl Into<String>, to: impl Into<String>) -> Self {
        Self { from: from.into(), to: to.into() }
    }
}

/// Frames that a header's text says a field points from and to, if aventail wrote it.
pub fn frames_of(description: &str) -> Option<FieldFrames> {
    let (head, _) = description.strip_prefix("aventail ")?.split_once(':')?;
    let (from, to) = head.split_once("_to_")?;
    (!from.contains(' ') && !to.contains(' ')).then(|| FieldFrames::new(from, to))
}

/// Writes a push field with its direction in the header's text.
///
/// # Errors
/// As [`write_field`].
pub fn write_push(path: impl AsRef<Path>, field: &PushField, format: FieldFormat, gzip_level: u32) -> Result<()> {
    let description = direction("planning", "fraction", format);
    write_field(path, &field.displacement, format, &WriteOptions { gzip_level, description })
}

/// Writes a pull field with its direction in the header's text.
///
/// # Errors
/// As [`write_field`].
pub fn write_pull(path: impl AsRef<Path>, field: &PullField, format: FieldFormat, gzip_level: u32) -> Result<()> {
    let description = direction("fraction", "planning", format);
    write_field(path, &field.displacement, format, &WriteOptions { gzip_level, description })
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use nalgebra::{Point3, Rotation3, Vector3};

    fn oblique() -> Volume<[f32; 3]> {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.3).into_inner();
        let grid = Grid::new([5, 4, 3], [2.0, 1.5, 3.0], Point3::new(-40.0, 25.0, 300.0), turn).unwrap();
        Volume::from_fn(grid, |l| [0.5 * l as f32, -3.25, 7.0 - l as f32])
    }

    #[test]
    fn every_layout_comes_back_and_tells_its_direction() {
        let dir = tempfile::tempdir().unwrap();
        let field = oblique();
        for format in [
            FieldFormat::Nifti,
            FieldFormat::MetaImage,
            FieldFormat::Nrrd,
            FieldFormat::Dispvect,
            FieldFormat::NiftyregDisplacement,
            FieldFormat::NiftyregDeformation,
        ] {
            let path = dir.path().join("f").with_extension(format.extension());
            let description = direction("planning", "week_3", format);
            write_field(&path, &field, format, &WriteOptions { description, ..WriteOptions::default() }).unwrap();
            let back = read_field(&path).unwrap();
            assert_eq!(frames_of(&back.header.description), Some(FieldFrames::new("planning", "week_3")), "{format:?}");
            for (a, b) in field.data().iter().flatten().zip(back.value.data().iter().flatten()) {
                // Positions of 300 mm have float32 steps of 3e-5 mm.
                assert!((a - b).abs() < 1e-4, "{format:?}: {a} {b}");
            }
        }
    }

    #[test]
    fn ras_layouts_negate_x_and_y_in_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let grid = Grid::axis_aligned([1, 1, 1], [1.0; 3], [10.0, 20.0, 30.0]).unwrap();
        let field = Volume::filled(grid, [1.0, 2.0, 3.0]);
        for (format, intent, kind, stored) in [
            (FieldFormat::Nifti, 1007, 0.0, [1.0, 2.0, 3.0f32]),
            (FieldFormat::Dispvect, 1006, 0.0, [-1.0, -2.0, 3.0]),
            (FieldFormat::NiftyregDisplacement, 1007, 1.0, [-1.0, -2.0, 3.0]),
            (FieldFormat::NiftyregDeformation, 1007, 0.0, [-11.0, -22.0, 33.0]),
        ] {
            let path = dir.path().join("f.nii");
            write_field(&path, &field, format, &WriteOptions::default()).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
            assert_eq!(i16::from_le_bytes([bytes[68], bytes[69]]), intent);
            assert_eq!(float(56), kind);
            assert_eq!([352, 356, 360].map(float), stored, "{format:?}");
        }
    }

    #[test]
    fn an_extension_that_is_not_the_formats_is_refused() {
        let error = write_field("/nowhere/f.mha", &oblique(), FieldFormat::Dispvect, &WriteOptions::default());
        assert_eq!(error.unwrap_err().exit_code(), 2);
        assert_eq!(frames_of("made by hand"), None);
    }
}
