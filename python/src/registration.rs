//! Registrations and poses, and what they found.

use crate::arrays::{self, Given, LabelRaster, Raster, field_raster, label_raster, raster, rows};
use crate::case::{COMMAND, FractionInputs, Inputs, More, Settings, transforms};
use crate::errors::Raised;
use crate::runs::Runs;
use crate::warp;
use aventail::fit::BoneLandmark;
use aventail::io::RunFolder;
use aventail::pipeline::{self, BoneMotion, InputFile, Planning, PlanningScan};
use aventail::report::{self, Clinic, Report, Run, Saving, planned};
use aventail::volume::{LabelMap, Volume};
use aventail::{Case, Config, Error, Outcome, Result, io, skeleton};
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};

/// A case and what was found of it.
struct Found {
    case: Case,
    config: Config,
    outcome: Outcome,
}

/// The outcome of a registration or a pose.
#[pyclass(frozen, module = "aventail._aventail")]
pub(crate) struct Registration {
    runs: Runs,
    found: Arc<RwLock<Found>>,
    /// What goes back to a planning system, and which of its fractions this is.
    clinic: Option<(Arc<Clinic>, usize)>,
}

/// A raster of labels, or none.
type MaybeLabels<'py> = Option<LabelRaster<'py>>;

impl Registration {
    fn new(
        runs: Runs,
        (case, config, mut outcome): (Case, Config, Outcome),
        clinic: Option<(Arc<Clinic>, usize)>,
    ) -> Self {
        // Of a region everything lies on the part's grids.
        let case = outcome.part.take().map_or(case, |part| *part);
        Self { runs, found: Arc::new(RwLock::new(Found { case, config, outcome })), clinic }
    }

    fn found(&self) -> RwLockReadGuard<'_, Found> {
        self.found.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// What `of` takes out of the results, without the interpreter's lock.
    fn taken<T: Send>(&self, py: Python<'_>, of: impl FnOnce(&Found) -> T + Send) -> T {
        py.detach(|| of(&self.found()))
    }
}

