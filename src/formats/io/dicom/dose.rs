//! RT Dose (PS3.3 C.8.8.3) as a volume in Gy.

use super::super::Loaded;
use super::super::bytes::{read_bytes, sha256};
use super::super::series_path::root_of;
use super::beams::{Dose, summed};
use super::beside::beside;
use super::ct::notes;
use super::elements::{Item, items, number, numbers, some, text, texts, whole};
use super::find::{Object, series};
use super::frames::axes;
use super::open;
use super::pixels::Pixels;
use super::place::{objects, of_kind};
use super::series::Slice;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::warning::Warning;
use dicom_dictionary_std::tags;
use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Distances between planes may differ by this share, or by rounding, mm.
const UNEVEN: f64 = 0.01;
const ROUNDED_MM: f64 = 0.02;

/// Reads one RT Dose object, or the one in a folder.
///
/// # Errors
/// [`Error::Read`] when it is missing or damaged; [`Error::Input`] when it is no RT Dose, when it
/// is relative, when its planes are not evenly spaced, and when a folder holds several.
pub fn read_dose(path: impl AsRef<Path>) -> Result<Loaded<Dose>> {
    read_doses(&[path])
}

/// Reads RT Dose objects; those of single beams of one plan are summed.
///
/// # Errors
/// As [`read_dose`]; [`Error::Input`] when several are not the beams of one plan on one grid.
pub fn read_doses<P: AsRef<Path>>(paths: &[P]) -> Result<Loaded<Dose>> {
    let (mut all, mut warnings) = (Vec::new(), Vec::new());
    for path in paths {
        let found = objects(&root_of(path.as_ref()))?;
        let own: Vec<&Object> = found.objects.iter().filter(|o| o.series.modality == "RTDOSE").collect();
        warnings.extend(beside(path.as_ref(), &found, &own, &|damaged| of_kind(damaged, "RTDOSE"))?);
        let own = found.objects.into_iter().filter(|o| o.series.modality == "RTDOSE").collect::<Vec<_>>();
        if own.is_empty() {
            let what = path.as_ref().display().to_string();
            return Err(Error::refused(findings::DICOM_NO_DOSE, what, "it holds no RT Dose", "give an RTDOSE file"));
        }
        all.extend(own);
    }
    let path = paths.first().map_or(PathBuf::new(), |p| p.as_ref().to_owned());
    read(&path, &all, warnings)
}

/// Reads the doses of objects, summed; `warnings` are those of the files beside them.
pub(super) fn read(path: &Path, objects: &[Object], warnings: Vec<Warning>) -> Result<Loaded<Dose>> {
    let read: Vec<Loaded<Dose>> = objects.par_iter().map(|o| one(&o.path)).collect::<Result<_>>()?;
    let mut whole = summed(path, read)?;
    whole.warnings.splice(0..0, warnings);
    Ok(whole)
}

