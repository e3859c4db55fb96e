//! A dose through a registration: mapped the way that was asked for, with its balance and what deserves doubt.

use crate::dose::{Caution, EnergyBalance, EnergyMassOptions, caution, energy_mass, interpolate};
use crate::error::{Error, Result};
use crate::evaluate::{Direction, FieldPair, consistency};
use crate::field::{InverseReport, Outside, digital_folds};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::Volume;
use crate::warning::{Warning, counted};
use serde::{Deserialize, Serialize};

/// How dose is carried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DoseMethod {
    /// Trilinear interpolation at mapped positions.
    Interpolate,
    /// Energy and mass together; conserves energy.
    EnergyMass(EnergyMassOptions),
}

/// What is to be said about a mapped dose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DoseReport {
    /// Way of the dose: planning to fraction, or fraction to planning.
    pub direction: Direction,
    /// How it was carried.
    pub method: DoseMethod,
    /// Energy before and after, with the energy/mass method.
    pub balance: Option<EnergyBalance>,
    /// The inversion, when the field was given the other way only.
    pub inversion: Option<InverseReport>,
    /// Whether the dose went through a field that was given; then an inversion serves checks alone.
    pub by_given: bool,
    /// What lies outside the given field, where that is the identity: of the dose, if the field lies in its frame, else of the
    /// result.
    pub outside: Outside,
    /// Where the result deserves doubt.
    pub caution: Caution,
    /// Findings that the user should know of.
    pub warnings: Vec<Warning>,
}

/// Carries `dose` in `direction` onto `to`. `ct` gives HU in the dose's frame; the energy/mass method needs it.
///
/// Interpolation uses the field of the target's grid, energy/mass mapping that of the source's; which of them is exact and
/// which was made by inversion is in the report.
///
/// # Errors
/// [`Error::Usage`] when the energy/mass method has no CT.
pub fn map_dose(
    dose: &Volume<f32>,
    pair: &FieldPair,
    direction: Direction,
    to: &Grid,
    method: &DoseMethod,
    ct: Option<&Volume<f32>>,
) -> Result<(Volume<f32>, DoseReport)> {
    let (push, pull) = (&pair.push.displacement, &pair.pull.displacement);
    let (along, against) = match direction {
        Direction::PlanningToFraction => (push, pull),
        Direction::FractionToPlanning => (pull, push),
    };
    let (mapped, balance) = match method {
        DoseMethod::Interpolate => (interpolate(dose, against, to)?, None),
        DoseMethod::EnergyMass(options) => {
            let ct = ct.ok_or_else(|| {
                Error::usage(
                    "energy/mass mapping needs the mass, and no CT of the dose's frame is given",
                    "add --ct FILE, the CT in the frame in which the dose was computed, or take --method interpolate",
                )
            })?;
            let (mapped, balance) = energy_mass(dose, ct, along, to, options)?;
            (mapped, Some(balance))
        }
    };
    let folds = digital_folds(&pair.push);
    let uncertainty = consistency::residual(against, along, to, |y, x| {
        let planning = if direction == Direction::PlanningToFraction { x } else { y };
        let at = folds.grid().index(planning).map(f64::floor);
        let inside = (0..3).all(|a| at[a] >= 0.0 && at[a] < folds.grid().size()[a] as f64);
        inside && *folds.at([0, 1, 2].map(|a| at[a] as usize))
    })?;
    let caution = caution(&mapped, &uncertainty);
    let (outside, whose) = outside(dose, &mapped, pair, direction, method);
    let mut warnings = warnings(&caution, balance.as_ref());
    if outside.amount_percent > WORTH {
        let message = format!(
            "{:.1} % of the volume and {:.1} % of {whose} lie outside the field, which is the identity there: that dose is \
             not moved, and the map has a seam",
            outside.volume_percent, outside.amount_percent
        );
        warnings.push(Warning::new(findings::OUTSIDE_FIELD, message));
    }
    let inversion = pair.inversion;
    let (method, by_given) = (method.clone(), pair.given.contains(&used(direction, method)));
    Ok((mapped, DoseReport { direction, method, balance, inversion, by_given, outside, caution, warnings }))
}

/// Less of the dose outside a field is not worth a word, percent.
const WORTH: f64 = 0.05;

