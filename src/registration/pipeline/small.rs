//! A small patient, whom tests move: two bones in a ball of tissue.

use crate::fit::{BoneFit, DeterminedBy, FitResult, Stop};
use crate::geometry::{Grid, Rigid};
use crate::skeleton::{Bone, Joint, Pose, Skeleton};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::{Matrix3, Point3};

/// Voxels of 6 mm.
pub(super) fn grid() -> Grid {
    Grid::axis_aligned([24; 3], [6.0; 3], [-69.0, -69.0, 100.0]).unwrap()
}

/// Whether a voxel lies in a box, both ends included.
fn within(voxel: [usize; 3], [low, high]: [[usize; 3]; 2]) -> bool {
    (0..3).all(|a| (low[a]..=high[a]).contains(&voxel[a]))
}

/// Low and high corners of the two bones, voxels.
pub(super) const BONES: [[[usize; 3]; 2]; 2] = [[[6, 9, 9], [9, 14, 14]], [[15, 9, 9], [17, 14, 14]]];

/// Labels of the two bones.
pub(super) fn labels() -> LabelMap {
    let grid = grid();
    let of = |n: usize| BONES.iter().position(|b| within(grid.voxel(n), *b)).map_or(0, |b| b as u16 + 1);
    let names = [(1, "vertebrae_C5".to_owned()), (2, "vertebrae_C6".to_owned())];
    LabelMap { volume: Volume::from_fn(grid.clone(), of), names: names.into_iter().collect() }
}

/// Radius of the patient, mm.
pub(super) const RADIUS: f64 = 60.0;

/// A ball around the middle of the patient.
pub(super) fn ball(radius: f64) -> Mask {
    let grid = grid();
    let middle = grid.middle();
    Volume::from_fn(grid.clone(), |n| (grid.centre(grid.voxel(n)) - middle).norm() < radius)
}

/// Inside of the skin.
pub(super) fn body() -> Mask {
    ball(RADIUS)
}

/// The CT, HU.
pub(super) fn ct() -> Volume<f32> {
    let (grid, body, labels) = (grid(), body(), labels());
    let hu = |n: usize| {
        let x = grid.centre(grid.voxel(n));
        let soft = 40.0 + 60.0 * (0.2 * x.x).sin() * (0.25 * x.y).cos() * (0.15 * x.z).sin();
        match (body.data()[n], labels.volume.data()[n]) {
            (false, _) => -1000.0,
            (true, 0) => soft as f32,
            (true, _) => 900.0,
        }
    };
    Volume::from_fn(grid.clone(), hu)
}

/// A bone by its label, with some mm of play.
pub(super) fn bone(label: u16, name: &str, centroid: Point3<f64>) -> Bone {
    let joint = Joint {
        name: String::new(),
        centre: centroid,
        axes: Matrix3::identity(),
        rotation_range_deg: [[-15.0, 15.0]; 3],
        translation_range_mm: [2.0; 3],
        source: String::new(),
    };
    Bone { label, name: name.into(), volume_mm3: 5e3, centroid, parent: None, joint }
}

/// The skeleton of [`labels`].
pub(super) fn skeleton() -> Skeleton {
    let centroid = |b: usize| {
        let [low, high] = BONES[b].map(|corner| grid().centre(corner));
        nalgebra::center(&low, &high)
    };
    let bones = labels().names.iter().map(|(l, name)| bone(*l, name, centroid(usize::from(*l) - 1))).collect();
    Skeleton { bones }
}

/// A bone that the image shows, with its motion.
pub(super) fn fitted(name: &str, transform: Rigid) -> BoneFit {
    BoneFit {
        name: name.into(),
        transform,
        visible: 1.0,
        similarity_before: None,
        similarity_after: None,
        stop: Stop::Converged,
        unsettled_mm: 0.0,
        position_sd_mm: 0.1,
        rotation_sd_deg: 0.1,
        beyond_range: Default::default(),
        motion_mm: 0.0,
        determined_by: DeterminedBy::Image,
    }
}

/// Both bones moved, the patient as a whole by `common`.
pub(super) fn fit(transforms: [Rigid; 2], common: Rigid) -> FitResult {
    FitResult {
        transforms: transforms.to_vec(),
        pose: Pose::default(),
        bones: vec![fitted("vertebrae_C5", transforms[0]), fitted("vertebrae_C6", transforms[1])],
        common,
        common_share: 1.0,
        open: None,
        warnings: Vec::new(),
    }
}
