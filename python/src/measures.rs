//! What fields, doses and labels are judged by.

use crate::arrays::{self, Given, Raster, raster};
use crate::case::{self, Settings};
use crate::errors::{Raised, warn};
use crate::runs::{Runs, Work};
use crate::warp::Target;
use aventail::config::InputRole;
use aventail::dose::{self, DensityTable, DoseCounts, EnergyMassOptions};
use aventail::evaluate::{Direction, FieldPair, Subject, assess};
use aventail::geometry::Grid;
use aventail::io::dicom::Role;
use aventail::pipeline::{self, DoseMethod};
use aventail::plausibility::{CheckOptions, levels_by_landmarks, sides_and_levels};
use aventail::provenance::Provenance;
use aventail::session::{
    self,
    fields::{self, Given as Field, Known},
};
use aventail::volume::{LabelMap, Volume};
use aventail::{Error, Result, io, skeleton as bone_tree};
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// Something with a grid in a frame, by the name that messages have for it.
type Lying<'a> = (&'static str, &'static str, Option<&'a Grid>, Option<&'a Path>);

/// Both directions of a field; the one that is missing is made on the grid that is known of its frame. What is doubtful about a
/// direction is noted.
fn pair(both: [Field; 2], all: &[Lying<'_>], provenance: &mut Provenance) -> Result<FieldPair> {
    let grid = |frame: &str| all.iter().find_map(|(own, _, grid, _)| grid.filter(|_| *own == frame));
    let mut known = Vec::new();
    for &(frame, name, grid, path) in all {
        let place = path.map(|path| Role::Image.at(path));
        let name = path.map_or(name.to_owned(), |path| path.display().to_string());
        known.extend(grid.map(|grid| Known { frame, name, place, grid }));
    }
    fields::pair(both, None, [grid("planning"), grid("fraction")], &known, provenance)
}

/// Both directions of a field, planning to fraction first.
#[derive(FromPyObject)]
pub(crate) struct Fields<'py>(Option<Bound<'py, PyAny>>, Option<Bound<'py, PyAny>>);

impl Fields<'_> {
    fn given(&self) -> PyResult<[Field; 2]> {
        let field = |any: &Option<Bound<'_, PyAny>>| any.as_ref().map(arrays::field).transpose();
        Ok([field(&self.0)?, field(&self.1)?])
    }
}

/// Inputs of an evaluation.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Measured<'py> {
    planning: Option<Bound<'py, PyAny>>,
    fraction: Option<Bound<'py, PyAny>>,
    mask: Option<Bound<'py, PyAny>>,
    bones: Option<Bound<'py, PyAny>>,
    labels: Option<Bound<'py, PyAny>>,
    structures: Option<Bound<'py, PyAny>>,
    structures_fraction: Option<Bound<'py, PyAny>>,
    structure_names: Option<Bound<'py, PyAny>>,
    landmarks: Option<Bound<'py, PyAny>>,
}

