//! Rank 8: analytic head, neck and shoulders with known truth, for the demo and for tests.
//!
//! [`Anatomy`] is a function of position: signed-distance solids for 42 named bones, soft tissue,
//! airway and couch; its two sides differ by some millimetres, as people's do. [`TrueMotion`]
//! moves it: bones exactly rigid, posed joint by joint with the phantom's true skeleton, soft
//! tissue by a model that is neither the chain mail nor its relaxation. [`Phantom`] holds the
//! images of both. [`Breathing`] is a chest whose lungs slide in their pleura, and [`degrade`]
//! makes a cone-beam CT of any CT.

mod anatomy;
mod asymmetry;
mod breathing;
mod build;
mod case;
mod cbct;
mod cells;
mod head_bones;
mod head_tissue;
mod joints;
mod landmarks;
mod lattice;
mod motion;
mod options;
mod outline;
mod plan;
mod posture;
mod render;
mod shape;
mod solid;
mod spine;
mod synthetic;
mod texture;
mod trunk_bones;
mod trunk_tissue;
mod voxel;

pub use anatomy::{Anatomy, Sample};
pub use breathing::{Breathing, BreathingMotion, BreathingOptions, Part};
pub use case::phantom_case;
pub use cbct::{CbctOptions, degrade};
pub use motion::{INVERSE_TOLERANCE, PreImage, TrueMotion};
pub use options::PhantomOptions;
pub use plan::Plan;
pub use posture::{JointMotion, Posture};
pub use synthetic::{Deformed, Formula, TestObject};

use crate::error::{Error, Result};
use crate::evaluate::landmark::Landmark;
use crate::field::PushField;
use crate::geometry::{Grid, Rigid};
use crate::skeleton::{Pose, Skeleton};
use crate::volume::{LabelMap, Mask, Volume};
use motion::RandomMotion;
use nalgebra::{Point3, Translation3, Vector3};
use std::collections::BTreeMap;

/// A planning CT and a fraction CT of the same anatomy with everything that is true about them.
#[derive(Debug, Clone)]
pub struct Phantom {
    /// Planning CT, HU.
    pub planning: Volume<f32>,
    /// Bones on the planning grid with TotalSegmentator v2 names.
    pub bones: LabelMap,
    /// Patient on the planning grid, cavities filled, couch left out.
    pub body: Mask,
    /// Fraction CT, HU, on its own grid.
    pub fraction: Volume<f32>,
    /// Fraction voxels whose pre-image was not found to [`INVERSE_TOLERANCE`] (0 for sensible postures).
    pub unfound: usize,
    /// Soft-tissue points in both images.
    pub landmarks: Vec<Landmark>,
    /// True joints in the planning posture.
    pub skeleton: Skeleton,
    /// True pose of the fraction.
    pub pose: Pose,
    /// True motion of each bone, planning to fraction, LPS mm, in the order of `skeleton.bones`.
    pub transforms: Vec<Rigid>,
    /// The true push map, at any point.
    pub motion: TrueMotion,
}

impl Phantom {
    /// Makes the phantom, in the current rayon thread pool.
    ///
    /// # Errors
    /// When the options are no image or the posture names a bone that does not exist.
    pub fn new(options: &PhantomOptions) -> Result<Self> {
        options.check()?;
        let (grid, fraction_grid) = (options.planning_grid()?, options.fraction_grid()?);
        let anatomy = Anatomy::new(options.edge_mm, options.fat_mm);
        let planning = render::planning(&anatomy, &grid, options)?;
        let names = anatomy.bones().iter().map(|b| b.name.clone());
        let bones = LabelMap { volume: planning.labels, names: (1u16..).zip(names).collect() };
        let skeleton = joints::skeleton(&label_geometry(&bones, &anatomy));
        let pose = options.posture.pose(&skeleton)?;
        let scanner = Vector3::from(options.scanner_shift_mm);
        let posed = skeleton.transforms(&pose);
        let transforms: Vec<Rigid> = posed.iter().map(|t| Translation3::from(scanner) * t).collect();
        let pose = skeleton.pose_of(&transforms);
        let motion = TrueMotion::new(
            anatomy,
            &by_label(&skeleton, &posed)?,
            scanner,
            lattice_box(&grid, &fraction_grid, &transforms[0]),
            RandomMotion { mm: options.soft_tissue_mm, seed: options.seed },
        );
        let (fraction, unfound) = render::fraction(&motion, &fraction_grid, options)?;
        let landmark = |(name, at): &(&str, [f64; 3])| {
            let planning = Point3::from(asymmetry::placed(&Vector3::from(*at)));
            Landmark { name: (*name).into(), planning, fraction: motion.push(&planning) }
        };
        let landmarks = landmarks::LANDMARKS
            .iter()
            .map(landmark)
            .filter(|l| {
                grid.contains(&grid.index(&l.planning)) && fraction_grid.contains(&fraction_grid.index(&l.fraction))
            })
            .collect();
        Ok(Self {
            planning: planning.ct,
            bones,
            body: planning.body,
            fraction,
            unfound,
            landmarks,
            skeleton,
            pose,
            transforms,
            motion,
        })
    }

    /// The true push field on the planning grid (a second's work: not made by [`Phantom::new`]).
    ///
    /// # Errors
    /// Never in practice; the field has the planning grid's size.
    pub fn truth(&self) -> Result<PushField> {
        render::truth(&self.motion, &self.body)
    }

    /// Where a planning point goes: shorthand for [`TrueMotion::push`].
    pub fn push(&self, point: &Point3<f64>) -> Point3<f64> {
        self.motion.push(point)
    }
}

/// Label, centroid and volume of each bone; for a bone outside the grid its solid's middle and no volume.
fn label_geometry(bones: &LabelMap, anatomy: &Anatomy) -> BTreeMap<String, (u16, Point3<f64>, f64)> {
    let grid = bones.volume.grid();
    let mut sums = vec![(0usize, Vector3::zeros()); anatomy.bones().len() + 1];
    for (n, label) in bones.volume.data().iter().enumerate().filter(|(_, l)| **l > 0) {
        let sum = &mut sums[usize::from(*label)];
        sum.0 += 1;
        sum.1 += grid.centre(grid.voxel(n)).coords;
    }
    let of = |(label, bone): (u16, &solid::BoneSolid)| {
        let (count, sum) = sums[usize::from(label)];
        let [low, high] = bone.solid.bounds();
        let centroid = if count > 0 { sum / count as f64 } else { (low + high) / 2.0 };
        (bone.name.clone(), (label, centroid.into(), count as f64 * grid.voxel_volume()))
    };
    (1u16..).zip(anatomy.bones()).map(of).collect()
}

/// The bones' transforms in the order of their labels.
fn by_label(skeleton: &Skeleton, transforms: &[Rigid]) -> Result<Vec<Rigid>> {
    let mut out = vec![None; skeleton.bones.len()];
    for (bone, t) in skeleton.bones.iter().zip(transforms) {
        out[usize::from(bone.label) - 1] = Some(*t);
    }
    out.into_iter().collect::<Option<_>>().ok_or_else(|| Error::Internal("a phantom bone has no joint".into()))
}

/// A box of planning space that both grids show.
fn lattice_box(planning: &Grid, fraction: &Grid, root: &Rigid) -> [Vector3<f64>; 2] {
    let back = root.inverse();
    let corners = planning.corners().into_iter().chain(fraction.corners().into_iter().map(|c| back * c));
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    corners.fold(start, |[lo, hi], c| [lo.inf(&c.coords), hi.sup(&c.coords)]).map(|c| c.map(f64::round))
}
