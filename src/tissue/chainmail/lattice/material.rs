//! Material transfer function: grey value to the constraints of a chain-mail element (thesis 5.1, Fig. 13), and own
//! constraints of organs.
//!
//! The numbers behind Fig. 13 are not printed. Air and rigid material are the thesis's; the soft-tissue regime of the
//! two sets is ours and documented in docs/decisions/chain-mail.md.

use crate::error::{Error, Result};
use crate::volume::LabelMap;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Constraints of one element, relative to the rest length of a link.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Constraint {
    /// Least length.
    pub min: f32,
    /// Greatest length.
    pub max: f32,
    /// Greatest sideways shift.
    pub shear: f32,
}

impl Constraint {
    /// A link's constraint: the mean of its two elements' (thesis 2.4).
    pub fn mean(self, other: Self) -> Self {
        Self {
            min: 0.5 * (self.min + other.min),
            max: 0.5 * (self.max + other.max),
            shear: 0.5 * (self.shear + other.shear),
        }
    }
}

impl Constraint {
    /// What is wrong with these values, if anything.
    pub fn problem(&self) -> Option<String> {
        let legal =
            (0.0..=1.0).contains(&self.min) && (1.0..=10.0).contains(&self.max) && (0.0..=10.0).contains(&self.shear);
        (!legal).then(|| {
            format!(
                "0 <= min <= 1 <= max <= 10 and 0 <= shear <= 10 must hold, found min {}, max {}, shear {}",
                self.min, self.max, self.shear
            )
        })
    }
}

/// Rigid material (thesis 5.1).
pub const RIGID: Constraint = Constraint { min: 1.0, max: 1.0, shear: 0.0 };

/// One knot of a transfer function.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Knot {
    /// Grey value: HU for CT; `value` is another name of this key, for images of other kinds.
    #[serde(alias = "value")]
    pub hu: f32,
    /// Constraint there.
    #[serde(flatten)]
    pub constraint: Constraint,
}

/// A material transfer function: piecewise linear between its knots, constant beyond them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Material {
    /// A named set.
    Named(MaterialName),
    /// An own table, ascending in grey value.
    Table(Vec<Knot>),
}

/// The two sets of the thesis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaterialName {
    /// Soft tissue deforms little.
    Stiff,
    /// Soft tissue deforms easily.
    Elastic,
}

const fn knot(hu: f32, min: f32, max: f32, shear: f32) -> Knot {
    Knot { hu, constraint: Constraint { min, max, shear } }
}

/// Air below -500 HU, rigid from 250 HU; soft tissue from 40 % to 10 % of a link between fat and dense muscle.
/// The thesis prints the end points alone; these and the next were set before any result was seen.
const STIFF: [Knot; 5] = [
    knot(-500.0, 0.0, 2.0, 1.0),
    knot(-200.0, 0.6, 1.4, 0.4),
    knot(0.0, 0.75, 1.25, 0.25),
    knot(150.0, 0.9, 1.1, 0.1),
    knot(250.0, 1.0, 1.0, 0.0),
];
/// As stiff, with twice the play in soft tissue.
const ELASTIC: [Knot; 5] = [
    knot(-500.0, 0.0, 2.0, 1.0),
    knot(-200.0, 0.2, 1.8, 0.8),
    knot(0.0, 0.5, 1.5, 0.5),
    knot(150.0, 0.8, 1.2, 0.2),
    knot(250.0, 1.0, 1.0, 0.0),
];

impl Default for Material {
    fn default() -> Self {
        Self::Named(MaterialName::Stiff)
    }
}

impl Material {
    /// The knots.
    pub fn knots(&self) -> &[Knot] {
        match self {
            Self::Named(MaterialName::Stiff) => &STIFF,
            Self::Named(MaterialName::Elastic) => &ELASTIC,
            Self::Table(knots) => knots,
        }
    }

    /// What is wrong with an own table, if anything.
    pub fn problem(&self) -> Option<String> {
        let knots = self.knots();
        if knots.is_empty() {
            return Some("chainmail.material: the table has no rows".into());
        }
        if let Some(w) = knots.windows(2).find(|w| w[0].hu.partial_cmp(&w[1].hu) != Some(std::cmp::Ordering::Less)) {
            return Some(format!(
                "chainmail.material: rows must ascend in grey value, but {} is followed by {}",
                w[0].hu, w[1].hu
            ));
        }
        knots.iter().find_map(|k| {
            let problem = if k.hu.is_finite() { k.constraint.problem()? } else { "it is not a finite number".into() };
            Some(format!("chainmail.material, row at grey value {}: {problem}", k.hu))
        })
    }

    /// Constraint at a grey value.
    pub fn at(&self, hu: f32) -> Constraint {
        let knots = self.knots();
        let next = knots.partition_point(|k| k.hu <= hu);
        if next == 0 || next == knots.len() {
            return knots[next.saturating_sub(1)].constraint;
        }
        let (a, b) = (knots[next - 1], knots[next]);
        let t = (hu - a.hu) / (b.hu - a.hu);
        let mix = |x: f32, y: f32| x + t * (y - x);
        let (a, b) = (a.constraint, b.constraint);
        Constraint { min: mix(a.min, b.min), max: mix(a.max, b.max), shear: mix(a.shear, b.shear) }
    }
}

