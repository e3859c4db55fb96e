//! One stage of a study: the same bone motion, carried by another model.

use super::carry::{carry_out, images};
use super::planning::Patient;
use super::{Case, Outcome};
use crate::body;
use crate::config::Config;
use crate::error::{Error, Result};
use crate::fit::FitResult;
use crate::runtime::Runtime;

/// Name of the stage of [`Outcome::stages`] that carries the motion: what a study compares the time of.
pub const CARRYING: &str = "propagate to soft tissue";

/// Carries a motion that is already known (of a registration, or made) onto the grid of `case.fraction`.
///
/// # Errors
/// [`Error::Input`] when the case does not fit the motion.
pub fn carry_again(case: &Case, fit: &FitResult, config: &Config, runtime: &Runtime) -> Result<Outcome> {
    let Patient { skeleton, body, warnings } = Patient::new(case, config, runtime)?;
    let warnings = [case.warnings.as_slice(), &warnings].concat();
    let same =
        skeleton.bones.len() == fit.bones.len() && skeleton.bones.iter().zip(&fit.bones).all(|(a, b)| a.name == b.name);
    if !same {
        return Err(Error::input(
            "bone labels",
            "the skeleton that they give is not that of the run",
            "study a run of these very files and this version",
        ));
    }
    let seen = case.inputs.iter().any(|i| i.role == "fraction");
    let images = if seen {
        images(case, &body, || body::find(&case.fraction, None, &config.body), config, runtime)?
    } else {
        None
    };
    carry_out(case, case.fraction.grid(), (skeleton, body, fit.clone()), images.as_ref(), warnings, config, runtime)
}