/// Reads one object.
fn one(path: &Path) -> Result<Loaded<Dose>> {
    let bytes = read_bytes(path)?;
    let object = open::whole(path, &bytes)?;
    let set: &Item = &object;
    let what = path.display().to_string();
    let refuse = |code, problem: String, remedy: &str| Err(Error::refused(code, what.clone(), problem, remedy));
    let units = text(set, tags::DOSE_UNITS);
    if units != "GY" {
        let problem = format!("its Dose Units are {units:?}, not GY");
        let remedy =
            "export the absolute dose; per cent of a prescription cannot be mapped or summed without knowing it";
        return refuse(findings::DOSE_UNITS, problem, remedy);
    }
    let kind = text(set, tags::DOSE_TYPE);
    if kind == "ERROR" {
        return refuse(
            findings::DOSE_UNITS,
            "it is the error of a dose (Dose Type ERROR), no dose".into(),
            "give the dose itself",
        );
    }
    let Some(scaling) = number(set, tags::DOSE_GRID_SCALING).filter(|s| *s > 0.0) else {
        return refuse(
            findings::DICOM_INCOMPLETE,
            "it has no usable Dose Grid Scaling".into(),
            "export the dose again",
        );
    };
    let planes = Planes::of(path, set)?;
    let pixels = Pixels::of(path, &object)?;
    let slice = planes.grid.strides()[2];
    let mut data = vec![0.0f32; planes.grid.len()];
    data.par_chunks_mut(slice).enumerate().for_each(|(k, out)| {
        pixels.each(planes.frame(k), |n, stored| {
            if let Some(out) = out.get_mut(n) {
                *out = (stored as f64 * scaling) as f32;
            }
        });
    });
    let mut series = series(set);
    let uid = text(set, tags::SOP_INSTANCE_UID);
    series.slices = (0..planes.grid.size()[2])
        .map(|k| Slice {
            uid: uid.clone(),
            frame: Some(planes.frame(k) as u32 + 1),
            position: planes.grid.centre([0, 0, k]),
        })
        .collect();
    let plans = items(set, tags::REFERENCED_RT_PLAN_SEQUENCE);
    let groups = plans.iter().flat_map(|p| items(p, tags::REFERENCED_FRACTION_GROUP_SEQUENCE));
    let beams = groups.flat_map(|g| {
        let group = whole(g, tags::REFERENCED_FRACTION_GROUP_NUMBER).unwrap_or_default();
        let numbers = items(g, tags::REFERENCED_BEAM_SEQUENCE).iter();
        numbers.filter_map(move |b| whole(b, tags::REFERENCED_BEAM_NUMBER).map(|n| [group, n]))
    });
    let computed = [
        tags::MANUFACTURER,
        tags::MANUFACTURER_MODEL_NAME,
        tags::SOFTWARE_VERSIONS,
        tags::TISSUE_HETEROGENEITY_CORRECTION,
    ];
    let dose = Dose {
        uid,
        summation: text(set, tags::DOSE_SUMMATION_TYPE),
        kind,
        transform: text(set, tags::SPATIAL_TRANSFORM_OF_DOSE),
        plans: plans.iter().map(|p| text(p, tags::REFERENCED_SOP_INSTANCE_UID)).filter(|uid| !uid.is_empty()).collect(),
        beams: beams.collect(),
        computed: computed.map(|tag| texts(set, tag).join("/")).join(" "),
        volume: Volume::new(planes.grid.clone(), data)?,
        series,
        of_beams: false,
    };
    let notes = notes("DICOM RT Dose", &object, &planes.grid, Some([scaling, 0.0]), &dose.series.description);
    let warnings = odd(&what, &dose);
    Ok(Loaded { value: dose, path: path.into(), sha256: sha256(&bytes), header: notes, warnings })
}

/// What is worth knowing of a dose.
fn odd(what: &str, dose: &Dose) -> Vec<Warning> {
    let mut all = Vec::new();
    if !dose.is_of_whole_plan() {
        let message = format!("{what}: it is no dose of a whole plan (Dose Summation Type {:?})", dose.summation);
        all.push(Warning::new(findings::DOSE_PART, message));
    }
    if dose.kind != "PHYSICAL" {
        let message = format!("{what}: it is no physical dose (Dose Type {:?})", dose.kind);
        all.push(Warning::new(findings::DOSE_KIND, message));
    }
    all
}

/// The planes of a dose (PS3.3 C.8.8.3.2).
struct Planes {
    grid: Grid,
    /// Whether the first frame is the last plane.
    down: bool,
}

impl Planes {
    fn frame(&self, plane: usize) -> usize {
        if self.down { self.grid.size()[2] - 1 - plane } else { plane }
    }

