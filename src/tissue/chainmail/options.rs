//! Settings of the chain mail: the one place where a variant is chosen.

use super::lattice::material::{Constraint, Material};
use super::lattice::slip::SlipOptions;
use super::relaxation::growth::VolumeChange;
use super::variants::{Carry, Elasticity, Front, LinkTime, Order, Structures};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

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

/// How bone motion is carried to soft tissue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ChainmailOptions {
    /// Material transfer function.
    pub material: Material,
    /// Own constraints of label names that are not bones, instead of the transfer function.
    pub organs: BTreeMap<String, Constraint>,
    /// Organs whose volume in the fraction is known to differ; they start deformation as bones do.
    pub volume_change: Vec<VolumeChange>,
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
    /// Waves run through elements of this spacing, mm, or through those of `spacing_mm` where they are finer; elements
    /// of other spacings take what waves bring there. 0 for the planning grid itself.
    pub waves_mm: f64,
    /// Spacing of the elements, mm; 0 for the planning grid itself.
    pub spacing_mm: f64,
    /// What pulls the elements in the relaxation.
    pub elasticity: Elasticity,
    /// Poisson's ratio of tissue under the corotated relaxation, 0 to 0.49: links alone have 0; more makes them give way to
    /// changes of shape and not of volume.
    pub poisson: f64,
    /// Spacings of the relaxation, coarse to fine, mm, and rounds at each; empty for none.
    pub relaxation: Vec<(f64, usize)>,
    /// Attempts to unfold what is folded on the full grid; 0 for none.
    pub mend: usize,
    /// Voxels below this grey value take no part, HU for CT.
    pub least_hu: f32,
    /// Whether lung takes part, whatever its HU.
    pub lung: bool,
    /// What slides along the wall of chest and belly; only links of the corotated kind do.
    pub slip: SlipOptions,
}

impl Default for ChainmailOptions {
    fn default() -> Self {
        Self {
            material: Material::default(),
            organs: BTreeMap::new(),
            volume_change: Vec::new(),
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
            spacing_mm: 4.5,
            elasticity: Elasticity::Corotated,
            poisson: 0.38,
            relaxation: vec![(18.0, 40), (9.0, 30), (4.5, 10)],
            mend: 3,
            least_hu: -500.0,
            lung: true,
            slip: SlipOptions::default(),
        }
    }
}

impl ChainmailOptions {
    /// The thesis's final model (6.1.7): timestamps, linear decay, superposition t^-4, stiff, every voxel an element.
    /// Stiff tissue is fast, as the thesis's text and Fig. 14 have it (docs/decisions/thesis.md).
    pub fn thesis() -> Self {
        Self {
            link_time: LinkTime::FastInStiff,
            front: Front::Rhombus,
            carry: Carry::LinearDecay,
            cutoff: 800.0,
            prune_ratio: 0.0,
            spacing_mm: 0.0,
            relaxation: Vec::new(),
            mend: 0,
            lung: false,
            slip: SlipOptions::none(),
            ..Self::default()
        }
    }

    /// Whether elements of a spacing (mm) are relaxed.
    pub(super) fn relaxes(&self, spacing: f64) -> bool {
        let same = |other: f64| (other - spacing).abs() < f64::EPSILON;
        self.relaxation.iter().any(|r| same(r.0) || (same(self.spacing_mm) && r.0 <= self.spacing_mm))
    }

    /// Spacing of the elements that waves run through, mm.
    pub fn spacing_of_waves(&self) -> f64 {
        self.waves_mm.min(self.spacing_mm)
    }

    /// Whether these settings say something about an organ.
    pub fn names_organ(&self, name: &str) -> bool {
        self.all_organs().any(|organ| organ == name)
    }

    /// The organs that these settings say something about, each once.
    pub fn organs_named(&self) -> Vec<String> {
        self.all_organs().cloned().collect::<BTreeSet<_>>().into_iter().collect()
    }

    fn all_organs(&self) -> impl Iterator<Item = &String> {
        let changed = self.volume_change.iter().map(|c| &c.organ);
        self.organs.keys().chain(&self.slip.organs).chain(changed)
    }

    /// The first impossible choice in these settings, if any, with its key.
    pub fn problem(&self) -> Option<String> {
        let within = |name: &str, value: f64, low: f64, high: f64| {
            let bad = !(low..=high).contains(&value);
            bad.then(|| format!("chainmail.{name} is {value}: it must lie in [{low}, {high}]"))
        };
        let averaging = self.structures != Structures::None;
        let checks = [
            within("exponent", self.exponent, 0.1, 64.0),
            within("cutoff", self.cutoff, 1e-3, 1e6),
            within("prune_ratio", self.prune_ratio, 0.0, 1e6),
            within("waves_mm", self.waves_mm, 0.0, 50.0),
            within("poisson", self.poisson, 0.0, 0.49),
            within("slip.along", self.slip.along, 1e-3, 1.0),
            within("spacing_mm", self.spacing_mm, 0.0, 50.0),
            self.relaxation.iter().find_map(|r| within("relaxation: a spacing", r.0, 0.0, 100.0)),
            within("least_hu", f64::from(self.least_hu), -2000.0, 65535.0),
            (averaging && self.order != Order::Timestamps).then(|| {
                "chainmail.structures averages along wave fronts, which needs chainmail.order = \"timestamps\""
                    .to_owned()
            }),
            self.material.problem(),
            self.volume_change.iter().find_map(VolumeChange::problem),
            (!self.volume_change.is_empty()
                && (self.relaxation.is_empty() || self.elasticity != Elasticity::Corotated))
                .then(|| {
                    "chainmail.volume_change works through the corotated relaxation: chainmail.relaxation must not be empty \
                     and chainmail.elasticity must be \"corotated\""
                        .to_owned()
                }),
            self.organs.iter().find_map(|(name, c)| Some(format!("chainmail.organs.{name}: {}", c.problem()?))),
        ];
        checks.into_iter().flatten().next()
    }
}
