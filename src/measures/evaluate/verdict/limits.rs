//! The table of limits, and the rules that need nothing but a number.

use super::{Figure, Mark, TG132, Verdict};
use crate::evaluate::agreement::{Agreement, TissueAgreement};
use crate::evaluate::uncertainty::in_mm;
use crate::stats::{Summary, millilitres};
use crate::warning::counted;
use serde::{Deserialize, Serialize};

/// What passes, what is reviewed and what fails: pairs hold up to where a figure passes and up to where it is reviewed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Mean residual of landmarks, mm; the second counts as the largest voxel edge where that is greater, as TG-132 has it:
    /// nothing is known better than a voxel.
    pub landmark_mean_mm: [f64; 2],
    /// Greatest residual of a landmark, mm; beyond it is reviewed.
    pub landmark_greatest_mm: f64,
    /// Mean distance to agreement of a structure, mm; the second as for landmarks.
    pub agreement_mm: [f64; 2],
    /// Dice of a structure: passes and is reviewed from these on.
    pub dice: [f64; 2],
    /// Planning to fraction and back, and round three images, 95th percentile, mm; the second as for landmarks.
    pub consistency_mm: [f64; 2],
    /// Volume of tissue in folded cells, percent of the tissue, outside bone contact and sliding interfaces.
    pub folded_percent: [f64; 2],
    /// The same, ml: many cells of a large scan are a small share.
    pub folded_ml: [f64; 2],
    /// Folded volume in bone contact and sliding interfaces, percent of the tissue; beyond it is reviewed.
    pub folded_contact_percent: f64,
    /// Tissue voxels of the fraction without an exact pre-image, percent of its tissue; beyond it is reviewed.
    pub no_inverse_percent: f64,
    /// Departure of a bone from rigid motion, root mean square, mm.
    pub rigidity_mm: [f64; 2],
    /// Curl, the greatest.
    pub curl: [f64; 2],
    /// Uncertainty of soft tissue, 95th percentile, mm; beyond it is reviewed.
    pub uncertainty_mm: f64,
    /// Mean local correlation of the images at bones after registration: passes and is reviewed from these on.
    pub image_bones: [f64; 2],
    /// The same in soft tissue.
    pub image_soft_tissue: [f64; 2],
    /// Volume at bones, and of soft tissue, that agrees less than with the couch shift alone, percent.
    pub image_worse_percent: [f64; 2],
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            landmark_mean_mm: [2.0, 3.0],
            landmark_greatest_mm: 5.0,
            agreement_mm: [2.0, 3.0],
            dice: [0.9, 0.8],
            consistency_mm: [2.0, 3.0],
            folded_percent: [0.001, 0.1],
            folded_ml: [0.1, 10.0],
            folded_contact_percent: 0.1,
            no_inverse_percent: 0.01,
            rigidity_mm: [1.0, 2.0],
            curl: [5.0, 10.0],
            uncertainty_mm: 3.0,
            image_bones: [0.85, 0.5],
            image_soft_tissue: [0.5, 0.3],
            image_worse_percent: [10.0, 30.0],
        }
    }
}

/// The looser limit is the largest voxel edge where that is greater, as TG-132 has it.
fn or_voxel([strict, loose]: [f64; 2], voxel_mm: f64) -> [f64; 2] {
    [strict, loose.max((voxel_mm * 10.0).round() / 10.0)]
}

impl Limits {
    /// Mean and greatest residual of landmarks; `voxel_mm`: largest voxel edge of both scans.
    pub fn landmarks(&self, after: &Summary, voxel_mm: f64) -> [Verdict; 2] {
        let figure = |what: &str, value, source| Figure {
            name: format!("landmarks, {what} residual"),
            value,
            unit: "mm",
            source,
            remedy: "look at the landmarks that are farthest off; check that both positions show the same point",
        };
        [
            figure("mean", after.mean, "after AAPM TG-132; on the mean: ours")
                .at_most(or_voxel(self.landmark_mean_mm, voxel_mm)),
            figure("greatest", after.max, "AAPM TG-132, of test data")
                .at_most([self.landmark_greatest_mm, f64::INFINITY]),
        ]
    }

