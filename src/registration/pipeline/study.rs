//! One stage of a study: the same bone motion, carried by another model.

use super::carry::{Fitted, Through, Told, carry_out};
use super::elements::images_pull;
use super::fraction::Fraction;
use super::planning::{Patient, Resting};
use super::{Case, Outcome};
use crate::config::Config;
use crate::error::{Error, Result};
use crate::fit::FitResult;
use crate::runtime::Runtime;
use crate::view::View;

/// Carries a motion that is already known (of a registration, or made) onto the grid of `case.fraction.ct`, which is a scan that
/// was `seen`, or stands for the artificial one of a posture that was made.
///
/// # Errors
/// [`Error::Input`] when the case does not fit the motion.
pub fn carry_again(case: &Case, fit: &FitResult, seen: bool, config: &Config, runtime: &Runtime) -> Result<Outcome> {
    let Patient { skeleton, body, warnings } = Patient::new(&case.planning, config, runtime)?;
    let same =
        skeleton.bones.len() == fit.bones.len() && skeleton.bones.iter().zip(&fit.bones).all(|(a, b)| a.name == b.name);
    if !same {
        return Err(Error::input(
            "bone labels",
            "the skeleton that they give is not that of the run",
            "study a run of these very files and this version",
        ));
    }
    let find = || {
        let view = View::of(&case.fraction.ct);
        Fraction::new(view.known(&case.fraction.ct), view.report, None, config)
    };
    let wanted = seen && images_pull(config);
    let fraction = wanted.then(|| runtime.stage("find the patient in the fraction", find)).transpose()?;
    let resting = Resting::new(&case.planning, &skeleton, &body, false, config, runtime)?;
    let fitted = Fitted { skeleton, body, fit: fit.clone() };
    let through = Through::of(case, fraction);
    let carried = carry_out(through, resting, fitted, warnings, config, runtime)?;
    carried.outcome(&case.planning, &case.fraction.landmarks, Told::default(), config, runtime)
}