/// The field that a dose goes through: interpolation looks from the target back to where the dose is.
fn used(direction: Direction, method: &DoseMethod) -> Direction {
    if *method == DoseMethod::Interpolate { direction.reversed() } else { direction }
}

/// What lies outside the field that was given, and whose dose that is. A direction that was made by inversion reaches
/// wherever it is asked for and tells nothing.
fn outside(
    dose: &Volume<f32>,
    mapped: &Volume<f32>,
    pair: &FieldPair,
    direction: Direction,
    method: &DoseMethod,
) -> (Outside, &'static str) {
    let used = used(direction, method);
    let field = if pair.given.contains(&used) { used } else { used.reversed() };
    let grid = match field {
        Direction::PlanningToFraction => pair.push.displacement.grid(),
        Direction::FractionToPlanning => pair.pull.displacement.grid(),
    };
    if field == direction {
        (Outside::of(dose, grid), "the dose")
    } else {
        (Outside::of(mapped, grid), "the mapped dose")
    }
}

fn warnings(caution: &Caution, balance: Option<&EnergyBalance>) -> Vec<Warning> {
    let mut all = Vec::new();
    let outside = caution.folded_or_outside - caution.folded;
    if caution.folded > 0 {
        let more = if outside > 0 {
            format!("; {} the images", counted(outside, "more leaves", "more leave"))
        } else {
            String::new()
        };
        let message = format!(
            "{} in steep dose (more than 1 % of the maximum per mm) where the field folds: the dose there is not to be \
             trusted{more}",
            counted(caution.folded, "voxel lies", "voxels lie")
        );
        all.push(Warning::new(findings::FOLDS_IN_STEEP_DOSE, message));
    } else if outside > 0 {
        let message = format!(
            "{} the images in steep dose (more than 1 % of the maximum per mm): the field is not checked there",
            counted(outside, "voxel leaves", "voxels leave")
        );
        all.push(Warning::new(findings::STEEP_DOSE_OUTSIDE, message));
    }
    if caution.uncertain > 0 {
        let message = format!(
            "in {} the inverse-consistency error may change the dose by over 1 % of its maximum; \
             greatest change {:.2} Gy",
            counted(caution.uncertain, "voxel", "voxels"),
            caution.greatest_gy
        );
        all.push(Warning::new(findings::UNCERTAIN_FIELD_IN_STEEP_DOSE, message));
    }
    if let Some(b) = balance.filter(|b| b.outside_j > 0.01 * b.source_j) {
        let share = 100.0 * b.outside_j / b.source_j;
        let message = format!("{share:.1} % of the energy falls outside the target grid");
        all.push(Warning::new(findings::ENERGY_OUTSIDE, message));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    const FROM: [f64; 3] = [-20.0, 10.0, 300.0];

    /// A cube of 10 Gy, in voxels of 2 mm, from this voxel along x.
    fn cube(first: usize) -> Volume<f32> {
        let grid = Grid::axis_aligned([16, 10, 10], [2.0; 3], FROM).unwrap();
        Volume::from_fn(grid.clone(), |n| {
            let [i, j, k] = grid.voxel(n);
            if (first..first + 4).contains(&i) && (3..7).contains(&j) && (3..7).contains(&k) { 10.0 } else { 0.0 }
        })
    }

    /// A shift of 4 mm to the left, given both ways, forth on so many planes along x alone.
    fn shift(planes: usize) -> FieldPair {
        let grid = |n: usize| Grid::axis_aligned([n, 10, 10], [2.0; 3], FROM).unwrap();
        let [push, pull] = [(planes, 4.0), (16, -4.0)].map(|(n, mm)| Volume::filled(grid(n), [mm, 0.0, 0.0]));
        FieldPair::new(Some(push), Some(pull), None, None).unwrap().unwrap()
    }

    fn energy_mass() -> DoseMethod {
        DoseMethod::EnergyMass(EnergyMassOptions::default())
    }

    /// Where the middle of a dose lies along x, mm.
    fn middle(dose: &Volume<f32>) -> f64 {
        let grid = dose.grid();
        let each = dose.data().iter().enumerate().map(|(n, gy)| [f64::from(*gy), grid.centre(grid.voxel(n)).x]);
        let [sum, moment] = each.fold([0.0; 2], |[sum, moment], [gy, x]| [sum + gy, moment + gy * x]);
        moment / sum
    }

    #[test]
    fn a_dose_goes_the_way_that_is_asked_by_both_methods() {
        let (dose, pair) = (cube(5), shift(16));
        let water = dose.map(|_| 0.0);
        for (direction, mm) in [(Direction::PlanningToFraction, 4.0), (Direction::FractionToPlanning, -4.0)] {
            for method in [DoseMethod::Interpolate, energy_mass()] {
                let (mapped, _) = map_dose(&dose, &pair, direction, dose.grid(), &method, Some(&water)).unwrap();
                let moved = middle(&mapped) - middle(&dose);
                assert!((moved - mm).abs() < 1e-3, "{direction:?} {method:?}: {moved}");
            }
        }
    }

    #[test]
    fn whether_a_dose_goes_through_the_given_field_is_told() {
        let dose = cube(5);
        let (water, grid) = (dose.map(|_| 0.0), dose.grid());
        let push = Volume::filled(grid.clone(), [4.0, 0.0, 0.0]);
        let pair = FieldPair::new(Some(push), None, Some(grid), Some(grid)).unwrap().unwrap();
        let by_given = |direction, method| {
            let report = map_dose(&dose, &pair, direction, grid, &method, Some(&water)).unwrap().1;
            assert!(report.inversion.is_some());
            report.by_given
        };
        let there = [DoseMethod::Interpolate, energy_mass()].map(|m| by_given(Direction::PlanningToFraction, m));
        let back = [DoseMethod::Interpolate, energy_mass()].map(|m| by_given(Direction::FractionToPlanning, m));
        assert_eq!((there, back), ([false, true], [true, false]));
    }

    #[test]
    fn dose_outside_the_field_that_carries_it_is_told() {
        // The push field covers half of the dose.
        let (dose, pair) = (cube(5), shift(7));
        let water = dose.map(|_| 0.0);
        let outside = |direction: Direction, method: &DoseMethod| {
            let report = map_dose(&dose, &pair, direction, dose.grid(), method, Some(&water)).unwrap().1;
            (report.outside.amount_percent, report.warnings.iter().any(|w| w.is(findings::OUTSIDE_FIELD)))
        };
        let (percent, told) = outside(Direction::PlanningToFraction, &energy_mass());
        assert!((percent - 50.0).abs() < 1e-6 && told, "{percent}");
        // The pull field, by which it is interpolated, covers all of it. On the way back the fields change their roles.
        assert_eq!(outside(Direction::PlanningToFraction, &DoseMethod::Interpolate), (0.0, false));
        assert_eq!(outside(Direction::FractionToPlanning, &energy_mass()), (0.0, false));
        let (percent, told) = outside(Direction::FractionToPlanning, &DoseMethod::Interpolate);
        assert!(percent > 10.0 && told, "{percent}");
    }

    #[test]
    fn folds_and_what_leaves_the_images_are_told_apart() {
        let told = |folded_or_outside, folded| {
            let caution = Caution { folded_or_outside, folded, ..Caution::default() };
            warnings(&caution, None).pop().map(|w| (w.code, w.message))
        };
        assert_eq!(told(0, 0), None);
        let (code, words) = told(30, 0).unwrap();
        assert!(code == "steep-dose-outside" && words.contains("30 voxels") && !words.contains("fold"), "{words}");
        let (code, words) = told(30, 12).unwrap();
        assert!(
            code == "folds-in-steep-dose" && words.starts_with("12 voxels") && words.contains("18 more"),
            "{words}"
        );
    }

    #[test]
    fn energy_that_leaves_the_target_is_told() {
        let lost = |outside_j: f64| {
            let balance = EnergyBalance { source_j: 100.0, outside_j, ..EnergyBalance::default() };
            warnings(&Caution::default(), Some(&balance))
        };
        assert!(lost(0.9).is_empty());
        let [word] = &lost(5.0)[..] else { panic!("one warning") };
        assert!(word.is(findings::ENERGY_OUTSIDE) && word.message.contains("5.0 % of the energy"), "{word:?}");
    }
}