    /// Mean distance to agreement of a structure, mm; `voxel_mm`: largest voxel edge of both scans.
    pub fn agreement(&self, name: &str, mean_mm: f64, voxel_mm: f64) -> Verdict {
        let name = format!("{name}, mean distance to agreement");
        let remedy = "compare the mapped contour with the drawn one; do not take the mapped one over";
        let figure = Figure { name, value: mean_mm, unit: "mm", source: TG132, remedy };
        figure.at_most(or_voxel(self.agreement_mm, voxel_mm))
    }

    /// Dice of a structure.
    pub fn dice(&self, name: &str, dice: f64) -> Verdict {
        let name = format!("{name}, Dice");
        let remedy = "compare the mapped contour with the drawn one; small structures easily have a low Dice";
        Figure { name, value: dice, unit: "", source: TG132, remedy }.at_least(self.dice)
    }

    /// 95th percentile of a consistency error, mm; `voxel_mm`: largest voxel edge of both scans.
    pub fn consistency(&self, what: &str, p95_mm: f64, voxel_mm: f64) -> Verdict {
        let name = format!("{what}, 95th percentile");
        let remedy = "do not carry dose or contours back and forth where the two fields differ";
        let figure = Figure { name, value: p95_mm, unit: "mm", source: "after AAPM TG-132; percentile: ours", remedy };
        figure.at_most(or_voxel(self.consistency_mm, voxel_mm))
    }

    /// Tissue voxels of the fraction that no exact point of planning is found for, as a share of so many tissue voxels.
    pub fn no_inverse(&self, without: usize, tissue: usize) -> Verdict {
        let percent = 100.0 * without as f64 / tissue.max(1) as f64;
        let figure = Figure {
            name: "tissue without exact pre-image".into(),
            value: percent,
            unit: "%",
            source: "docs/metrics.md",
            remedy: "do not trust what is shown or mapped there: the field has no inverse",
        };
        let mut verdict = figure.at_most([self.no_inverse_percent, f64::INFINITY]);
        let voxels = counted(tissue, "tissue voxel", "tissue voxels");
        verdict.reason.push_str(&format!("; {without} of {voxels}"));
        verdict
    }

    /// Root mean square departure of the least rigid bone from rigid motion, mm.
    pub fn rigidity(&self, bone: &str, rms_mm: f64) -> Verdict {
        let name = format!("departure from rigid motion, {bone}");
        let remedy = "do not trust the field in and beside this bone: bones do not bend";
        Figure { name, value: rms_mm, unit: "mm", source: "bones are rigid", remedy }.at_most(self.rigidity_mm)
    }

    /// Neighbouring Jacobians that differ by more than 10: errors of the field.
    pub fn jumps(&self, direction: &str, count: usize) -> Verdict {
        let (mark, reason) = match count {
            0 => (Mark::Pass, "none".to_owned()),
            n => {
                let pairs = counted(n, "pair of neighbours differs", "pairs of neighbours differ");
                (Mark::Review, format!("{pairs} by more than 10: errors of the field"))
            }
        };
        let figure = Figure {
            name: format!("Jacobian jumps above 10, {direction}"),
            value: count as f64,
            unit: "pairs",
            source: "Bartelheimer 2019, 2.3.2",
            remedy: "look at the Jacobian map; do not map dose there",
        };
        figure.said("pass with none, else review".into(), mark, reason)
    }

    /// Greatest curl: 0 to 5 is physical, 5 to 10 unphysical.
    pub fn curl(&self, direction: &str, greatest: f64) -> Verdict {
        let name = format!("greatest curl, {direction}");
        let remedy = "look for a tear of the field: tissue does not turn like that";
        Figure { name, value: greatest, unit: "", source: "Schreibmann 2012", remedy }.at_most(self.curl)
    }

