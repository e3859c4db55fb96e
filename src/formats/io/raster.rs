//! A parsed image file of any format, before its values are given a meaning: image, label map or field.

use super::voxels::{Element, Layout, Voxels};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::warning::Warning;
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Which header fields the geometry came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GeometrySource {
    /// NIfTI's 3x4 matrix.
    Sform,
    /// NIfTI's quaternion, because the sform's code is 0.
    Qform,
    /// Voxel sizes alone: position and orientation are unknown.
    Pixdim,
    /// The one geometry of a MetaImage, NRRD or DICOM header.
    Header,
}

/// A NIfTI header extension.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ExtensionNote {
    /// NIfTI's `ecode`; TotalSegmentator's label table has 0.
    pub code: i32,
    /// Length of its content in bytes.
    pub bytes: usize,
}

/// What a header said, apart from the grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeaderNotes {
    /// Format, for example `NIfTI-1`.
    pub format: String,
    /// Stored sizes of all axes, as the header lists them.
    pub sizes: Vec<usize>,
    /// Stored type, for example `int16`.
    pub datatype: String,
    /// Whether values are stored with the most significant byte first.
    pub big_endian: bool,
    /// Whether the values were compressed.
    pub compressed: bool,
    /// Slope and offset of stored values, where there are any: value = raw * slope + inter.
    pub scaling: Option<[f64; 2]>,
    /// Where the geometry came from.
    pub geometry: GeometrySource,
    /// NIfTI's `sform_code`.
    pub sform_code: Option<i16>,
    /// NIfTI's `qform_code`.
    pub qform_code: Option<i16>,
    /// Largest distance in mm between the grid's corners by sform and by qform, when both are set.
    pub disagreement_mm: Option<f64>,
    /// NIfTI's `intent_code`.
    pub intent_code: Option<i16>,
    /// NIfTI's `intent_name`.
    pub intent_name: String,
    /// Free text of the header.
    pub description: String,
    /// NIfTI header extensions.
    pub extensions: Vec<ExtensionNote>,
}

impl HeaderNotes {
    /// Of a format that has none of NIfTI's fields, for values that are neither scaled nor compressed.
    pub(super) fn plain(format: &str, grid: &Grid, datatype: &str, description: &str) -> Self {
        Self {
            format: format.into(),
            sizes: grid.size().to_vec(),
            datatype: datatype.into(),
            big_endian: false,
            compressed: false,
            scaling: None,
            geometry: GeometrySource::Header,
            sform_code: None,
            qform_code: None,
            disagreement_mm: None,
            intent_code: None,
            intent_name: String::new(),
            description: description.into(),
            extensions: Vec::new(),
        }
    }
}

/// What the components of a stored vector mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum VectorKind {
    /// Displacements, LPS mm.
    Lps,
    /// Displacements, RAS mm.
    Ras,
    /// Positions of the other end, RAS mm.
    RasPosition,
}

/// A parsed file: geometry, and stored values with how to read them.
pub(super) struct Raster<'a> {
    pub(super) grid: Grid,
    /// Values per voxel.
    pub(super) components: usize,
    pub(super) layout: Layout,
    /// Meaning of the vectors, or why this is no displacement field.
    pub(super) vectors: Result<VectorKind, String>,
    pub(super) element: Element,
    pub(super) bytes: Cow<'a, [u8]>,
    /// Position of the first value in `bytes`.
    pub(super) offset: usize,
    pub(super) notes: HeaderNotes,
    /// NIfTI header extensions: code and content.
    pub(super) extensions: Vec<(i32, Vec<u8>)>,
    /// Names of labels that the header itself tells.
    pub(super) names: BTreeMap<u16, String>,
    pub(super) warnings: Vec<Warning>,
}