#[pymethods]
impl Registration {
    /// The report as JSON.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        let threads = self.runs.runtime().threads();
        self.taken(py, |found| {
            let settings = found.config.value()?;
            let limits = found.config.verdict.clone();
            let run = Run { command: COMMAND.into(), settings, threads, outputs: Vec::new(), limits };
            Report::new(&found.case, &found.outcome, &run).json()
        })
        .raised(py)
    }

    /// One of the two fields.
    fn field<'py>(&self, py: Python<'py>, to_fraction: bool) -> PyResult<Raster<'py, f32>> {
        let field = self.taken(py, |found| displacement(&found.outcome, to_fraction).clone());
        field_raster(py, field)
    }

    /// A scalar image by its name; `None` where this run has none.
    fn image<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Option<Raster<'py, f32>>> {
        let image = self.taken(py, |found| match name {
            "planning_on_fraction" => Some(found.outcome.planning_on_fraction.clone()),
            "jacobian" => Some(found.outcome.jacobian.to_volume()),
            "uncertainty" => found.outcome.uncertainty.as_ref().map(|(map, _)| map.clone()),
            _ => None,
        });
        image.map(|image| raster(py, &image.grid().clone(), image.into_data())).transpose()
    }

    /// A label map by its name; `None` where this run has none.
    fn labels<'py>(&self, py: Python<'py>, name: &str) -> PyResult<MaybeLabels<'py>> {
        let labels = self.taken(py, |found| match name {
            "bones_on_fraction" => Some(found.outcome.bones_on_fraction.clone()),
            "regions" => found.outcome.regions.clone(),
            _ => None,
        });
        labels.map(|labels| label_raster(py, labels)).transpose()
    }

    /// A mask by its name; `None` where this run has none.
    fn mask<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Option<Raster<'py, bool>>> {
        let mask = self.taken(py, |found| match name {
            "body" => Some(found.outcome.body.clone()),
            "computed" => Some(found.outcome.push.computed.clone()),
            "inside_planning" => Some(found.outcome.pull.inside.clone()),
            "skin_contact" => found.outcome.skin_contact.clone(),
            _ => None,
        });
        mask.map(|mask| raster(py, &mask.grid().clone(), mask.into_data())).transpose()
    }

    /// Each bone's name and transform.
    fn bones(&self) -> Vec<(String, [[f64; 4]; 4])> {
        self.found().outcome.bone_fits.iter().map(|bone| (bone.name.clone(), rows(&bone.transform))).collect()
    }

    /// Code and message of each warning.
    fn warnings(&self) -> Vec<(String, String)> {
        self.found().outcome.warnings.iter().map(|w| (w.code.clone(), w.message.clone())).collect()
    }

    /// Writes what the program writes.
    #[pyo3(signature = (folder, view, progress))]
    fn save(&self, py: Python<'_>, folder: PathBuf, view: bool, progress: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let (all, clinic) = (Arc::clone(&self.found), self.clinic.clone());
        self.runs.run(py, progress, move |runtime| {
            let mut found = all.write().unwrap_or_else(PoisonError::into_inner);
            let Found { case, config, outcome } = &mut *found;
            let (config, case) = (&*config, &*case);
            let inputs: Vec<_> = case.inputs().map(|input| input.path.clone()).collect();
            let inputs: Vec<_> = inputs.iter().map(PathBuf::as_path).collect();
            let mut planned = planned(config);
            planned.names.extend(clinic.iter().flat_map(|_| Clinic::planned()));
            let held = RunFolder::open(&folder, &planned, &inputs, COMMAND)?;
            let out = folder.as_path();
            let write = clinic.as_ref().map(|(clinic, n)| {
                move |outcome: &Outcome| runtime.stage("write DICOM", || clinic.write(*n, case, outcome, config, out))
            });
            let more = write.as_ref().map(|write| write as &report::More<'_>);
            let contours = clinic.as_ref().and_then(|(clinic, _)| clinic.contours());
            let saving = Saving { command: COMMAND, view, contours, more };
            report::save(case, outcome, config, runtime, held, out, saving).map(drop)
        })
    }

    /// Points of one frame in the other, and which of them the field covers.
    fn warp_points<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArrayDyn<'py, f64>,
        to_fraction: bool,
    ) -> PyResult<warp::Points<'py>> {
        warp::points(py, &points, |points| {
            self.taken(py, |found| warp::pushed(displacement(&found.outcome, to_fraction), points))
        })
    }

    /// A scalar image or dose in the other frame, on its image's grid.
    #[pyo3(signature = (image, to_fraction, cubic, outside, dose, grid))]
    #[expect(clippy::too_many_arguments, reason = "the keywords of Python's side")]
    fn warp_image<'py>(
        &self,
        py: Python<'py>,
        image: &Bound<'py, PyAny>,
        to_fraction: bool,
        cubic: bool,
        outside: f32,
        dose: bool,
        grid: Option<warp::Target>,
    ) -> PyResult<Raster<'py, f32>> {
        let given = crate::arrays::image(image)?;
        let target = grid.map(warp::Target::grid).transpose().raised(py)?;
        let warped = self.taken(py, |found| {
            let back = displacement(&found.outcome, !to_fraction);
            warp::image(back, given, target.as_ref(), warp::Kind { cubic, outside, dose })
        });
        let warped: Volume<f32> = warped.raised(py)?;
        raster(py, &warped.grid().clone(), warped.into_data())
    }

    /// A label map in the other frame, on its image's grid.
    #[pyo3(signature = (labels, names, to_fraction, grid))]
    fn warp_labels<'py>(
        &self,
        py: Python<'py>,
        labels: &Bound<'py, PyAny>,
        names: Option<crate::arrays::Names>,
        to_fraction: bool,
        grid: Option<warp::Target>,
    ) -> PyResult<LabelRaster<'py>> {
        let given = crate::arrays::labels(labels)?;
        let target = grid.map(warp::Target::grid).transpose().raised(py)?;
        let warped = self.taken(py, |found| {
            let map = match given {
                Given::Path(path) => io::read_label_map(path, None)?.value,
                Given::Value(volume) => LabelMap { volume, names: Default::default() },
            };
            let map = LabelMap { names: names.unwrap_or(map.names), volume: map.volume };
            warp::labels(displacement(&found.outcome, !to_fraction), &map, target.as_ref())
        });
        label_raster(py, warped.raised(py)?)
    }

    /// Contours, as the text of a contour JSON, on the slices of the other frame's image.
    #[pyo3(signature = (json, to_fraction, grid))]
    fn warp_contours(
        &self,
        py: Python<'_>,
        json: &str,
        to_fraction: bool,
        grid: Option<warp::Target>,
    ) -> PyResult<String> {
        let target = grid.map(warp::Target::grid).transpose().raised(py)?;
        self.taken(py, |found| {
            let both = [to_fraction, !to_fraction].map(|to| displacement(&found.outcome, to));
            let frame = if to_fraction { "fraction" } else { "planning" };
            warp::contours(both, crate::arrays::contours(Some(json), None)?, target.as_ref(), frame)
        })
        .raised(py)
    }
}