    /// 95th percentile of the uncertainty of soft tissue, mm, none where it is unknown; `above_2mm_ml`: soft tissue with
    /// more than 2 mm or unknown.
    pub fn uncertainty(&self, of: &str, p95_mm: Option<f64>, above_2mm_ml: f64) -> Verdict {
        let figure = Figure {
            name: format!("uncertainty of {of}, 95th percentile"),
            value: p95_mm.unwrap_or(f64::INFINITY),
            unit: "mm",
            source: "docs/metrics.md; TG-132's 2 to 3 mm",
            remedy: "use contours and dose only where the map of uncertainty is low",
        };
        let mut verdict = figure.at_most([self.uncertainty_mm, f64::INFINITY]);
        if p95_mm.is_none() {
            verdict.reason = format!("{} mm: beyond {} mm", in_mm(None, 1), self.uncertainty_mm);
        }
        verdict.reason.push_str(&format!("; {} have more than 2 mm or are not known", millilitres(above_2mm_ml)));
        verdict
    }

    /// How far the images agree after registration, at bones and in soft tissue, and where the couch shift alone did better.
    pub fn images(&self, agreement: &Agreement) -> Vec<Verdict> {
        let all = [
            ("at bones", agreement.bones, self.image_bones),
            ("in soft tissue", agreement.soft_tissue, self.image_soft_tissue),
        ];
        let of = |(where_, tissue, least): (&str, Option<TissueAgreement>, [f64; 2])| {
            let remedy = "look at the fusion pictures: the images do not show the same there, or lie apart";
            let figure = |what: &str, value: f64, unit: &'static str| Figure {
                name: format!("images {where_}, {what}"),
                value,
                unit,
                source: "docs/metrics.md",
                remedy,
            };
            let tissue = tissue?;
            let mut mean = figure("local correlation", tissue.after, "").at_least(least);
            let told = |value: Option<f64>| value.map_or("unknown".to_owned(), |v| format!("{v:.2}"));
            let [before, couch] = [tissue.before, tissue.couch].map(told);
            let shift = agreement.alone.name();
            mean.reason.push_str(&format!("; {before} as scanned, {couch} with the {shift} alone"));
            let worse = figure(&format!("worse than with the {shift}"), tissue.worse_percent, "%");
            Some([mean, worse.at_most(self.image_worse_percent)])
        };
        all.into_iter().filter_map(of).flatten().collect()
    }

    /// What is impossible in these limits, if anything.
    pub fn problem(&self) -> Option<String> {
        let upward = [
            ("landmark_mean_mm", self.landmark_mean_mm),
            ("agreement_mm", self.agreement_mm),
            ("consistency_mm", self.consistency_mm),
            ("folded_percent", self.folded_percent),
            ("folded_ml", self.folded_ml),
            ("rigidity_mm", self.rigidity_mm),
            ("curl", self.curl),
            ("image_worse_percent", self.image_worse_percent),
            ("dice, second and first", [self.dice[1], self.dice[0]]),
            ("image_bones, second and first", [self.image_bones[1], self.image_bones[0]]),
            ("image_soft_tissue, second and first", [self.image_soft_tissue[1], self.image_soft_tissue[0]]),
        ];
        let single = [
            ("landmark_greatest_mm", self.landmark_greatest_mm),
            ("folded_contact_percent", self.folded_contact_percent),
            ("no_inverse_percent", self.no_inverse_percent),
            ("uncertainty_mm", self.uncertainty_mm),
        ];
        let pair = |(name, [low, high]): &(&str, [f64; 2])| {
            let bad = !(0.0..=*high).contains(low);
            bad.then(|| format!("verdict.{name} is {low} and {high}: 0 or more, the pass limit stricter, are needed"))
        };
        let one = |(name, value): &(&str, f64)| {
            let bad = value.is_nan() || *value < 0.0;
            bad.then(|| format!("verdict.{name} is {value}: 0 or more is needed"))
        };
        upward.iter().find_map(pair).or_else(|| single.iter().find_map(one))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_in_the_wrong_order_are_named() {
        assert_eq!(Limits::default().problem(), None);
        let dice = Limits { dice: [0.8, 0.9], ..Limits::default() };
        assert!(dice.problem().unwrap().contains("dice"));
        let folds = Limits { folded_ml: [1.0, 0.5], ..Limits::default() };
        assert!(folds.problem().unwrap().contains("folded_ml"));
        let single = Limits { uncertainty_mm: f64::NAN, ..Limits::default() };
        assert!(single.problem().unwrap().contains("uncertainty_mm"));
    }
    #[test]
    fn every_rule_passes_reviews_and_fails_where_its_limits_say() {
        let limits = Limits::default();
        let marks = |rule: &dyn Fn(f64) -> Verdict, values: [f64; 3]| values.map(|v| rule(v).verdict);
        let (pass, review, fail) = (Mark::Pass, Mark::Review, Mark::Fail);
        let summary = |mean, max| Summary { mean, max, ..Summary::default() };
        let all = [pass, review, fail];
        assert_eq!(marks(&|v| limits.landmarks(&summary(v, 0.0), 1.0)[0].clone(), [2.0, 2.9, 3.1]), all);
        assert_eq!(marks(&|v| limits.landmarks(&summary(0.0, v), 1.0)[1].clone(), [5.0, 5.1, 99.0])[1..], [review; 2]);
        assert_eq!(marks(&|v| limits.agreement("cord", v, 1.0), [2.0, 2.9, 3.1]), all);
        assert_eq!(marks(&|v| limits.dice("cord", v), [0.9, 0.85, 0.79]), all);
        assert_eq!(marks(&|v| limits.consistency("there and back", v, 1.0), [2.0, 2.9, 3.1]), all);
        assert_eq!(marks(&|v| limits.rigidity("C1", v), [1.0, 1.9, 2.1]), all);
        assert_eq!(marks(&|v| limits.curl("push", v), [5.0, 9.9, 10.1]), all);
        assert_eq!(marks(&|v| limits.uncertainty("lung", Some(v), 0.0), [3.0, 3.1, 99.0]), [pass, review, review]);
        let unknown = limits.uncertainty("lung", None, 900.0);
        assert!(unknown.verdict == review && unknown.reason.starts_with("> 30 mm: beyond 3 mm; 900 ml"), "{unknown:?}");
        let again: Verdict = serde_json::from_str(&serde_json::to_string(&unknown).unwrap()).unwrap();
        assert!(again.value.is_nan() && again.reason == unknown.reason, "a report can be read again");
        // A figure that could not be measured does not pass.
        assert_eq!(limits.curl("push", f64::NAN).verdict, fail);
        assert_eq!([0, 1].map(|n| limits.jumps("push", n).verdict), [pass, review]);
    }

    #[test]
    fn the_looser_limit_of_landmarks_and_contours_grows_with_the_voxel() {
        let of = |mean, voxel| Limits::default().landmarks(&Summary { mean, ..Summary::default() }, voxel)[0].verdict;
        assert_eq!((of(3.9, 4.0), of(4.1, 4.0), of(2.9, 1.0)), (Mark::Review, Mark::Fail, Mark::Review));
        let of = |mean, voxel| Limits::default().agreement("cord", mean, voxel).verdict;
        assert_eq!((of(3.9, 4.0), of(4.1, 4.0), of(3.1, 1.0)), (Mark::Review, Mark::Fail, Mark::Fail));
    }

    #[test]
    fn what_has_no_inverse_is_a_share_in_percent() {
        let verdict = Limits::default().no_inverse(50, 1000);
        assert!((verdict.value - 5.0).abs() < 1e-12, "{verdict:?}");
        assert_eq!(verdict.verdict, Mark::Review);
        assert!(verdict.reason.ends_with("50 of 1000 tissue voxels"), "{verdict:?}");
        assert_eq!(Limits::default().no_inverse(1, 10_000).verdict, Mark::Pass);
        assert!(Limits::default().no_inverse(0, 0).value.abs() < 1e-12);
    }
}
