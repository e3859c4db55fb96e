//! What counts as a dose in Gy: judged when it comes in and when it goes out, by everyone alike.

use crate::error::{Error, Result};
use crate::findings;
use crate::volume::Volume;
use crate::warning::Warning;

/// A dose beyond this is not in Gy.
const MOST_GY: f32 = 500.0;
/// Hardly a treatment gives more than this, in all its fractions.
const MUCH_GY: f32 = 120.0;
/// Hardly one of several fractions gives more than this.
const MUCH_A_FRACTION_GY: f32 = 40.0;
/// Values below 0 down to this share of the greatest dose are rounding.
const ROUNDING: f32 = 1e-4;

/// Refuses what is no dose in Gy, sets what rounding made negative to 0, and says what is doubtful. `what` is its name in
/// messages.
///
/// # Errors
/// [`Error::Input`] when a voxel is negative, no number, or above 500 Gy.
pub fn judge(what: &str, dose: &mut Volume<f32>) -> Result<Vec<Warning>> {
    let [least, most] = dose.extremes();
    let below = -(ROUNDING * most.clamp(0.0, MOST_GY)).max(1e-5);
    if least < below || most > MOST_GY || dose.data().iter().any(|d| d.is_nan()) {
        let first = dose.data().iter().position(|d| !(below..=MOST_GY).contains(d)).unwrap_or_default();
        return Err(Error::refused(
            findings::DOSE_UNITS,
            what,
            format!("the dose is {} Gy at voxel {:?}", dose.data()[first], dose.grid().voxel(first)),
            format!("give a dose from 0 to {MOST_GY} Gy: not cGy, not a difference of doses, no CT"),
        ));
    }
    let mut found = Vec::new();
    if least < 0.0 {
        let negative = dose.data().iter().filter(|d| **d < 0.0).count();
        dose.data_mut().iter_mut().for_each(|d| *d = d.max(0.0));
        let message =
            format!("{what}: {negative} voxels are negative by rounding (down to {least:.1e} Gy) and count as 0 Gy");
        found.push(Warning::new(findings::DOSE_NEGATIVE, message));
    }
    found.extend(question(what, most, 1.0));
    Ok(found)
}

/// A word about a dose that is hardly one in Gy, given for `fractions` fractions; `most` is its greatest value.
pub fn question(what: &str, most: f32, fractions: f64) -> Option<Warning> {
    let much = if fractions >= 2.0 { MUCH_A_FRACTION_GY } else { MUCH_GY };
    let message = if most <= 0.0 {
        format!("{what}: the dose is 0 Gy everywhere")
    } else if most > much && fractions >= 2.0 {
        format!("{what}: {most:.1} Gy in one of {fractions} fractions; is it in cGy, or the dose of all fractions?")
    } else if most > much {
        format!(
            "{what}: the greatest dose is {most:.1} Gy; is it in cGy or percent, or a plan that counts more than once?"
        )
    } else {
        return None;
    };
    Some(Warning::new(findings::DOSE_UNITS, message))
}

/// A word about a dose that is to be carried and was carried before.
pub fn dose_carried(what: &str) -> Warning {
    let message = format!(
        "{what}: this dose was itself carried by a registration, not calculated: what is off in it is carried on"
    );
    Warning::new(findings::DOSE_CARRIED, message)
}

/// Refuses a result that is no dose in Gy.
///
/// # Errors
/// [`Error::Input`] when a voxel is above 500 Gy.
pub fn judge_result(what: &str, dose: &Volume<f32>) -> Result<Option<Warning>> {
    let most = dose.extremes()[1];
    if most > MOST_GY {
        let problem = format!("its greatest dose would be {most} Gy, more than {MOST_GY} Gy; nothing is written");
        let remedy = "give the doses in Gy (not cGy); doses of one fraction count by fractions (20), those of the whole plan by shares as \
                      weights (0.571)";
        return Err(Error::refused(findings::DOSE_UNITS, what, problem, remedy));
    }
    Ok(question(what, most, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    fn dose(values: [f32; 2]) -> Volume<f32> {
        Volume::new(Grid::axis_aligned([2, 1, 1], [1.0; 3], [0.0; 3]).unwrap(), values.to_vec()).unwrap()
    }

    #[test]
    fn what_is_no_dose_in_gray_is_refused_and_rounding_is_clipped() {
        for bad in [[0.0, 501.0], [-0.05, 60.0], [-1.0, 0.0], [-1000.0, 3000.0]] {
            let error = judge("d.nii", &mut dose(bad)).unwrap_err();
            assert_eq!((error.code(), error.exit_code()), ("dose-units", 4), "{bad:?}");
        }
        assert!(judge("d.nii", &mut dose([0.0, 70.0])).unwrap().is_empty());
        let mut rounded = dose([-1e-6, 70.0]);
        let found = judge("d.nii", &mut rounded).unwrap();
        assert!(found.len() == 1 && found[0].message.contains("1 voxels"), "{found:?}");
        assert!(rounded.data()[0] >= 0.0);
    }

    #[test]
    fn two_hundred_gray_are_a_question_and_seven_thousand_are_none() {
        assert!(judge("d.nii", &mut dose([0.0, 200.0])).unwrap().iter().any(|w| w.is(findings::DOSE_UNITS)));
        assert!(question("d.nii", 60.0, 30.0).is_some() && question("d.nii", 60.0, 1.0).is_none());
        assert!(question("d.nii", 2.2, 35.0).is_none() && question("d.nii", 0.0, 1.0).is_some());
        assert_eq!(judge_result("out.nii", &dose([0.0, 7000.0])).unwrap_err().exit_code(), 4);
    }
}