/// Everything that can be measured of a field, as JSON.
#[pyfunction]
#[pyo3(signature = (fields, measured, settings, work))]
pub(crate) fn evaluate(
    py: Python<'_>,
    fields: Fields<'_>,
    measured: Measured<'_>,
    settings: Settings,
    work: Work<'_>,
) -> PyResult<String> {
    let limits = settings.config().raised(py)?.verdict;
    let [push, pull] = fields.given()?;
    let written = push.as_ref().or(pull.as_ref()).and_then(|field| field.path()).map(Path::to_owned);
    let image = |any: &Option<Bound<'_, PyAny>>| any.as_ref().map(arrays::image).transpose();
    let labels = |any: &Option<Bound<'_, PyAny>>| any.as_ref().map(arrays::labels).transpose();
    let names = |any: &Option<Bound<'_, PyAny>>| any.as_ref().map(arrays::names).transpose();
    let (planning, fraction, mask) = (image(&measured.planning)?, image(&measured.fraction)?, image(&measured.mask)?);
    let (bones, bone_names) = (labels(&measured.bones)?, names(&measured.labels)?);
    let structures = [labels(&measured.structures)?, labels(&measured.structures_fraction)?];
    let structure_names = [names(&measured.structure_names)?, names(&measured.structure_names)?];
    let landmarks = measured.landmarks.as_ref().map(case::landmarks).transpose()?;
    let scans = [&planning, &fraction].map(|scan| scan.as_ref().and_then(Given::path).map(Path::to_owned));
    let (json, warnings) = Runs::new(work.threads()).raised(py)?.run(py, work.progress(), move |runtime| {
        let mut provenance = Provenance::default();
        let planning = planning.map(|p| session::image(InputRole::Planning, p, &mut provenance)).transpose()?;
        let fraction = fraction.map(|p| session::image(InputRole::Fraction, p, &mut provenance)).transpose()?;
        let mask = mask
            .map(|p| session::image(InputRole::Mask, p, &mut provenance))
            .transpose()?
            .map(|m| m.map(|v| *v != 0.0));
        let bones = bones.map(|b| labelled(InputRole::Bones, "bones", b, bone_names)).transpose()?;
        let [own, other] = structures;
        let [own_names, other_names] = structure_names;
        let own = own.map(|s| labelled(InputRole::LabelsPlanning, "structures", s, own_names)).transpose()?;
        let other =
            other.map(|s| labelled(InputRole::LabelsFraction, "structures_fraction", s, other_names)).transpose()?;
        let on = |map: &Option<LabelMap>| map.as_ref().map(|m| m.volume.grid().clone());
        let grids = [planning.as_ref().map(|p| p.grid().clone()), on(&bones), on(&own)];
        let there = [fraction.as_ref().map(|p| p.grid().clone()), on(&other)];
        let all = [
            ("planning", "planning", grids[0].as_ref(), scans[0].as_deref()),
            ("planning", "bones", grids[1].as_ref(), None),
            ("planning", "structures", grids[2].as_ref(), None),
            ("fraction", "fraction", there[0].as_ref(), scans[1].as_deref()),
            ("fraction", "structures_fraction", there[1].as_ref(), None),
        ];
        let pair = runtime.stage("read and invert the field", || pair([push, pull], &all, &mut provenance))?;
        let rigid = bones.as_ref().map(rigid).unwrap_or_default();
        let sliding = bone_tree::SlidingOptions::default().pairs(&rigid);
        let spine = bone_tree::labels_of_spine(&rigid);
        let landmarks =
            landmarks.map(|marks| session::landmarks(marks, &mut provenance)).transpose()?.unwrap_or_default();
        let subject = Subject {
            pair: &pair,
            planning: planning.as_ref(),
            fraction: fraction.as_ref(),
            mask: mask.as_ref(),
            bones: bones.as_ref(),
            rigid: &rigid,
            spine: &spine,
            sliding: &sliding,
            structures: own.as_ref(),
            structures_fraction: other.as_ref(),
            landmarks: &landmarks,
            triangle: None,
        };
        let (mut assessment, _) = assess(&subject, &limits, runtime)?;
        let doubts = |field: &PathBuf| fields::doubts_of_its_run(field, &provenance);
        assessment.verdicts.extend(written.as_ref().map(doubts).unwrap_or_default());
        Ok((io::json(&assessment)?, provenance.warnings))
    })?;
    warn(py, &warnings)?;
    Ok(json)
}

/// Labels that move rigidly: the skeleton's bones; all labels when none has a known bone's name.
fn rigid(bones: &LabelMap) -> Vec<(u16, String)> {
    match bone_tree::build(bones) {
        Ok(built) => built.skeleton.labels_and_names(),
        Err(_) => bones.names.iter().map(|(label, name)| (*label, name.clone())).collect(),
    }
}

/// A label map of structures.
fn labelled(
    role: InputRole,
    argument: &str,
    labels: Given<Volume<u16>>,
    names: Option<Given<session::Names>>,
) -> Result<LabelMap> {
    session::structures(role, argument, labels, names, &mut Provenance::default())
}

/// A dose that is one in Gy.
fn gray(what: &str, given: Given<Volume<f32>>) -> Result<Volume<f32>> {
    let mut dose = match given {
        Given::File(path) => io::read_dose(path)?.value,
        Given::Memory(volume) => volume,
    };
    dose::judge(what, &mut dose)?;
    Ok(dose)
}

