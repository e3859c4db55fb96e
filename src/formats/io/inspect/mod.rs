//! What a file holds, for people and machines: geometry, how the header tells it, and values.

mod folder;
mod text;

pub use folder::{FolderCheck, check_folder, images};

use super::labels::is_label;
use super::load::load_scan;
use super::names::header_names;
use super::raster::{GeometrySource, HeaderNotes, Raster, VectorKind};
use super::voxels::Layout;
use crate::error::Result;
use crate::geometry::Grid;
use crate::view::{View, ViewReport};
use crate::volume::Volume;
use crate::warning::Warning;
use nalgebra::Vector3;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// More distinct values than this are no labels.
const MOST_LABELS: usize = 512;
/// Corner distance in mm up to which two grids are the same.
pub const SAME_GRID_MM: f64 = 1e-3;

/// Summary of one image, label map or field file. `Display` renders it for people.
#[derive(Debug, Clone, Serialize)]
pub struct Inspection {
    /// The file.
    #[serde(serialize_with = "super::path_as_text")]
    pub path: PathBuf,
    /// SHA-256 of its bytes.
    pub sha256: String,
    /// What its header says.
    pub header: HeaderNotes,
    /// The grid, LPS mm.
    pub grid: Grid,
    /// Where the voxel axes point.
    pub orientation: Orientation,
    /// What its values are.
    pub content: Content,
    /// Legal but unusual findings.
    pub warnings: Vec<Warning>,
}

/// Where a grid's axes point.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Orientation {
    /// The direction each axis mostly runs towards, for example `LPS` or `RAS`.
    pub code: String,
    /// Whether the axes are right-handed.
    pub right_handed: bool,
    /// Largest angle between an axis and the body direction it is named after, degrees.
    pub oblique_deg: f64,
}

/// Least, greatest and mean of the finite values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Range {
    /// Least finite value.
    pub least: f64,
    /// Greatest finite value.
    pub greatest: f64,
    /// Mean of the finite values.
    pub mean: f64,
    /// Values that are NaN or infinite.
    pub not_finite: usize,
}

/// One label of a label map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Label {
    /// Its number.
    pub label: u16,
    /// Its name in the header's table.
    pub name: Option<String>,
    /// Its voxels.
    pub voxels: usize,
    /// Its volume.
    pub volume_ml: f64,
}

/// What a file's values are.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Content {
    /// A scalar image.
    Image {
        /// Its values.
        values: Range,
        /// What of it was measured; `None` where no value is as low as air, so that it is no CT.
        view: Option<ViewReport>,
    },
    /// A label map: integers, few of them, and 0.
    Labels {
        /// The labels that occur, background left out.
        labels: Vec<Label>,
        /// Names in the header's table whose label does not occur.
        absent: usize,
    },
    /// A displacement field.
    Field {
        /// How the file stores its vectors.
        convention: String,
        /// Components along left, posterior, superior, mm, as read.
        components: [Range; 3],
        /// Lengths of the vectors, mm.
        length: Range,
    },
    /// Several values per voxel that are no displacement field.
    Other {
        /// Why it is no displacement field.
        reason: String,
        /// All values.
        values: Range,
    },
}

/// Looks at one file.
///
/// # Errors
/// As for reading an image, except that values which are not finite are counted, not refused.
pub fn inspect(path: impl AsRef<Path>) -> Result<Inspection> {
    let path = path.as_ref();
    let loaded = load_scan(path, |raster| Ok((raster.grid.clone(), content(path, raster)?)))?;
    let (grid, content) = loaded.value;
    let orientation = orientation(&grid);
    let (path, sha256, header, warnings) = (loaded.path, loaded.sha256, loaded.header, loaded.warnings);
    Ok(Inspection { path, sha256, header, grid, orientation, content, warnings })
}

/// Which of several files lie on the grid of the first, in words; empty for fewer than two.
pub fn compare_grids(files: &[Inspection]) -> Vec<String> {
    let Some((first, others)) = files.split_first() else { return Vec::new() };
    let name = |f: &Inspection| f.path.display().to_string();
    let compare = |other: &Inspection| {
        let (a, b) = (&first.grid, &other.grid);
        if a.matches(b, SAME_GRID_MM) {
            return format!("{} lies on the grid of {}", name(other), name(first));
        }
        let why = if a.size() == b.size() {
            let apart = a.corners().iter().zip(b.corners()).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
            format!("same size, corners up to {apart:.3} mm apart")
        } else {
            let [m, n] = [a, b].map(|g| g.size().map(|s| s.to_string()).join(" x "));
            format!("{n} voxels, not {m}; middles {:.1} mm apart", (a.middle() - b.middle()).norm())
        };
        let labels = [first, other].iter().any(|f| matches!(f.content, Content::Labels { .. }));
        let may = if labels { "" } else { "; a fraction or a dose need not be" };
        format!("{} is NOT on the grid of {}: {why}{may}", name(other), name(first))
    };
    others.iter().map(compare).collect()
}

