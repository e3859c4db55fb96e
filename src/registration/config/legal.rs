//! Which settings are legal: each refusal names the key, its value and what it must be.

use super::settings::{Config, SoftTissue};
use crate::fit::Resolution;

impl Config {
    /// What is impossible in these settings, if anything.
    pub fn problem(&self) -> Option<String> {
        let (f, b) = (&self.fit, &self.body);
        let r = &self.refine;
        let within = |name: &str, value: f64, low: f64, high: f64| {
            let bad = !(low..=high).contains(&value);
            bad.then(|| format!("{name} is {value}: it must lie in [{low}, {high}]"))
        };
        let levels = |name: &str, list: &[Resolution]| {
            let bad = list.iter().any(|l| !(0.0..=50.0).contains(&l.blur_mm) || l.samples == 0);
            let list: Vec<(f64, usize)> = list.iter().map(|l| (*l).into()).collect();
            bad.then(|| format!("{name} is {list:?}: pairs of a blur in [0, 50] mm and samples above 0 are needed"))
        };
        let count = |name: &str, n: usize| (n == 0).then(|| format!("{name} is 0: it must be above 0"));
        let checks = [
            f.levels.is_empty().then(|| "fit.levels is []: at least one (blur mm, samples) pair is needed".to_owned()),
            levels("fit.levels", &f.levels),
            levels("fit.outward", &f.outward),
            count("fit.max_iterations", usize::try_from(f.max_iterations).unwrap_or(usize::MAX)),
            self.chainmail.problem(),
            self.sliding.problem(),
            (self.soft_tissue != SoftTissue::ChainMail && !self.chainmail.volume_change.is_empty())
                .then(|| "chainmail.volume_change needs soft_tissue = \"chain-mail\"".to_owned()),
            self.region.problem(),
            self.couch.problem(),
            within("refine.weight", r.weight, 0.0, 1e6),
            count("refine.passes", r.passes),
            count("refine.rounds", r.rounds),
            within("refine.blur", r.blur, 0.0, 10.0),
            within("refine.least_blur", r.least_blur, 0.0, 10.0),
            within("refine.settled", r.settled, 0.0, 10.0),
            within("refine.robust", r.robust, 0.1, 1e6),
            within("refine.departure", r.departure, 1e-4, 1e6),
            within("refine.shading.least_hu", r.shading.least_hu, 0.0, 1e6),
            within("refine.shading.least_gain", r.shading.least_gain, 0.0, 10.0),
            within("refine.skin.weight", r.skin.weight, 0.0, 1e6),
            within("refine.guide.weight", r.guide.weight, 0.0, 1e6),
            within(
                "refine.window_hu, its lower end",
                f64::from(r.window_hu[0]),
                -2000.0,
                f64::from(r.window_hu[1]) - 1.0,
            ),
            within("refine.window_hu, its upper end", f64::from(r.window_hu[1]), -1999.0, 65535.0),
            within("invert.tolerance_mm", self.invert.tolerance_mm, 1e-9, 10.0),
            count("invert.max_iterations", self.invert.max_iterations),
            within("consistency.limit_mm", self.consistency.limit_mm, 0.01, 100.0),
            self.verdict.problem(),
            within("output.gzip_level", f64::from(self.output.gzip_level), 0.0, 9.0),
            within("body.threshold_hu", b.threshold_hu, -2000.0, 3000.0),
            within("body.opening_mm", b.opening_mm, 0.0, 100.0),
            within("body.separation_mm", b.separation_mm, 0.0, 100.0),
            within("body.closing_mm", b.closing_mm, 0.0, 100.0),
        ];
        checks.into_iter().flatten().next()
    }
}
