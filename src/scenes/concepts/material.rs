//! Thesis Fig. 13: material transfer functions.

use super::{Content, Curves, Figure, Panel, Series};
use crate::chainmail::{Material, MaterialName};

/// Least and greatest length and shear of a material over the grey value, as one plot.
pub fn transfer_functions(material: &Material) -> Curves {
    curves(&[("", material)], &[("min", 0), ("max", 1), ("shear", 2)])
}

/// Lines of the parts (0 min, 1 max, 2 shear) of each material; materials of several parts are told apart by colour.
fn curves(materials: &[(&str, &Material)], parts: &[(&str, usize)]) -> Curves {
    let ends = |m: &Material| m.knots().first().zip(m.knots().last()).map(|(a, b)| (a.hu, b.hu));
    let (low, high) = materials
        .iter()
        .filter_map(|(_, m)| ends(m))
        .fold((f32::MAX, f32::MIN), |(low, high), (a, b)| (low.min(a), high.max(b)));
    let margin = 0.15 * (high - low).max(1.0);
    let series = materials.iter().enumerate().flat_map(|(n, (name, material))| {
        let knots = std::iter::once(low - margin)
            .chain(material.knots().iter().map(|k| k.hu))
            .chain(std::iter::once(high + margin));
        let grey: Vec<f32> = knots.collect();
        parts.iter().map(move |&(part_name, part)| {
            let value = |c: crate::chainmail::Constraint| [c.min, c.max, c.shear][part];
            Series {
                name: [*name, part_name].iter().filter(|s| !s.is_empty()).copied().collect::<Vec<_>>().join(" "),
                colour: if materials.len() > 1 { 3 * n + part.min(1) } else { part },
                marks: false,
                points: grey.iter().map(|&g| [f64::from(g), f64::from(value(material.at(g)))]).collect(),
            }
        })
    });
    Curves { x: "grey value (HU for CT)".into(), y: "times rest length".into(), series: series.collect() }
}

pub(super) fn figure() -> Figure {
    let (stiff, elastic) = (Material::Named(MaterialName::Stiff), Material::Named(MaterialName::Elastic));
    let both = [("stiff", &stiff), ("elastic", &elastic)];
    Figure {
        name: "fig13_material",
        title: "Material transfer functions (thesis Fig. 13)",
        caption: "Least and greatest length of a link and its shear by grey value. Air and bone are the same in both sets.",
        panels: vec![
            Panel::new("(a) compression and extension", Content::Curves(curves(&both, &[("min", 0), ("max", 1)]))),
            Panel::new("(b) shear", Content::Curves(curves(&both, &[("", 2)]))),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_pass_through_the_knots() {
        let material = Material::Named(MaterialName::Stiff);
        let plot = transfer_functions(&material);
        assert_eq!(plot.series.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["min", "max", "shear"]);
        for k in material.knots() {
            let values = [k.constraint.min, k.constraint.max, k.constraint.shear];
            for (series, v) in plot.series.iter().zip(values) {
                assert!(series.points.contains(&[f64::from(k.hu), f64::from(v)]), "{} at {}", series.name, k.hu);
            }
        }
    }
}
