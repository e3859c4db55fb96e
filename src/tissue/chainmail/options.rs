//! Settings of the chain mail: what a case may ask for, and the [`Variant`].

use super::lattice::material::{Constraint, Material};
use super::lattice::slip::SlipOptions;
use super::relaxation::growth::VolumeChange;
use super::variants::{Elasticity, Variant, within};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// One level of the relaxation; in settings a pair.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "(f64, usize)", into = "(f64, usize)")]
pub struct RelaxationLevel {
    /// Spacing of the elements, mm.
    pub spacing_mm: f64,
    /// Rounds over all of them.
    pub rounds: usize,
}

impl From<(f64, usize)> for RelaxationLevel {
    fn from((spacing_mm, rounds): (f64, usize)) -> Self {
        Self { spacing_mm, rounds }
    }
}

impl From<RelaxationLevel> for (f64, usize) {
    fn from(level: RelaxationLevel) -> Self {
        (level.spacing_mm, level.rounds)
    }
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
    /// Spacing of the elements, mm; 0 for the planning grid itself.
    pub spacing_mm: f64,
    /// Poisson's ratio of tissue under the corotated relaxation, 0 to 0.49: links alone have 0; more makes them give way to
    /// changes of shape and not of volume.
    pub poisson: f64,
    /// Levels of the relaxation, coarse to fine; empty for none.
    pub relaxation: Vec<RelaxationLevel>,
    /// Attempts to unfold what is folded on the full grid; 0 for none.
    pub mend: usize,
    /// Voxels below this grey value take no part, HU for CT.
    pub least_hu: f32,
    /// Whether lung takes part, whatever its HU.
    pub lung: bool,
    /// What slides along the wall of chest and belly; only links of the corotated kind do.
    pub slip: SlipOptions,
    /// Which of the thesis's chain mails it is: nothing that a case asks for.
    pub variant: Variant,
}

impl Default for ChainmailOptions {
    fn default() -> Self {
        Self {
            material: Material::default(),
            organs: BTreeMap::new(),
            volume_change: Vec::new(),
            spacing_mm: 4.5,
            poisson: 0.38,
            relaxation: [(18.0, 40), (9.0, 30), (4.5, 10)].map(RelaxationLevel::from).into(),
            mend: 3,
            least_hu: -500.0,
            lung: true,
            slip: SlipOptions::default(),
            variant: Variant::default(),
        }
    }
}

impl ChainmailOptions {
    /// The thesis's final model (6.1.7): [`Variant::thesis`], stiff tissue, every voxel an element, nothing beyond it.
    pub fn thesis() -> Self {
        Self {
            spacing_mm: 0.0,
            relaxation: Vec::new(),
            mend: 0,
            lung: false,
            slip: SlipOptions::none(),
            variant: Variant::thesis(),
            ..Self::default()
        }
    }

    /// Whether elements of a spacing (mm) are relaxed.
    pub(super) fn relaxes(&self, spacing: f64) -> bool {
        let same = |other: f64| (other - spacing).abs() < f64::EPSILON;
        self.relaxation.iter().any(|r| same(r.spacing_mm) || (same(self.spacing_mm) && r.spacing_mm <= self.spacing_mm))
    }

    /// Spacing of the elements that waves run through, mm.
    pub fn spacing_of_waves(&self) -> f64 {
        self.variant.waves_mm.min(self.spacing_mm)
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
        let checks = [
            self.variant.problem(),
            within("poisson", self.poisson, 0.0, 0.49),
            within("slip.along", self.slip.along, 1e-3, 1.0),
            within("slip.lung_alone", self.slip.lung_alone, 1e-3, 1.0),
            within("spacing_mm", self.spacing_mm, 0.0, 50.0),
            self.relaxation.iter().find_map(|r| within("relaxation: a spacing", r.spacing_mm, 0.0, 100.0)),
            within("least_hu", f64::from(self.least_hu), -2000.0, 65535.0),
            self.material.problem(),
            self.volume_change.iter().find_map(VolumeChange::problem),
            (!self.volume_change.is_empty()
                && (self.relaxation.is_empty() || self.variant.elasticity != Elasticity::Corotated))
                .then(|| {
                    "chainmail.volume_change works through the corotated relaxation: chainmail.relaxation must not be empty \
                     and chainmail.variant.elasticity must be \"corotated\""
                        .to_owned()
                }),
            self.organs.iter().find_map(|(name, c)| Some(format!("chainmail.organs.{name}: {}", c.problem()?))),
        ];
        checks.into_iter().flatten().next()
    }
}