impl Raster<'_> {
    /// Number of stored values.
    fn values(&self) -> usize {
        self.grid.len() * self.components
    }

    /// The stored values.
    ///
    /// # Errors
    /// When the file holds fewer than its header promises.
    pub(super) fn voxels(&self, path: &Path) -> Result<Voxels<'_>> {
        let need = self.values().checked_mul(self.element.size()).and_then(|n| n.checked_add(self.offset));
        let bytes = need.and_then(|end| self.bytes.get(self.offset..end)).ok_or_else(|| {
            let problem = format!(
                "the header promises {} {} values, but the file holds {} bytes of them: it is cut off or damaged",
                self.values(),
                self.element.name(),
                self.bytes.len().saturating_sub(self.offset)
            );
            Error::read(path, problem, "copy or export it again")
        })?;
        let [slope, inter] = self.notes.scaling.unwrap_or([1.0, 0.0]);
        Ok(Voxels { bytes, element: self.element, big_endian: self.notes.big_endian, slope, inter })
    }

    /// One value per voxel, or a refusal that tells the number of values.
    pub(super) fn require_scalar(&self, path: &Path, what: &str) -> Result<()> {
        if self.components == 1 {
            return Ok(());
        }
        let problem =
            format!("it has {} values per voxel (sizes {:?}), not one {what}", self.components, self.notes.sizes);
        Err(Error::input(
            path.display().to_string(),
            problem,
            "give a 3-D file; extract one volume from a series first",
        ))
    }

    /// The values as a scalar image, and how many are not finite.
    pub(super) fn scalar(&self, path: &Path) -> Result<(Volume<f32>, usize)> {
        self.require_scalar(path, "image")?;
        let odd = Odd::default();
        let data = self.voxels(path)?.decode(|v| {
            let v = v as f32;
            odd.note(!v.is_finite());
            v
        });
        Ok((Volume::new(self.grid.clone(), data)?, odd.count()))
    }

    /// The values as displacements, LPS mm, and how many are not finite.
    pub(super) fn displacements(&self, path: &Path) -> Result<(Volume<[f32; 3]>, usize)> {
        let kind = self.vectors.clone().map_err(|problem| {
            let remedy = "save the field as a 5-D NIfTI (x, y, z, 1, 3) with intent_code 1007 and LPS mm components, \
                or as .mha or .nrrd vectors";
            Error::input(path.display().to_string(), problem, remedy)
        })?;
        let odd = Odd::default();
        let data = self.voxels(path)?.decode_vectors(self.layout, |at, [x, y, z]| {
            let vector = match kind {
                VectorKind::Lps => [x, y, z],
                VectorKind::Ras => [-x, -y, z],
                VectorKind::RasPosition => {
                    let here = self.grid.centre(self.grid.voxel(at));
                    [-x - here.x, -y - here.y, z - here.z]
                }
            };
            let vector = vector.map(|c| c as f32);
            odd.note(!vector.iter().all(|c| c.is_finite()));
            vector
        });
        Ok((Volume::new(self.grid.clone(), data)?, odd.count()))
    }
}

/// Counts what should not be there while values are decoded in parallel.
#[derive(Default)]
pub(super) struct Odd(AtomicUsize);

impl Odd {
    /// Counts one value if it is odd.
    pub(super) fn note(&self, odd: bool) {
        if odd {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }
    /// How many were odd.
    pub(super) fn count(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}

/// Refuses a volume with `odd` voxels that are not finite, naming the first.
pub(super) fn require_finite<T: Copy>(
    path: &Path,
    volume: Volume<T>,
    odd: usize,
    finite: impl Fn(T) -> bool,
) -> Result<Volume<T>> {
    if odd == 0 {
        return Ok(volume);
    }
    let first = volume.data().iter().position(|v| !finite(*v)).unwrap_or_default();
    let problem = format!(
        "{odd} of {} voxels are NaN or infinite, the first at voxel {:?}",
        volume.data().len(),
        volume.grid().voxel(first)
    );
    Err(Error::input(
        path.display().to_string(),
        problem,
        "replace them, for example by -1000 HU (air) in a CT or 0 in a dose or field",
    ))
}
