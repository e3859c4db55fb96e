//! Registrations and poses, and what they found.

use crate::arrays::{Given, LabelRaster, Raster, field_raster, label_raster, raster, rows};
use crate::case::{self, More, Settings, transforms};
use crate::errors::Raised;
use crate::runs::{Runs, Work};
use crate::warp;
use aventail::pipeline::{sample_set, sampled_field};
use aventail::sampling::{SampleSet, SamplingOptions};
use aventail::session::{self, Beside, FractionSources, MotionSource, PoseRequest, Registered, Request, Session};
use aventail::volume::{LabelMap, Volume};
use aventail::{Outcome, Result, io};
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard};

/// The outcome of a registration or a pose.
#[pyclass(frozen, module = "aventail._aventail")]
pub(crate) struct Registration {
    runs: Runs,
    found: Arc<RwLock<Registered>>,
}

/// A raster of labels, or none.
type MaybeLabels<'py> = Option<LabelRaster<'py>>;

impl Registration {
    fn new(runs: Runs, found: Registered) -> Self {
        Self { runs, found: Arc::new(RwLock::new(found)) }
    }

    fn found(&self) -> RwLockReadGuard<'_, Registered> {
        self.found.read().unwrap_or_else(PoisonError::into_inner)
    }

    /// What `of` takes out of the results, without the interpreter's lock.
    fn taken<T: Send>(&self, py: Python<'_>, of: impl FnOnce(&Registered) -> T + Send) -> T {
        py.detach(|| of(&self.found()))
    }
}

#[pymethods]
impl Registration {
    /// The report as JSON.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        self.taken(py, |found| found.report()?.json()).raised(py)
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
            "uncertainty" => found.outcome.uncertainty.as_ref().map(|(map, _)| map.to_volume()),
            _ => None,
        });
        image.map(|image| raster(py, &image.grid().clone(), image.into_data())).transpose()
    }

    /// A label map by its name; `None` where this run has none.
    fn labels<'py>(&self, py: Python<'py>, name: &str) -> PyResult<MaybeLabels<'py>> {
        let labels = self.taken(py, |found| match name {
            "bones_on_fraction" => Some(found.outcome.bones_on_fraction.to_map()),
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
        let all = Arc::clone(&self.found);
        self.runs.run(py, progress, move |runtime| {
            let mut found = all.write().unwrap_or_else(PoisonError::into_inner);
            let held = found.hold(&folder)?;
            found.save(held, &folder, Beside { view, ..Beside::default() }, runtime).map(drop)
        })
    }

    /// Samples of its error: what `samples` of the program draws.
    #[pyo3(signature = (number, seed, scale))]
    fn samples(&self, py: Python<'_>, number: usize, seed: u64, scale: Option<f64>) -> PyResult<Samples> {
        let scale = scale.unwrap_or(SamplingOptions::default().scale);
        let options = SamplingOptions { number, seed, scale };
        let draw = |found: &Registered| sample_set(&found.case.planning, &found.outcome, &options);
        let set = self.taken(py, draw).raised(py)?;
        Ok(Samples { found: Arc::clone(&self.found), set: Arc::new(set) })
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
    #[pyo3(signature = (image, to_fraction, kind, grid))]
    fn warp_image<'py>(
        &self,
        py: Python<'py>,
        image: &Bound<'py, PyAny>,
        to_fraction: bool,
        kind: warp::Kind,
        grid: Option<warp::Target>,
    ) -> PyResult<Raster<'py, f32>> {
        let given = crate::arrays::image(image)?;
        let target = grid.map(warp::Target::grid).transpose().raised(py)?;
        let warped = self.taken(py, |found| {
            let back = displacement(&found.outcome, !to_fraction);
            warp::image(back, given, target.as_ref(), kind)
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
                Given::File(path) => io::read_label_map(path, None)?.value,
                Given::Memory(volume) => LabelMap { volume, names: Default::default() },
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

/// Samples of a registration.
#[pyclass(frozen, module = "aventail._aventail")]
pub(crate) struct Samples {
    found: Arc<RwLock<Registered>>,
    set: Arc<SampleSet>,
}

#[pymethods]
impl Samples {
    /// The field of one sample, planning to fraction.
    fn field<'py>(&self, py: Python<'py>, sample: usize) -> PyResult<Raster<'py, f32>> {
        let field = py.detach(|| {
            let found = self.found.read().unwrap_or_else(PoisonError::into_inner);
            let sample = sample.min(self.set.number().saturating_sub(1));
            sampled_field(&found.outcome.push.displacement, &self.set, sample)
        });
        field_raster(py, field)
    }
}

/// One of the two fields.
fn displacement(outcome: &Outcome, to_fraction: bool) -> &Volume<[f32; 3]> {
    if to_fraction { &outcome.push.displacement } else { &outcome.pull.displacement }
}

/// What is to be registered, and how it is run.
struct Wanted {
    request: Request,
    /// Where labels that are made are kept.
    beside: PathBuf,
    runs: Runs,
}

impl Wanted {
    /// Registers all fractions.
    fn register(self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Registration>> {
        let Self { mut request, beside, runs } = self;
        let quiet = progress.is_none();
        let found = runs.run(py, progress, move |runtime| {
            request.make_bones(case::asks(&beside, quiet), runtime)?;
            request.expected_memory()?;
            let mut all = Vec::new();
            Session::open(request, runtime)?.register_all(runtime, |one| {
                all.push(one);
                Ok(())
            })?;
            Ok(all)
        })?;
        Ok(found.into_iter().map(|one| Registration::new(runs.clone(), one)).collect())
    }
}

/// The planning image and the labels of its bones.
type GivenPlanning<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);

/// A fraction, its landmarks, the labels of its bones, and those of the structures that guide to it.
type GivenFraction<'py> =
    (Bound<'py, PyAny>, Option<Bound<'py, PyAny>>, Option<case::Labelled<'py>>, Option<case::Labelled<'py>>);

/// Registers one or several fractions of a patient, in their order; what depends on planning alone is done once. Marks that belong
/// to one fraction are refused for several before.
#[pyfunction]
#[pyo3(signature = (planning, fractions, more, settings, work))]
pub(crate) fn register(
    py: Python<'_>,
    planning: GivenPlanning<'_>,
    fractions: Vec<GivenFraction<'_>>,
    more: More<'_>,
    settings: Settings,
    work: Work<'_>,
) -> PyResult<Vec<Registration>> {
    let config = more.settled(&settings).raised(py)?;
    let side = more.planning(&planning.0, &planning.1)?;
    let one = |(image, marks, bones, guides): &GivenFraction<'_>| {
        case::fraction(image, marks.as_ref(), bones.as_ref(), guides.as_ref())
    };
    let all = fractions.iter().map(one);
    let mut all = all.collect::<PyResult<Vec<FractionSources>>>()?;
    if let [only] = all.as_mut_slice() {
        (only.bone_landmarks, only.start) = (more.marks()?.1, more.start().raised(py)?.map(Given::Memory));
    }
    let (request, beside) = (more.request(side, all, config), more.beside());
    Wanted { request, beside, runs: Runs::new(work.threads()).raised(py)? }.register(py, work.progress())
}

