//! Material transfer function: HU to the constraints of a chain-mail element (thesis 5.1, Fig. 13).
//!
//! The numbers behind Fig. 13 are not printed. Air and rigid material are the thesis's; the soft-tissue regime of the
//! two sets is ours and documented in docs/decisions/0005-material.md.

use serde::{Deserialize, Serialize};

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

/// Rigid material (thesis 5.1).
pub const RIGID: Constraint = Constraint { min: 1.0, max: 1.0, shear: 0.0 };

/// One knot of a transfer function.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Knot {
    /// Grey value, HU for CT.
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
    /// An own table, ascending in HU.
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
            return Some("the material table has no rows".into());
        }
        if let Some(w) = knots.windows(2).find(|w| w[0].hu.partial_cmp(&w[1].hu) != Some(std::cmp::Ordering::Less)) {
            return Some(format!("material rows must ascend in HU: {} is followed by {}", w[0].hu, w[1].hu));
        }
        let legal = |c: &Constraint| {
            (0.0..=1.0).contains(&c.min) && (1.0..=10.0).contains(&c.max) && (0.0..=10.0).contains(&c.shear)
        };
        let bad = knots.iter().find(|k| !k.hu.is_finite() || !legal(&k.constraint))?;
        Some(format!(
            "material row at {} HU: 0 <= min <= 1 <= max <= 10 and 0 <= shear <= 10 must hold, found {:?}",
            bad.hu, bad.constraint
        ))
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
    fn refuses_senseless_tables() {
        let table = |k: &[Knot]| Material::Table(k.to_vec()).problem();
        assert!(table(&[]).is_some());
        assert!(table(&[knot(10.0, 0.0, 2.0, 1.0), knot(5.0, 1.0, 1.0, 0.0)]).is_some());
        assert!(table(&[knot(f32::NAN, 0.0, 2.0, 1.0)]).is_some());
        assert!(table(&[knot(0.0, 1.2, 2.0, 1.0)]).is_some());
    }
}
