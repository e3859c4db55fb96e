//! A patient whose bones have moved, and what moves his soft tissue.

use super::PlanningScan;
use super::elements::{alone_mm, bone_of_label, tissue};
use super::planning::Resting;
use crate::chainmail::{
    self, ChainMail, ChainmailOptions, Elements, ImagePull, Initiators, Lattice, LinkReport, Propagation, Tissue,
    Variant, check_links,
};
use crate::comparator::{nearest_bone, thin_plate};
use crate::config::{Config, SoftTissue};
use crate::error::{Error, Result};
use crate::field::{
    self, Beside, ConsistencyOptions, ConsistencyReport, InverseReport, MovedBones, PullField, PushField,
};
use crate::geometry::{Grid, Rigid, rotation_matrices};
use crate::progress::Silent;
use crate::refine::Images;
use crate::runtime::Runtime;
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Mask, Volume, trilinear_vector};
use nalgebra::Point3;

/// A patient whose bones have moved, in the frame that the couch has brought along.
pub(super) struct Moved<'a> {
    pub(super) scan: &'a PlanningScan,
    pub(super) skeleton: &'a Skeleton,
    pub(super) body: &'a Mask,
    pub(super) transforms: &'a [Rigid],
    pub(super) resting: &'a Resting,
    pub(super) config: &'a Config,
}

