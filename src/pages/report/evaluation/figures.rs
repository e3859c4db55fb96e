//! An assessment as a flat list of figures, from which every table is made.

use super::EvaluationReport;
use crate::evaluate::Assessment;
use crate::evaluate::jacobian::JacobianStats;
use crate::evaluate::regularity::Regularity;
use crate::stats::Summary;

/// One number.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Part of the evaluation, for example `contours`.
    pub part: &'static str,
    /// What it is of, for example a structure.
    pub item: String,
    /// What it is.
    pub metric: &'static str,
    /// Its value; no number where it is not known.
    pub value: f64,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
}

/// Parts in the order of the tables, with their headings.
pub(super) const PARTS: [(&str, &str); 7] = [
    ("landmarks", "Landmarks"),
    ("contours", "Contours"),
    ("bones", "Bones: departure of the field from each bone's best rigid motion"),
    ("regularity", "Regularity"),
    ("structures", "Jacobian by structure"),
    ("consistency", "Consistency"),
    ("similarity", "Image similarity"),
];

struct List(Vec<Figure>);

impl List {
    fn add(&mut self, part: &'static str, item: &str, metric: &'static str, value: f64, unit: &'static str) {
        self.0.push(Figure { part, item: item.to_owned(), metric, value, unit });
    }

    fn summary(&mut self, part: &'static str, item: &str, s: &Summary) {
        self.add(part, item, "mean", s.mean, "mm");
        self.add(part, item, "95th percentile", s.p95, "mm");
        self.add(part, item, "greatest", s.max, "mm");
    }

    fn jacobian(&mut self, part: &'static str, item: &str, j: &JacobianStats) {
        // No cells have no figures.
        let of = |v: f64| if j.cells > 0 { v } else { f64::NAN };
        self.add(part, item, "Jacobian, mean", of(j.mean), "");
        self.add(part, item, "Jacobian, 1st percentile", of(j.p1), "");
        self.add(part, item, "Jacobian, 99th percentile", of(j.p99), "");
        self.add(part, item, "Jacobian above 2", of(j.above_2_percent), "%");
        self.add(part, item, "Jacobian below 1/2", of(j.below_half_percent), "%");
        self.add(part, item, "folded cells", of(j.folded_percent), "%");
    }
}

/// Every figure of an assessment.
pub fn figures(a: &Assessment) -> Vec<Figure> {
    let mut list = List(Vec::new());
    if let Some(l) = &a.landmarks {
        list.add("landmarks", "before", "mean", l.before.mean, "mm");
        if let Some(shifted) = &l.shifted {
            list.add("landmarks", "one shift alone", "mean", shifted.mean, "mm");
        }
        list.summary("landmarks", "after", &l.after);
        list.add("landmarks", "after", "median", l.after.median, "mm");
        list.add("landmarks", "after / before", "mean of ratios (eq. 4.2)", l.mean_of_ratios, "");
        list.add("landmarks", "after / before", "standard deviation (eq. 4.3)", l.std_of_ratios, "");
        list.add("landmarks", "after / before", "ratio of means", l.ratio_of_means, "");
        list.add("landmarks", "points", "measured", l.after.n as f64, "points");
        list.add("landmarks", "points", "outside the field", (l.before.n - l.after.n) as f64, "points");
    }
    for c in &a.contours {
        list.add("contours", &c.name, "Dice", c.dice, "");
        if let Some(d) = &c.distances {
            list.add("contours", &c.name, "mean distance to agreement", d.mean_mm, "mm");
            list.add("contours", &c.name, "Hausdorff, 95th percentile", d.hausdorff_95_mm, "mm");
            list.add("contours", &c.name, "Hausdorff", d.hausdorff_mm, "mm");
            list.add("contours", &c.name, "centre of mass", d.centre_of_mass_mm, "mm");
        }
        list.add("contours", &c.name, "volume, mapped", c.mapped_ml, "ml");
        list.add("contours", &c.name, "volume, fraction", c.reference_ml, "ml");
    }
    bones(&mut list, a);
    for (direction, r) in &a.regularity {
        regularity(&mut list, direction.name(), r, a.bones_known);
    }
    if let Some((_, r)) = a.regularity.first() {
        r.structures.iter().for_each(|(name, j)| list.jacobian("structures", name, j));
    }
    for (from, c) in ["inverse consistency, from planning", "inverse consistency, from the fraction"]
        .iter()
        .zip(&a.inverse_consistency)
    {
        list.summary("consistency", from, &c.distance_mm);
        list.add("consistency", from, "chain leaves the images", c.outside as f64, "voxels");
    }
    if let Some(t) = &a.transitivity {
        list.summary("consistency", "three images", &t.distance_mm);
        list.add("consistency", "three images", "chain leaves the images", t.outside as f64, "voxels");
    }
    if let Some(s) = &a.similarity {
        for (when, s) in [("before", &s.before), ("after", &s.after)] {
            list.add("similarity", when, "normalised cross-correlation", s.ncc, "");
            list.add("similarity", when, "normalised mutual information", s.nmi, "");
            list.add("similarity", when, "mean squared difference", s.mse, "HU^2");
            list.add("similarity", when, "root mean square difference", s.rms_hu, "HU");
            list.add("similarity", when, "mean absolute difference", s.mae_hu, "HU");
        }
    }
    list.0
}