/// How bones are told to move, and how far the artificial CT reaches.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Motion {
    /// A pose file's text.
    text: Option<String>,
    /// A pose file.
    file: Option<PathBuf>,
    /// Transforms by bone name.
    transforms: Option<Vec<(String, [[f64; 4]; 4])>>,
    /// How far the artificial CT reaches beyond the planning grid, mm.
    margin_mm: f64,
}

impl Motion {
    /// The motion; by landmarks on bones where it is none of its own.
    fn source(self, on_bones: Option<Given<Vec<aventail::fit::BoneLandmark>>>) -> Result<MotionSource> {
        Ok(match (self.transforms, self.text, self.file) {
            (Some(all), ..) => MotionSource::Transforms(Given::Memory(transforms(all)?)),
            (None, Some(text), _) => MotionSource::Pose(Given::Memory(text)),
            (None, None, Some(file)) => MotionSource::Pose(Given::File(file)),
            (None, None, None) => MotionSource::Landmarks(on_bones.unwrap_or(Given::Memory(Vec::new()))),
        })
    }
}

/// Poses a patient.
#[pyfunction]
#[pyo3(signature = (planning, motion, more, settings, work))]
pub(crate) fn pose(
    py: Python<'_>,
    planning: GivenPlanning<'_>,
    motion: Motion,
    more: More<'_>,
    settings: Settings,
    work: Work<'_>,
) -> PyResult<Registration> {
    let config = more.settled(&settings).raised(py)?;
    let planning = more.planning(&planning.0, &planning.1)?;
    let (landmarks, on_bones) = more.marks()?;
    let margin_mm = motion.margin_mm;
    let motion = motion.source(on_bones).raised(py)?;
    let (recorded, command) = (Vec::new(), case::COMMAND.to_owned());
    let mut request = PoseRequest { planning, motion, landmarks, margin_mm, recorded, config, command };
    let (runs, quiet, beside) = (Runs::new(work.threads()).raised(py)?, work.progress().is_none(), more.beside());
    let found = runs.run(py, work.progress(), move |runtime| {
        let (needed, told) = (request.needed(), request.config.planning.modality);
        request.planning.make_bones(&needed, told, case::asks(&beside, quiet), runtime)?;
        session::pose(request, runtime)
    })?;
    Ok(Registration::new(runs, found))
}