impl<'a> Moved<'a> {
    fn tissue(&self, bone_of_label: &'a [Option<u16>], options: &ChainmailOptions) -> Tissue<'a> {
        tissue(self.scan, self.body, self.resting.lung.as_ref(), self.resting.sliding.as_ref(), bone_of_label, options)
    }

    /// The links of the chain mail as the bones have left them.
    pub(super) fn links(&self, propagation: &Propagation) -> LinkReport {
        check_links(&propagation.lattice, &propagation.displacement, &rotation_matrices(self.transforms))
    }

    /// The inverse of its field on a grid of the fraction.
    pub(super) fn inverted(&self, push: &PushField, there: &Grid) -> Result<(PullField, InverseReport)> {
        let motions = self.skeleton.bones.iter().map(|b| b.label).zip(self.transforms.iter().copied());
        let bones = MovedBones::new(&self.scan.bones, motions, there);
        let (mut pull, mut report) = field::invert(push, there, Some(&bones), &self.config.invert)?;
        if let Some(region) = &self.resting.jumps {
            field::take_sides(push, &mut pull, &mut report, region, &self.config.invert);
        }
        Ok((pull, report))
    }

    /// Makes both directions of its field agree.
    pub(super) fn agree(&self, push: &mut PushField, pull: &mut PullField) -> ConsistencyReport {
        let bone_of_label = bone_of_label(self.skeleton);
        let bone = |v: usize| bone_of_label[usize::from(self.scan.bones.volume.data()[v])];
        let beside = Beside { bone: &bone, spared: &self.resting.beside_contact };
        field::agree(push, pull, &beside, &self.config.invert, &consistency_of(self.config))
    }

    fn centroids(&self) -> Vec<Point3<f64>> {
        self.skeleton.bones.iter().map(|b| b.centroid).collect()
    }
}

/// How well the fields have to agree: what the chain mail is compared with stays as it is.
fn consistency_of(config: &Config) -> ConsistencyOptions {
    let rounds = match config.soft_tissue {
        SoftTissue::ChainMail => config.consistency.rounds,
        SoftTissue::ThinPlateSplines | SoftTissue::NearestBone => 0,
    };
    ConsistencyOptions { rounds, ..config.consistency.clone() }
}

/// What bones and images make of soft tissue, element by element.
pub(super) fn elements(moved: &Moved<'_>, images: &Images<'_>) -> Result<Elements> {
    let chain_mail = moved.resting.chain_mail.as_ref();
    let chain_mail = chain_mail.ok_or_else(|| Error::Internal("the chain mail was not made".into()))?;
    let options = &moved.config.chainmail;
    let bone_of_label = bone_of_label(moved.skeleton);
    let tissue = moved.tissue(&bone_of_label, options);
    let centroids = moved.centroids();
    let bones = Initiators { transforms: moved.transforms, centroids: &centroids };
    chain_mail.elements(&tissue, &bones, options, Some(images), &Silent)
}

/// What the bones alone would have made of soft tissue, coarsely.
pub(super) fn bones_alone(chain_mail: &ChainMail, moved: &Moved<'_>) -> Result<Volume<[f32; 3]>> {
    let options = &moved.config.chainmail;
    let spacing = alone_mm(options);
    let coarse = ChainmailOptions {
        spacing_mm: spacing,
        relaxation: options.relaxation.iter().copied().filter(|r| r.spacing_mm >= spacing).collect(),
        variant: Variant { waves_mm: options.spacing_of_waves(), ..options.variant.clone() },
        ..options.clone()
    };
    let bone_of_label = bone_of_label(moved.skeleton);
    let tissue = moved.tissue(&bone_of_label, options);
    let centroids = moved.centroids();
    let bones = Initiators { transforms: moved.transforms, centroids: &centroids };
    Ok(chain_mail.elements(&tissue, &bones, &coarse, None, &Silent)?.displacement)
}

/// Carries the bones' motion to every voxel by the model that the settings name: the chain mail with the images that pull it,
/// where that is the model. With it the regions of influence, if they are asked for and the model has any.
pub(super) fn soft_tissue(
    moved: &Moved<'_>,
    images: Option<&Images<'_>>,
    runtime: &Runtime,
) -> Result<(Propagation, Option<LabelMap>)> {
    let Moved { skeleton, config, .. } = moved;
    let bone_of_label = bone_of_label(skeleton);
    let tissue = moved.tissue(&bone_of_label, &config.chainmail);
    let centroids = moved.centroids();
    let bones = Initiators { transforms: moved.transforms, centroids: &centroids };
    let push = match config.soft_tissue {
        SoftTissue::ChainMail => {
            let chain_mail = moved.resting.chain_mail.as_ref();
            let chain_mail = chain_mail.ok_or_else(|| Error::Internal("the chain mail was not made".into()))?;
            let images = images.map(|i| i as &dyn ImagePull);
            let propagation = chain_mail.propagate(&tissue, &bones, &config.chainmail, images, runtime.progress())?;
            let regions = || regions_of(&tissue, &propagation, &bones, skeleton, config);
            let regions = config.output.regions.then(regions).transpose()?;
            return Ok((propagation, regions));
        }
        SoftTissue::ThinPlateSplines => thin_plate(&tissue, &bones)?,
        SoftTissue::NearestBone => nearest_bone(&tissue, &bones)?,
    };
    // The chain mail that such a field would stretch, so that its links can be judged alike.
    let organs = chainmail::organs(&tissue, &config.chainmail)?;
    let lattice = Lattice::new(&tissue, &config.chainmail.material, &organs, config.chainmail.spacing_mm);
    let at = |n: usize| {
        let u = trilinear_vector(&push.displacement, &push.displacement.grid().index(&lattice.rest(n)));
        u.map_or([0.0; 3], |u| [u.x as f32, u.y as f32, u.z as f32])
    };
    let displacement = (0..lattice.node.len()).map(at).collect();
    Ok((Propagation { push, lattice: lattice.into(), displacement, pruning: None }, None))
}

/// The label of the bone that reaches each voxel first.
fn regions_of(
    tissue: &Tissue<'_>,
    propagation: &Propagation,
    bones: &Initiators<'_>,
    skeleton: &Skeleton,
    config: &Config,
) -> Result<LabelMap> {
    let owner = chainmail::regions(tissue, &propagation.lattice, bones, &config.chainmail.variant)?;
    let label = |o: &u16| usize::from(*o).checked_sub(1).map_or(0, |b| skeleton.bones[b].label);
    let names = skeleton.labels_and_names().into_iter().collect();
    Ok(LabelMap { volume: owner.map(label), names })
}