/// One of the two fields.
fn displacement(outcome: &Outcome, to_fraction: bool) -> &Volume<[f32; 3]> {
    if to_fraction { &outcome.push.displacement } else { &outcome.pull.displacement }
}

/// Leaves the patient out of what reports tell of files.
fn forget(inputs: &mut [InputFile], anonymous: bool) {
    inputs.iter_mut().filter(|_| anonymous).for_each(InputFile::forget_patient);
}

/// Registers a fraction.
#[pyfunction]
#[pyo3(signature = (planning, bones, fraction, more, settings, threads, progress))]
#[expect(clippy::too_many_arguments, reason = "the keywords of Python's side")]
pub(crate) fn register(
    py: Python<'_>,
    planning: &Bound<'_, PyAny>,
    bones: &Bound<'_, PyAny>,
    fraction: &Bound<'_, PyAny>,
    more: More<'_>,
    settings: Settings,
    threads: usize,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Registration> {
    let mut config = settings.config().raised(py)?;
    more.apply(&mut config).raised(py)?;
    let (named, back) = (config.chainmail.organs_named(), more.give_back());
    let mut inputs = Inputs::new(planning, bones, more)?;
    let fraction = arrays::image(fraction)?;
    let (runs, quiet) = (Runs::new(threads).raised(py)?, progress.is_none());
    let (found, clinic) = runs.run(py, progress, move |runtime| {
        let needed: Vec<&Path> = fraction.path().into_iter().chain(back.paths()).collect();
        inputs.make_bones(&needed, quiet, runtime)?;
        let clinic = back.read(inputs.planning(), &[fraction.path()], &config, runtime)?;
        let case = runtime.stage("read", || {
            let (mut planning, marks) = inputs.read(&named)?;
            planning.inputs.extend(clinic.iter().flat_map(|clinic| clinic.inputs()).cloned());
            let mut fraction = marks.with(fraction)?;
            forget(&mut planning.inputs, back.anonymous);
            forget(&mut fraction.inputs, back.anonymous);
            Ok::<_, Error>(Case { planning, fraction })
        })?;
        let outcome = pipeline::register(&case, &config, runtime)?;
        Ok(((case, config, outcome), clinic))
    })?;
    Ok(Registration::new(runs, found, clinic.map(|clinic| (clinic, 0))))
}

/// Registers several fractions of one patient, in their order; what depends on planning alone is done once.
#[pyfunction]
#[pyo3(signature = (planning, bones, fractions, more, settings, threads, progress))]
#[expect(clippy::too_many_arguments, reason = "the keywords of Python's side")]
pub(crate) fn register_several(
    py: Python<'_>,
    planning: &Bound<'_, PyAny>,
    bones: &Bound<'_, PyAny>,
    fractions: Vec<(Bound<'_, PyAny>, Option<Bound<'_, PyAny>>)>,
    more: More<'_>,
    settings: Settings,
    threads: usize,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<Registration>> {
    let mut config = settings.config().raised(py)?;
    more.apply(&mut config).raised(py)?;
    let (named, back) = (config.chainmail.organs_named(), more.give_back());
    let mut inputs = Inputs::new(planning, bones, more)?;
    let fractions = fractions.iter().map(|(image, landmarks)| FractionInputs::new(image, landmarks.as_ref()));
    let fractions = fractions.collect::<PyResult<Vec<_>>>()?;
    let (runs, quiet) = (Runs::new(threads).raised(py)?, progress.is_none());
    let (found, clinic) = runs.run(py, progress, move |runtime| {
        let needed: Vec<&Path> = fractions.iter().flat_map(FractionInputs::paths).chain(back.paths()).collect();
        inputs.make_bones(&needed, quiet, runtime)?;
        let scans: Vec<Option<&Path>> = fractions.iter().map(FractionInputs::path).collect();
        let clinic = back.read(inputs.planning(), &scans, &config, runtime)?;
        // What is known of one fraction alone is refused before.
        let (mut scan, _) = runtime.stage("read", || inputs.read(&named))?;
        scan.inputs.extend(clinic.iter().flat_map(|clinic| clinic.inputs()).cloned());
        forget(&mut scan.inputs, back.anonymous);
        let mut planning = None;
        let mut all = Vec::new();
        for (n, fraction) in fractions.into_iter().enumerate() {
            if n > 0 {
                runtime.restart();
            }
            let mut fraction = runtime.stage("read the fraction", || fraction.read())?;
            forget(&mut fraction.inputs, back.anonymous);
            pipeline::check_fraction(&fraction.ct, &config)?;
            let planning = match &planning {
                Some(planning) => planning,
                None => planning.insert(Planning::new(&scan, &config, runtime)?),
            };
            let case = Case { planning: scan.clone(), fraction };
            let outcome = pipeline::register_fraction(&case, planning, &config, runtime)?;
            all.push((case, config.clone(), outcome));
        }
        Ok((all, clinic))
    })?;
    let one = |(n, found)| Registration::new(runs.clone(), found, clinic.clone().map(|clinic| (clinic, n)));
    Ok(found.into_iter().enumerate().map(one).collect())
}

/// How bones are told to move.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Motion {
    /// A pose file's text.
    text: Option<String>,
    /// A pose file.
    file: Option<PathBuf>,
    /// Transforms by bone name.
    transforms: Option<Vec<(String, [[f64; 4]; 4])>>,
}

impl Motion {
    /// The motion of a patient, whose skeleton it fixes where it names joints; by landmarks on bones where it is none of its own.
    fn of(self, planning: &mut PlanningScan, bone_landmarks: Vec<BoneLandmark>) -> Result<BoneMotion> {
        if let Some(all) = self.transforms {
            return Ok(BoneMotion::Transforms(transforms(all)?));
        }
        if self.text.is_none() && self.file.is_none() {
            return Ok(BoneMotion::Landmarks(bone_landmarks));
        }
        let skeleton = match planning.skeleton.take() {
            Some(own) => own,
            None => skeleton::build(&planning.bones)?.skeleton,
        };
        let pose = match (self.text, self.file) {
            (Some(text), _) => io::pose::parse_pose(&text, "pose", &skeleton)?,
            (None, Some(file)) => io::pose::read_pose(file, &skeleton)?,
            (None, None) => return Err(Error::Internal("a pose was just there".into())),
        };
        planning.skeleton = Some(skeleton);
        Ok(BoneMotion::Pose(pose))
    }
}

/// Poses a patient.
#[pyfunction]
#[pyo3(signature = (planning, bones, motion, margin_mm, more, settings, threads, progress))]
#[expect(clippy::too_many_arguments, reason = "the keywords of Python's side")]
pub(crate) fn pose(
    py: Python<'_>,
    planning: &Bound<'_, PyAny>,
    bones: &Bound<'_, PyAny>,
    motion: Motion,
    margin_mm: f64,
    more: More<'_>,
    settings: Settings,
    threads: usize,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Registration> {
    let mut config = settings.config().raised(py)?;
    more.apply(&mut config).raised(py)?;
    let named = config.chainmail.organs_named();
    let mut inputs = Inputs::new(planning, bones, more)?;
    let (runs, quiet) = (Runs::new(threads).raised(py)?, progress.is_none());
    let found = runs.run(py, progress, move |runtime| {
        let file = motion.file.as_deref();
        inputs.make_bones(file.as_slice(), quiet, runtime)?;
        let (mut planning, marks) = runtime.stage("read", || inputs.read(&named))?;
        planning.inputs.extend(marks.inputs);
        let motion = motion.of(&mut planning, marks.bone_landmarks)?;
        let (case, outcome) = pipeline::pose(planning, &motion, marks.landmarks, margin_mm, &config, runtime)?;
        Ok((case, config, outcome))
    })?;
    Ok(Registration::new(runs, found, None))
}