/// Where a grid's axes point.
pub fn orientation(grid: &Grid) -> Orientation {
    let direction = grid.direction();
    let mut code = [' '; 3];
    let mut oblique: f64 = 0.0;
    let mut free = [true; 3];
    // The clearest axis chooses first, so that no body direction is named twice.
    let mut axes: Vec<(usize, usize)> = (0..3).flat_map(|axis| (0..3).map(move |body| (axis, body))).collect();
    axes.sort_by(|a, b| direction[(b.1, b.0)].abs().total_cmp(&direction[(a.1, a.0)].abs()));
    for (axis, body) in axes {
        if code[axis] == ' ' && free[body] {
            let along = direction[(body, axis)];
            code[axis] = [['L', 'R'], ['P', 'A'], ['S', 'I']][body][usize::from(along < 0.0)];
            free[body] = false;
            oblique = oblique.max(along.abs().min(1.0).acos().to_degrees());
        }
    }
    Orientation { code: code.iter().collect(), right_handed: direction.determinant() > 0.0, oblique_deg: oblique }
}

fn content(path: &Path, raster: &Raster<'_>) -> Result<Content> {
    if raster.components == 1 {
        return scalar_content(path, raster);
    }
    let kind = match &raster.vectors {
        Ok(kind) => *kind,
        Err(reason) => {
            let values = range(raster.voxels(path)?.decode(|v| v).into_iter());
            return Ok(Content::Other { reason: reason.clone(), values });
        }
    };
    let (field, _) = raster.displacements(path)?;
    let components = std::array::from_fn(|a| range(field.data().iter().map(|v| f64::from(v[a]))));
    let length = range(field.data().iter().map(|v| Vector3::from(v.map(f64::from)).norm()));
    Ok(Content::Field { convention: convention(kind, raster), components, length })
}

fn convention(kind: VectorKind, raster: &Raster<'_>) -> String {
    let frame = match kind {
        VectorKind::Lps => "displacements in LPS mm (as ITK, ANTs, elastix, plastimatch and Slicer read them)",
        VectorKind::Ras => "displacements in RAS mm (turned to LPS on reading)",
        VectorKind::RasPosition => {
            "positions in RAS mm (NiftyReg deformation field; turned to LPS displacements on reading)"
        }
    };
    let stored = match raster.layout {
        Layout::Planar => "component after component",
        Layout::Interleaved => "vector after vector",
    };
    format!("{frame}, stored {stored}")
}

/// An image without any value below this shows no air: it is no CT, and its lowest value no padding.
const AIR_HU: f64 = -500.0;

fn scalar_content(path: &Path, raster: &Raster<'_>) -> Result<Content> {
    let names = header_names(path, raster)?;
    let voxels = raster.voxels(path)?;
    let declared = names.is_some() || raster.notes.intent_code == Some(1002);
    let values = voxels.decode(|v| v);
    if (declared || raster.element.is_integer()) && values.iter().all(|v| is_label(*v)) {
        let mut counts: BTreeMap<u16, usize> = BTreeMap::new();
        let mut table = vec![0usize; usize::from(u16::MAX) + 1];
        values.iter().for_each(|v| table[usize::from(*v as u16)] += 1);
        counts.extend((0..=u16::MAX).zip(table).filter(|(_, n)| *n > 0));
        if declared || counts.len() <= MOST_LABELS && counts.contains_key(&0) {
            let names = names.unwrap_or_default();
            let absent = names.keys().filter(|l| !counts.contains_key(l)).count();
            counts.remove(&0);
            let ml = raster.grid.voxel_volume() / 1000.0;
            let label = |(label, voxels): (u16, usize)| Label {
                label,
                name: names.get(&label).cloned(),
                voxels,
                volume_ml: voxels as f64 * ml,
            };
            return Ok(Content::Labels { labels: counts.into_iter().map(label).collect(), absent });
        }
    }
    let image = Volume::new(raster.grid.clone(), values.iter().map(|v| *v as f32).collect())?;
    let values = range(values.into_iter());
    let view = (values.least < AIR_HU).then(|| View::of(&image).report);
    Ok(Content::Image { values, view })
}

fn range(values: impl Iterator<Item = f64>) -> Range {
    let (mut least, mut greatest, mut sum, mut finite, mut not_finite) =
        (f64::INFINITY, f64::NEG_INFINITY, 0.0, 0usize, 0);
    for v in values {
        if v.is_finite() {
            least = least.min(v);
            greatest = greatest.max(v);
            sum += v;
            finite += 1;
        } else {
            not_finite += 1;
        }
    }
    if finite == 0 {
        return Range { least: 0.0, greatest: 0.0, mean: 0.0, not_finite };
    }
    Range { least, greatest, mean: sum / finite as f64, not_finite }
}

/// In words, where the geometry came from.
fn geometry_source(header: &HeaderNotes) -> String {
    let codes = || {
        format!(
            "sform code {}, qform code {}",
            header.sform_code.unwrap_or_default(),
            header.qform_code.unwrap_or_default()
        )
    };
    match (header.geometry, header.disagreement_mm) {
        (GeometrySource::Header, _) => "header".into(),
        (GeometrySource::Sform, Some(d)) => format!("sform ({}; they agree within {d:.4} mm)", codes()),
        (GeometrySource::Sform, None) => format!("sform ({})", codes()),
        (GeometrySource::Qform, _) => format!("qform ({})", codes()),
        (GeometrySource::Pixdim, _) => format!("voxel sizes only ({})", codes()),
    }
}