/// Of one direction. Cells between bones are counted where bones are known; the digital count of ten tetrahedra is a
/// stricter one, and bears its name.
fn regularity(list: &mut List, name: &str, r: &Regularity, bones_known: bool) {
    let mut add = |metric, value, unit| list.add("regularity", name, metric, value, unit);
    add("displacement, mean", r.displacement_mm.mean, "mm");
    add("displacement, greatest", r.displacement_mm.max, "mm");
    list.jacobian("regularity", name, &r.jacobian.body);
    let of_bones = |n: usize| if bones_known { n as f64 } else { f64::NAN };
    let of_body = |v: f64| if r.jacobian.body.cells > 0 { v } else { f64::NAN };
    let mut add = |metric, value, unit| list.add("regularity", name, metric, value, unit);
    add("least positive Jacobian", of_body(r.jacobian.body.min), "");
    add("greatest Jacobian", of_body(r.jacobian.body.max), "");
    add("folded cells, contact and interfaces included", r.jacobian.all.folded as f64, "cells");
    add("folded cells of bone contact", of_bones(r.jacobian.contact.folded), "cells");
    add("folded cells of sliding interfaces", of_bones(r.jacobian.interface.folded), "cells");
    add("digitally folded cells", r.folds.folded as f64, "cells");
    add("digitally folded volume", r.folds.folded_ml, "ml");
    add("digitally folded cells of bone contact", of_bones(r.folds.folded_contact), "cells");
    add("digitally folded cells of sliding interfaces", of_bones(r.folds.folded_interface), "cells");
    add("Jacobian jumps above 10", r.jacobian.jumps_above_10 as f64, "pairs");
    add("curl, mean", r.curl.magnitude.mean, "");
    add("curl, 95th percentile", r.curl.magnitude.p95, "");
    add("curl, greatest", r.curl.magnitude.max, "");
}

fn bones(list: &mut List, a: &Assessment) {
    if a.rigidity.is_empty() {
        return;
    }
    let n = a.rigidity.len() as f64;
    let mean = a.rigidity.iter().map(|b| b.rms_mm).sum::<f64>() / n;
    let worst = a.rigidity.iter().map(|b| b.max_mm).fold(0.0, f64::max);
    list.add("bones", "all bones", "mean of root mean squares", mean, "mm");
    list.add("bones", "all bones", "greatest", worst, "mm");
    for b in &a.rigidity {
        list.add("bones", &b.name, "root mean square", b.rms_mm, "mm");
        list.add("bones", &b.name, "greatest", b.max_mm, "mm");
    }
}

/// A row of a table: what it is, and its value for each field.
pub(super) struct FigureRow {
    pub(super) item: String,
    pub(super) metric: String,
    pub(super) values: Vec<String>,
}

/// The rows of one part, fields side by side.
pub(super) fn rows(report: &EvaluationReport, part: &str) -> Vec<FigureRow> {
    let lists: Vec<Vec<Figure>> = report.fields.iter().map(|f| figures(&f.assessment)).collect();
    let mut keys: Vec<(&str, &str, &str)> = Vec::new();
    for f in lists.iter().flatten().filter(|f| f.part == part) {
        if !keys.contains(&(&f.item, f.metric, f.unit)) {
            keys.push((&f.item, f.metric, f.unit));
        }
    }
    let value = |list: &[Figure], (item, metric, unit): (&str, &str, &str)| {
        let found = list.iter().find(|f| f.part == part && f.item == item && f.metric == metric);
        found.map_or("\u{2013}".to_owned(), |f| number(f.value, unit))
    };
    keys.iter()
        .map(|key| FigureRow {
            item: key.0.to_owned(),
            metric: if key.2.is_empty() { key.1.to_owned() } else { format!("{}, {}", key.1, key.2) },
            values: lists.iter().map(|list| value(list, *key)).collect(),
        })
        .collect()
}

/// A number with as many digits as it deserves.
pub(super) fn number(value: f64, unit: &str) -> String {
    let size = value.abs();
    match unit {
        _ if !value.is_finite() => "\u{2013}".into(),
        "cells" | "voxels" | "pairs" | "points" | "warning" | "warnings" => format!("{value:.0}"),
        _ if size == 0.0 => "0".into(),
        _ if size < 0.001 => format!("{value:.1e}"),
        _ if size < 10.0 => format!("{value:.3}"),
        _ => format!("{value:.1}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One count of each kind has its own name, and what is not known is no number.
    #[test]
    fn folds_between_bones_are_counted_as_the_verdict_counts_them() {
        let mut r = Regularity::default();
        (r.jacobian.all.folded, r.jacobian.contact.folded, r.folds.folded_contact) = (209, 205, 227);
        let told = |known: bool| {
            let mut list = List(Vec::new());
            regularity(&mut list, "there", &r, known);
            let of =
                |metric: &str| list.0.iter().find(|f| f.metric == metric).map(|f| number(f.value, f.unit)).unwrap();
            ["folded cells of bone contact", "digitally folded cells of bone contact", "Jacobian, mean"].map(of)
        };
        assert_eq!(told(true), ["205", "227", "\u{2013}"]);
        assert_eq!(told(false), ["\u{2013}"; 3]);
    }

    #[test]
    fn numbers_have_the_digits_they_deserve() {
        let shown =
            [(0.0, "mm"), (12.0, "cells"), (6.0, "warnings"), (5.4e-7, "mm"), (0.123_45, "mm"), (123.456, "HU")];
        assert_eq!(shown.map(|(v, u)| number(v, u)), ["0", "12", "6", "5.4e-7", "0.123", "123.5"]);
    }
}
