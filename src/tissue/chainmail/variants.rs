//! The thesis's variants, all behind one type: the choices by which one chain mail becomes another. A front's links, what it does
//! first, what bones hand on, how waves add up, what pulls in the relaxation. What a case may ask for stands in `options`.

use serde::{Deserialize, Serialize};

/// Which chain mail of the thesis it is, or which beyond it: `[chainmail.variant]` of the settings. The default is what measures
/// best (docs/decisions/chain-mail.md); other values are for `aventail study` and for comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Variant {
    /// Which element is processed next.
    pub order: Order,
    /// Time along a link.
    pub link_time: LinkTime,
    /// Links that a front runs along.
    pub front: Front,
    /// Averaging along wave fronts around initiating structures.
    pub structures: Structures,
    /// What a bone hands to the tissue around it.
    pub carry: Carry,
    /// How several bones act together.
    pub combination: Combination,
    /// Exponent n of the superposition's weights t^-n.
    pub exponent: f64,
    /// Times beyond this have no influence, mm of link at relative shear 1 (thesis 5.4.2: 800 links of 0.98 mm).
    pub cutoff: f64,
    /// A bone's wave is pruned where it comes this many times later than the first one, there and wherever it would go
    /// from there: it weighs less than this ratio to the power -n of the first. 0 for none (exact).
    pub prune_ratio: f64,
    /// Waves run through elements of this spacing, mm, or through those of the chain mail where they are finer; elements of other
    /// spacings take what waves bring there. 0 for the planning grid itself.
    pub waves_mm: f64,
    /// What pulls the elements in the relaxation.
    pub elasticity: Elasticity,
}

impl Default for Variant {
    fn default() -> Self {
        Self {
            order: Order::Timestamps,
            link_time: LinkTime::SlowInStiff,
            front: Front::Round,
            structures: Structures::None,
            carry: Carry::Rigid,
            combination: Combination::Superposition,
            exponent: 4.0,
            cutoff: 800.0 * 0.98,
            prune_ratio: 16.0,
            waves_mm: 5.0,
            elasticity: Elasticity::Corotated,
        }
    }
}

impl Variant {
    /// The waves of the thesis's final model (6.1.7): timestamps, linear decay, superposition t^-4.
    /// Stiff tissue is fast, as the thesis's text and Fig. 14 have it (docs/decisions/thesis.md).
    pub fn thesis() -> Self {
        Self {
            link_time: LinkTime::FastInStiff,
            front: Front::Rhombus,
            carry: Carry::LinearDecay,
            cutoff: 800.0,
            prune_ratio: 0.0,
            ..Self::default()
        }
    }

    /// The first impossible choice, if any, with its key.
    pub(super) fn problem(&self) -> Option<String> {
        let checks = [
            within("variant.exponent", self.exponent, 0.1, 64.0),
            within("variant.cutoff", self.cutoff, 1e-3, 1e6),
            within("variant.prune_ratio", self.prune_ratio, 0.0, 1e6),
            within("variant.waves_mm", self.waves_mm, 0.0, 50.0),
            (self.structures != Structures::None && self.order != Order::Timestamps).then(|| {
                "chainmail.variant.structures averages along wave fronts, which needs chainmail.variant.order = \"timestamps\""
                    .to_owned()
            }),
        ];
        checks.into_iter().flatten().next()
    }
}

/// What is wrong with a setting of the chain mail that must lie between two numbers, if anything.
pub(super) fn within(name: &str, value: f64, low: f64, high: f64) -> Option<String> {
    let bad = !(low..=high).contains(&value);
    bad.then(|| format!("chainmail.{name} is {value}: it must lie in [{low}, {high}]"))
}

/// How the waves of several bones become one displacement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Combination {
    /// Every bone's wave runs through all tissue; displacements are averaged with weights t^-n (thesis 5.4.2, eq. 5.7).
    #[default]
    Superposition,
    /// One wave from all bones: each element follows the bone that reaches it first (thesis 5.4.1).
    #[serde(alias = "prioritization")]
    Prioritisation,
}

/// How long a front takes along a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkTime {
    /// Length / shear: stiff tissue is slow (thesis eq. in 5.2.2, in units of length so that spacing does not matter).
    #[default]
    SlowInStiff,
    /// Length * shear: stiff tissue is fast (the text of thesis 2.4 and Fig. 14).
    FastInStiff,
    /// 1 / (length * shear): eq. in 5.2.2 to the letter, whose constraints are multiplied by the link's length.
    Literal,
}

/// Which links a front runs along.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Front {
    /// 26 links, each by its length: at most 13 % too long on cubes, 9 % on the mean; 25 and 16 % on voxels three times as high.
    #[default]
    Round,
    /// 6 links: rhombus fronts (thesis Fig. 14, 15).
    Rhombus,
}

/// Which element is processed next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// Least time along the path first (thesis 5.2.2).
    #[default]
    Timestamps,
    /// Largest constraint violation first: the enhanced chain mail (thesis 5.2.1, eq. 2.7).
    ConstraintViolation,
    /// First moved, first processed: the original chain mail, for homogeneous material (thesis 2.4).
    FirstMoved,
}

/// Sorting criteria after the time, with averaging along wave fronts (thesis 5.5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Structures {
    /// Time only: an element takes what arrives first.
    #[default]
    None,
    /// Elements with more informations first, averaged by eq. 5.9-5.10: cures L-shapes.
    SecondCriterion,
    /// Then elements nearest along the front to where informations first met: cures U-shapes.
    ThirdCriterion,
}

/// What a bone hands to the tissue around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Carry {
    /// Its rigid motion, undiminished: the blend of several bones does the rest.
    #[default]
    Rigid,
    /// The displacement of each of its elements as a translation, reduced by the play of each link: the chain mail
    /// without rotation (thesis 2.4).
    Translation,
    /// An orientation whose valid regions turn with it and limit both position and angle (thesis 5.3.1, eq. 5.1-5.2).
    ConstraintBased,
    /// Its translation, reduced by the play of each link, and its rotation about the bone's centroid with linear decay
    /// (thesis 5.3.2, eq. 5.3-5.6, on displacements so that the bone itself moves exactly).
    LinearDecay,
}

/// What pulls the elements in the relaxation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Elasticity {
    /// 26 links that turn with the tissue, stiffer where their play is less.
    #[default]
    Corotated,
    /// 6 equal links that do not turn: an element moves to the mean of the places where its neighbours want it.
    Gibson,
    /// 6 links that do not turn, stiffer where their play is less.
    Heterogeneous,
}