    fn of(path: &Path, set: &Item) -> Result<Self> {
        let what = path.display().to_string();
        let refuse = |problem: String| {
            Error::refused(
                findings::DOSE_PLANES,
                what.clone(),
                problem,
                "export the dose again on an even grid, in one file",
            )
        };
        let missing = |name: &str| refuse(format!("it has no usable {name}"));
        let Some(position) = some::<3>(set, tags::IMAGE_POSITION_PATIENT) else {
            return Err(missing("Image Position (Patient)"));
        };
        let Some(orientation) = some::<6>(set, tags::IMAGE_ORIENTATION_PATIENT) else {
            return Err(missing("Image Orientation (Patient)"));
        };
        let [row, column] = axes(path, orientation)?;
        let normal = row.cross(&column);
        let spacing = some::<2>(set, tags::PIXEL_SPACING).filter(|s| s.iter().all(|v| *v > 0.0));
        let Some([rows_apart, columns_apart]) = spacing else { return Err(missing("Pixel Spacing")) };
        let count = |tag| whole(set, tag).and_then(|n| usize::try_from(n).ok()).filter(|n| *n > 0);
        let (Some(columns), Some(rows)) = (count(tags::COLUMNS), count(tags::ROWS)) else {
            return Err(missing("Rows and Columns"));
        };
        let frames = count(tags::NUMBER_OF_FRAMES).unwrap_or(1);
        if frames < 2 {
            return Err(refuse("it has one plane, which makes no volume".into()));
        }
        let offsets = match numbers(set, tags::GRID_FRAME_OFFSET_VECTOR) {
            Some(offsets) if offsets.len() == frames => offsets,
            Some(offsets) => {
                return Err(refuse(format!("it has {frames} frames and {} offsets of them", offsets.len())));
            }
            None => return Err(missing("Grid Frame Offset Vector")),
        };
        let along = along(&offsets, position, &normal, [row.x, column.y]).map_err(refuse)?;
        let step = along[frames - 1] / (frames - 1) as f64;
        let uneven = (UNEVEN * step.abs()).max(ROUNDED_MM);
        if let Some(n) = (1..frames).find(|&n| (along[n] - along[n - 1] - step).abs() > uneven) {
            let problem = format!(
                "its planes are not evenly spaced: {:.3} mm between frames {n} and {}, {step:.3} mm on average",
                along[n] - along[n - 1],
                n + 1
            );
            return Err(refuse(problem));
        }
        let (down, first) = (step < 0.0, Point3::from(Vector3::from(position)));
        let origin = if down { first + normal * along[frames - 1] } else { first };
        let direction = Matrix3::from_columns(&[row, column, normal]);
        let size = [columns, rows, frames];
        Ok(Self { grid: Grid::new(size, [columns_apart, rows_apart, step.abs()], origin, direction)?, down })
    }
}

/// Offsets of the frames along the normal from the first: relative ones as they are, absolute ones,
/// which are z of axial planes, less the first.
fn along(offsets: &[f64], position: [f64; 3], normal: &Vector3<f64>, axial: [f64; 2]) -> Result<Vec<f64>, String> {
    let first = offsets.first().copied().unwrap_or_default();
    if first.abs() < 1e-6 {
        return Ok(offsets.to_vec());
    }
    let upright = axial.iter().all(|c| (c.abs() - 1.0).abs() < 1e-4);
    if !upright || (first - position[2]).abs() > ROUNDED_MM {
        return Err(format!(
            "its Grid Frame Offset Vector begins with {first}, which is neither 0 nor the z of axial planes ({})",
            position[2]
        ));
    }
    Ok(offsets.iter().map(|z| (z - first) * normal.z.signum()).collect())
}

/// What a dose is, in words, and its grid, by its header.
pub(super) fn describe(object: &Object) -> Result<(String, Grid)> {
    let set: &Item = &object.header;
    let grid = Planes::of(&object.path, set)?.grid;
    let all = [tags::DOSE_SUMMATION_TYPE, tags::DOSE_TYPE, tags::DOSE_UNITS].map(|tag| text(set, tag));
    Ok((all.join(" "), grid))
}
