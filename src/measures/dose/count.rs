//! How often each of several doses counts in their sum.

use crate::error::{Error, Result};

/// A share above this is no share of a plan.
const WHOLE: f64 = 1.0 + 1e-9;

/// Factors of several doses: a dose of the whole plan counts by its share, that of one fraction as often as it was given.
#[derive(Debug, Clone, PartialEq)]
pub struct DoseCounts {
    factors: Vec<f64>,
    by_fraction: bool,
}

impl DoseCounts {
    /// Of `n` doses, by shares of a plan from 0 to 1 or by numbers of fractions; each counts once where neither is given.
    ///
    /// # Errors
    /// [`Error::Usage`] when both are given, their count is not `n`, or one is out of range.
    pub fn new(n: usize, weights: &[f64], fractions: &[f64]) -> Result<Self> {
        let by_fraction = !fractions.is_empty();
        let (name, given) = if by_fraction { ("fractions", fractions) } else { ("weights", weights) };
        if by_fraction && !weights.is_empty() {
            let problem = "both weights and numbers of fractions are given";
            return Err(Error::usage(
                problem,
                "give fractions for doses of one fraction, weights for doses of the plan",
            ));
        }
        if given.is_empty() {
            return Ok(Self { factors: vec![1.0; n], by_fraction });
        }
        if given.len() != n {
            let problem = format!("{n} doses but {} {name}", given.len());
            return Err(Error::usage(problem, format!("give one of {name} for each dose, in the same order")));
        }
        if let Some(odd) = given.iter().find(|w| !(w.is_finite() && **w >= 0.0)) {
            return Err(Error::usage(format!("{name}: {odd} is negative or not finite"), "give 0 or more"));
        }
        if let Some(odd) = given.iter().find(|w| !by_fraction && **w > WHOLE) {
            return Err(Error::usage(format!("weights: {odd} is more than a whole plan"), instead(given)));
        }
        Ok(Self { factors: given.to_vec(), by_fraction })
    }

    /// What each dose is multiplied with.
    pub fn factors(&self) -> &[f64] {
        &self.factors
    }

    /// How many fractions a dose counts for, where it is that of one of several.
    pub fn several(&self, dose: usize) -> Option<f64> {
        self.factors.get(dose).copied().filter(|times| self.by_fraction && *times >= 2.0)
    }
}

/// What may have been meant by weights above 1.
fn instead(given: &[f64]) -> String {
    let sum = given.iter().sum::<f64>();
    let told = |values: Vec<String>| values.join(" ");
    let counts = told(given.iter().map(f64::to_string).collect());
    let shares = told(given.iter().map(|w| format!("{:.3}", w / sum)).collect());
    format!(
        "for doses of one fraction give --fractions {counts}; for doses of the whole plan give shares: --weights {shares}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_a_plan_and_fractions_are_numbers() {
        assert_eq!(DoseCounts::new(2, &[], &[]).unwrap().factors(), [1.0, 1.0]);
        assert_eq!(DoseCounts::new(2, &[0.25, 1.0], &[]).unwrap().factors(), [0.25, 1.0]);
        let by_fraction = DoseCounts::new(2, &[], &[20.0, 15.0]).unwrap();
        assert!(by_fraction.several(1) == Some(15.0) && by_fraction.factors() == [20.0, 15.0]);
        for (weights, fractions, word) in [
            (vec![20.0, 15.0], vec![], "more than a whole plan"),
            (vec![0.5], vec![], "2 doses but 1"),
            (vec![0.5, -0.1], vec![], "negative"),
            (vec![], vec![1.0, f64::NAN], "not finite"),
            (vec![0.5, 0.5], vec![1.0, 1.0], "both"),
        ] {
            let error = DoseCounts::new(2, &weights, &fractions).unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(word), "{error}");
        }
        // What to give is computed from what was given.
        let error = DoseCounts::new(2, &[25.0, 10.0], &[]).unwrap_err();
        assert!(error.remedy().contains("--fractions 25 10;"), "{error}");
        assert!(error.remedy().ends_with("--weights 0.714 0.286"), "{error}");
    }
}