/// Where and how a dose is carried.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct DoseMapping<'py> {
    to_fraction: bool,
    /// The grid of the result; without it that of the field in its frame.
    grid: Option<Target>,
    /// Parts of a voxel's edge, where energy and mass are carried.
    parts: Option<usize>,
    /// The CT in the frame that the dose comes from.
    ct: Option<Bound<'py, PyAny>>,
}

/// A dose in the other frame, and what is to be said about it as JSON.
#[pyfunction]
#[pyo3(signature = (dose, fields, mapping, work))]
pub(crate) fn map_dose<'py>(
    py: Python<'py>,
    dose: &Bound<'py, PyAny>,
    fields: Fields<'py>,
    mapping: DoseMapping<'py>,
    work: Work<'py>,
) -> PyResult<(Raster<'py, f32>, String)> {
    let DoseMapping { to_fraction, grid, parts, ct } = mapping;
    let [push, pull] = fields.given()?;
    let (given, ct) = (arrays::image(dose)?, ct.as_ref().map(arrays::image).transpose()?);
    let target = grid.map(Target::grid).transpose().raised(py)?;
    let method = match parts {
        None => DoseMethod::Interpolate,
        Some(parts) => DoseMethod::EnergyMass(EnergyMassOptions { parts, density: DensityTable::default() }),
    };
    let mapped = Runs::new(work.threads()).raised(py)?.run(py, work.progress(), move |runtime| {
        let dose = gray("dose", given)?;
        let ct = ct.map(|ct| session::image(InputRole::Ct, ct, &mut Provenance::default())).transpose()?;
        let frames = if to_fraction { ["planning", "fraction"] } else { ["fraction", "planning"] };
        let all = [(frames[0], "dose", Some(dose.grid()), None), (frames[1], "grid", target.as_ref(), None)];
        let mut provenance = Provenance::default();
        let pair = runtime.stage("read and invert the field", || pair([push, pull], &all, &mut provenance))?;
        let (direction, of_field) = if to_fraction {
            (Direction::PlanningToFraction, pair.pull.displacement.grid())
        } else {
            (Direction::FractionToPlanning, pair.push.displacement.grid())
        };
        let to = target.as_ref().unwrap_or(of_field);
        let map = || pipeline::map_dose(&dose, &pair, direction, to, &method, ct.as_ref());
        let (mapped, report) = runtime.stage("map dose", map)?;
        dose::judge_result("the mapped dose", &mapped)?;
        Ok((mapped, io::json(&report)?, provenance.warnings))
    })?;
    warn(py, &mapped.2)?;
    Ok((raster(py, &mapped.0.grid().clone(), mapped.0.into_data())?, mapped.1))
}

/// The sum of doses on one grid, each by its share of a plan or by the number of its fractions.
#[pyfunction]
#[pyo3(signature = (doses, weights, fractions))]
pub(crate) fn accumulate<'py>(
    py: Python<'py>,
    doses: Vec<Bound<'py, PyAny>>,
    weights: Vec<f64>,
    fractions: Vec<f64>,
) -> PyResult<Raster<'py, f32>> {
    let given: Vec<_> = doses.iter().map(arrays::image).collect::<PyResult<_>>()?;
    let sum = || {
        let counts = DoseCounts::new(given.len(), &weights, &fractions)?;
        let mut doses = Vec::new();
        let mut warnings = Vec::new();
        for (n, (one, times)) in given.into_iter().zip(counts.factors()).enumerate() {
            let name = format!("dose {}", n + 1);
            let dose = gray(&name, one)?;
            warnings.extend(counts.several(n).and_then(|times| dose::question(&name, dose.extremes()[1], times)));
            doses.push((*times, dose));
        }
        let terms: Vec<_> = doses.iter().map(|(times, dose)| (*times, dose)).collect();
        let total = dose::accumulate(&terms)?;
        warnings.extend(dose::judge_result("the sum", &total)?);
        Ok::<_, Error>((total, warnings))
    };
    let (total, warnings) = py.detach(sum).raised(py)?;
    warn(py, &warnings)?;
    raster(py, &total.grid().clone(), total.into_data())
}