/// The label of an organ that a setting names; bones are those labels for which `is_bone` holds.
///
/// # Errors
/// [`Error::Usage`] when no label has the name, or it is a bone's.
pub fn organ_label(setting: &str, name: &str, labels: &LabelMap, is_bone: impl Fn(u16) -> bool) -> Result<u16> {
    let Some((&label, _)) = labels.names.iter().find(|(_, n)| *n == name) else {
        let others: Vec<&str> = labels.names.iter().filter(|(l, _)| !is_bone(**l)).map(|(_, n)| n.as_str()).collect();
        return Err(Error::usage(
            format!("{setting}.{name}: no label has this name"),
            if others.is_empty() {
                "the label map names bones only; add the organ to it, give it with --organs, or leave the setting out"
                    .to_owned()
            } else {
                format!("the labels that are no bones are {}", others.join(", "))
            },
        ));
    };
    if is_bone(label) {
        let problem = format!("{setting}.{name}: this label is a bone, and bones are rigid");
        return Err(Error::usage(problem, "name soft organs only"));
    }
    Ok(label)
}

/// Own constraints by label number, in place of the transfer function.
#[derive(Debug, Clone, Default)]
pub struct Organs(BTreeMap<u16, Constraint>);

impl Organs {
    /// Finds the labels of these names; bones are those labels for which `is_bone` holds.
    ///
    /// # Errors
    /// [`Error::Usage`] when no label has a name, or it is a bone's.
    pub fn new(named: &BTreeMap<String, Constraint>, labels: &LabelMap, is_bone: impl Fn(u16) -> bool) -> Result<Self> {
        let mut found = BTreeMap::new();
        for (name, constraint) in named {
            found.insert(organ_label("chainmail.organs", name, labels, &is_bone)?, *constraint);
        }
        Ok(Self(found))
    }

    /// Constraint of a label, if it has its own.
    pub fn of(&self, label: u16) -> Option<Constraint> {
        self.0.get(&label).copied()
    }

    /// Whether no organ has its own.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knots_air_and_bone_are_the_thesis_values() {
        for name in [MaterialName::Stiff, MaterialName::Elastic] {
            let m = Material::Named(name);
            assert_eq!(m.problem(), None);
            assert_eq!(m.at(-900.0), Constraint { min: 0.0, max: 2.0, shear: 1.0 });
            assert_eq!(m.at(1500.0), RIGID);
            let soft = m.at(-100.0);
            assert!((soft.shear - 0.5 * (m.at(-200.0).shear + m.at(0.0).shear)).abs() < 1e-6);
        }
    }

    #[test]
    fn organs_are_found_by_name_and_wrong_names_refused() {
        let grid = crate::geometry::Grid::axis_aligned([4; 3], [1.0; 3], [0.0; 3]).unwrap();
        let names = [(1, "skull"), (7, "tongue")].map(|(l, n)| (l, n.to_owned())).into();
        let labels = LabelMap { volume: crate::volume::Volume::filled(grid, 0), names };
        let soft = Constraint { min: 0.1, max: 2.0, shear: 0.9 };
        let organs = |name: &str| Organs::new(&[(name.to_owned(), soft)].into(), &labels, |l| l == 1);
        let tongue = organs("tongue").unwrap();
        assert_eq!((tongue.of(7), tongue.of(1)), (Some(soft), None));
        for (name, text) in [("tounge", "tongue"), ("skull", "rigid")] {
            let error = organs(name).unwrap_err();
            assert!(error.to_string().contains(text) && error.to_string().contains(name), "{error}");
        }
    }

    #[test]
    fn an_own_table_serves_other_grey_values_than_hu() {
        let rows = "[[rows]]\nvalue = 40.0\nmin = 0.5\nmax = 1.5\nshear = 0.5\n[[rows]]\nvalue = 900.0\nmin = 1.0\nmax = 1.0\nshear = 0.0\n";
        #[derive(Deserialize)]
        struct Rows {
            rows: Material,
        }
        let mr = toml::from_str::<Rows>(rows).unwrap().rows;
        assert_eq!((mr.problem(), mr.at(2000.0)), (None, RIGID));
        assert!((mr.at(470.0).shear - 0.25).abs() < 1e-6);
        let bad = Material::Table(vec![knot(300.0, 1.2, 2.0, 1.0)]).problem().unwrap();
        assert!(bad.contains("grey value 300") && !bad.contains("HU"), "{bad}");
    }

    #[test]
    fn refuses_senseless_tables() {
        let table = |k: &[Knot]| Material::Table(k.to_vec()).problem();
        assert!(table(&[]).is_some());
        assert!(table(&[knot(10.0, 0.0, 2.0, 1.0), knot(5.0, 1.0, 1.0, 0.0)]).is_some());
        assert!(table(&[knot(f32::NAN, 0.0, 2.0, 1.0)]).is_some());
        assert!(table(&[knot(0.0, 1.2, 2.0, 1.0)]).is_some());
    }
}
