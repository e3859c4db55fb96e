//! The built-in phantom.

use crate::arrays::{LabelRaster, Raster, contour_text, field_raster, label_raster, raster, rows};
use crate::errors::Raised;
use aventail::phantom::{self, PhantomOptions, Posture, degrade};
use aventail::{Error, Result};
use pyo3::prelude::*;
use std::sync::Arc;

/// Head, neck and shoulders with everything that is true about them.
#[pyclass(frozen, module = "aventail._aventail")]
pub(crate) struct Phantom {
    phantom: Arc<phantom::Phantom>,
}

/// Landmarks: name, planning, fraction.
type Points = Vec<(String, [f64; 3], [f64; 3])>;

/// The options of a JSON text, with the spacing of a grid over the same field of view.
fn options(json: &str, spacing: Option<[f64; 3]>, second: bool) -> Result<PhantomOptions> {
    let refuse = |e: serde_json::Error| {
        Error::usage(format!("the options of the phantom are not legal: {e}"), "help(aventail.phantom) names them")
    };
    let mut options: PhantomOptions = serde_json::from_str(json).map_err(refuse)?;
    if second {
        options = PhantomOptions { posture: Posture::second(), seed: options.seed + 10, ..options };
    }
    Ok(spacing.map_or(options.clone(), |spacing| options.with_spacing(spacing)))
}

#[pymethods]
impl Phantom {
    /// Makes it.
    #[new]
    #[pyo3(signature = (json, spacing, second, cbct))]
    fn new(py: Python<'_>, json: &str, spacing: Option<[f64; 3]>, second: bool, cbct: bool) -> PyResult<Self> {
        let mut options = options(json, spacing, second).raised(py)?;
        if cbct {
            // A cone-beam CT brings its own noise and grey values.
            (options.fraction_noise_hu, options.fraction_gain, options.fraction_offset_hu) = (0.0, 1.0, 0.0);
        }
        let make = || {
            let mut made = phantom::Phantom::new(&options)?;
            if cbct {
                made.fraction = degrade(&made.fraction, &Default::default(), options.seed.wrapping_add(2))?;
            }
            Ok::<_, Error>(made)
        };
        Ok(Self { phantom: Arc::new(py.detach(make).raised(py)?) })
    }

    /// Planning CT.
    fn planning<'py>(&self, py: Python<'py>) -> PyResult<Raster<'py, f32>> {
        raster(py, self.phantom.planning.grid(), self.phantom.planning.data().to_vec())
    }

    /// Fraction CT.
    fn fraction<'py>(&self, py: Python<'py>) -> PyResult<Raster<'py, f32>> {
        raster(py, self.phantom.fraction.grid(), self.phantom.fraction.data().to_vec())
    }

    /// Bone labels.
    fn bones<'py>(&self, py: Python<'py>) -> PyResult<LabelRaster<'py>> {
        label_raster(py, self.phantom.bones.clone())
    }

    /// The patient.
    fn body<'py>(&self, py: Python<'py>) -> PyResult<Raster<'py, bool>> {
        raster(py, self.phantom.body.grid(), self.phantom.body.data().to_vec())
    }

    /// Points known in both images.
    fn landmarks(&self) -> Points {
        let own = |l: &aventail::evaluate::landmark::Landmark| (l.name.clone(), l.planning.into(), l.fraction.into());
        self.phantom.landmarks.iter().map(own).collect()
    }

    /// True transform of each bone.
    fn transforms(&self) -> Vec<(String, [[f64; 4]; 4])> {
        let bones = self.phantom.skeleton.bones.iter().map(|b| b.name.clone());
        bones.zip(self.phantom.transforms.iter().map(rows)).collect()
    }

    /// The true field, planning to fraction.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Raster<'py, f32>> {
        let truth = py.detach(|| self.phantom.truth()).raised(py)?;
        field_raster(py, truth.displacement)
    }

    /// Planned dose, and contours as the text of a contour JSON.
    fn plan<'py>(&self, py: Python<'py>) -> PyResult<(Raster<'py, f32>, String)> {
        let plan = || {
            let plan = self.phantom.plan()?;
            Ok::<_, Error>((contour_text(&plan.contours, "planning")?, plan.dose))
        };
        let (text, dose) = py.detach(plan).raised(py)?;
        Ok((raster(py, &dose.grid().clone(), dose.into_data())?, text))
    }
}