/// Structures: labels with names, or contours.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Structures<'py> {
    labels: Option<Bound<'py, PyAny>>,
    names: Option<Bound<'py, PyAny>>,
    /// The text of a contour JSON.
    contours: Option<String>,
    contour_file: Option<PathBuf>,
}

/// Dose-volume histograms of structures as JSON.
#[pyfunction]
#[pyo3(signature = (dose, structures, at, bin))]
pub(crate) fn dvh(
    py: Python<'_>,
    dose: &Bound<'_, PyAny>,
    structures: Structures<'_>,
    at: Vec<f64>,
    bin: f64,
) -> PyResult<String> {
    let Structures { labels, names, contours, contour_file } = structures;
    let (given, labels) = (arrays::image(dose)?, labels.as_ref().map(arrays::labels).transpose()?);
    let names = names.as_ref().map(arrays::names).transpose()?;
    let count = || {
        if !(bin.is_finite() && bin >= 1e-3) {
            return Err(Error::usage(format!("a bin of {bin} Gy is too small"), "give at least 0.001 Gy"));
        }
        let dose = gray("dose", given)?;
        let all = match labels {
            Some(labels) => dose::dvh(&dose, &labelled(InputRole::Structures, "structures", labels, names)?, &at, bin),
            None => {
                let mut all = arrays::contours(contours.as_deref(), contour_file.as_deref())?;
                all.tidy();
                dose::dvh_of_contours(&dose, &all, &at, bin)
            }
        };
        io::json(&all)
    };
    py.detach(count).raised(py)
}

/// Difference of two doses, the distance to dose difference, and figures as JSON.
#[pyfunction]
#[pyo3(signature = (dose, reference, tolerance, limit))]
pub(crate) fn compare_doses<'py>(
    py: Python<'py>,
    dose: &Bound<'py, PyAny>,
    reference: &Bound<'py, PyAny>,
    tolerance: Option<f64>,
    limit: f64,
) -> PyResult<(Raster<'py, f32>, Raster<'py, f32>, String)> {
    let (given, other) = (arrays::image(dose)?, arrays::image(reference)?);
    let compare = || {
        let (dose, reference) = (gray("dose", given)?, gray("reference", other)?);
        let tolerance = tolerance.unwrap_or_else(|| 0.03 * f64::from(reference.extremes()[1].max(0.0)));
        if !(tolerance.is_finite() && tolerance > 0.0 && limit > 0.0 && limit <= 100.0) {
            return Err(Error::usage(
                format!("tolerance {tolerance} Gy, limit {limit} mm: out of range"),
                "give a tolerance above 0 Gy and a limit above 0 and up to 100 mm",
            ));
        }
        let (map, figures) = dose::difference(&dose, &reference)?;
        Ok((map, dose::distance_to_difference(&reference, tolerance, limit), io::json(&figures)?))
    };
    let (map, distance, figures) = py.detach(compare).raised(py)?;
    let own = |volume: Volume<f32>| raster(py, &volume.grid().clone(), volume.into_data());
    Ok((own(map)?, own(distance)?, figures))
}

/// The joint tree of bone labels as JSON and as text.
#[pyfunction]
#[pyo3(signature = (bones, names))]
pub(crate) fn skeleton(
    py: Python<'_>,
    bones: &Bound<'_, PyAny>,
    names: Option<&Bound<'_, PyAny>>,
) -> PyResult<(String, String)> {
    let (given, names) = (arrays::labels(bones)?, names.map(arrays::names).transpose()?);
    let show = || {
        let map = session::bones(InputRole::Bones, "bones", given, names, &mut Provenance::default())?;
        let built = bone_tree::build(&map)?;
        let mut warnings = built.warnings;
        warnings.extend(CheckOptions { refuse: false }.told(sides_and_levels(&map))?);
        warnings.extend(levels_by_landmarks(&map));
        let shown = serde_json::json!({
            "bones": built.skeleton.bones, "voxels": built.voxels, "ignored": built.ignored, "warnings": warnings,
        });
        Ok::<_, Error>((io::json(&shown)?, bone_tree::tree(&built.skeleton, &built.voxels)))
    };
    py.detach(show).raised(py)
}
