//! Where bones come to lie: known exactly, so that their pre-images need no search, and no soft tissue that is folded
//! over a bone takes its place.

use crate::geometry::{Grid, Rigid};
use crate::volume::{LabelMap, Volume, region::voxels_of_box};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::ops::Range;

/// Lowest and highest voxel of a box.
type Corners = [[usize; 3]; 2];

/// Bones of the planning frame with their rigid motions, to be found in a fraction grid.
pub struct MovedBones<'a> {
    labels: &'a Volume<u16>,
    fraction: &'a Grid,
    bones: Vec<BoneMoved>,
}

/// One bone.
struct BoneMoved {
    label: u16,
    back: Rigid,
    /// Where it can lie in the fraction grid.
    range: [Range<usize>; 3],
}

impl<'a> MovedBones<'a> {
    /// From the labels (planning grid) and each bone's label and motion (LPS mm, planning to fraction).
    pub fn new(labels: &'a LabelMap, motions: impl Iterator<Item = (u16, Rigid)>, fraction: &'a Grid) -> Self {
        let boxes = boxes(&labels.volume);
        let of = |(label, motion): (u16, Rigid)| {
            let range = landed(boxes.get(usize::from(label))?.as_ref()?, &motion, labels.volume.grid(), fraction)?;
            Some(BoneMoved { label, back: motion.inverse(), range })
        };
        Self { labels: &labels.volume, fraction, bones: motions.filter_map(of).collect() }
    }

    /// For the planes of the fraction grid from `first` on: 0, or one more than the index of the bone inside which a
    /// voxel's pre-image lies, all eight voxels around it of that bone. Of bones that overlap the first is taken.
    pub(in crate::field) fn paint(&self, first: usize, owner: &mut [u16]) {
        let [nx, ny, _] = self.fraction.size();
        let planes = owner.len() / (nx * ny);
        let planning = self.labels.grid();
        for (n, bone) in self.bones.iter().enumerate() {
            let [i, j, k] = &bone.range;
            let along: Vector3<f64> =
                planning.inverse_step() * (bone.back.rotation * self.fraction.step().column(0).into_owned());
            for k in k.start.max(first)..k.end.min(first + planes) {
                for j in j.clone() {
                    let start = planning.index(&(bone.back * self.fraction.centre([i.start, j, k])));
                    let row = nx * (j + ny * (k - first));
                    for (step, own) in owner[row + i.start..row + i.end].iter_mut().enumerate() {
                        if *own == 0 && self.within(bone.label, &(start + along * step as f64)) {
                            *own = n as u16 + 1;
                        }
                    }
                }
            }
        }
    }

    /// The displacement from a fraction point back into the bone that `paint` found there.
    pub(in crate::field) fn back(&self, owner: u16, y: &Vector3<f64>) -> Option<Vector3<f64>> {
        let bone = self.bones.get(usize::from(owner).checked_sub(1)?)?;
        Some((bone.back * Point3::from(*y)).coords - y)
    }

    fn within(&self, label: u16, index: &Vector3<f64>) -> bool {
        let grid = self.labels.grid();
        let size = grid.size();
        if !(0..3).all(|a| index[a] >= 0.0 && index[a] < size[a] as f64 - 1.0) {
            return false;
        }
        let low = grid.linear([0, 1, 2].map(|a| index[a] as usize));
        grid.cell_corners().iter().all(|corner| self.labels.data()[low + corner] == label)
    }
}

/// The box around two boxes.
fn around(a: Corners, b: Corners) -> Corners {
    [std::array::from_fn(|c| a[0][c].min(b[0][c])), std::array::from_fn(|c| a[1][c].max(b[1][c]))]
}

/// The box of voxels of every label.
fn boxes(labels: &Volume<u16>) -> Vec<Option<Corners>> {
    let [nx, ny, _] = labels.grid().size();
    let add = |out: &mut Vec<Option<Corners>>, label: usize, more: Corners| {
        if out.len() <= label {
            out.resize(label + 1, None);
        }
        out[label] = Some(out[label].map_or(more, |known| around(known, more)));
    };
    let of_plane = |(k, plane): (usize, &[u16])| {
        let mut out = Vec::new();
        for (j, line) in plane.chunks(nx).enumerate() {
            for (i, &label) in line.iter().enumerate().filter(|(_, l)| **l > 0) {
                add(&mut out, usize::from(label), [[i, j, k]; 2]);
            }
        }
        out
    };
    let join = |mut all: Vec<Option<Corners>>, own: Vec<Option<Corners>>| {
        for (label, own) in own.into_iter().enumerate() {
            own.into_iter().for_each(|own| add(&mut all, label, own));
        }
        all
    };
    labels.data().par_chunks(nx * ny).enumerate().map(of_plane).reduce(Vec::new, join)
}

/// The fraction voxels that a moved box of planning voxels can reach.
fn landed(corners: &Corners, motion: &Rigid, planning: &Grid, fraction: &Grid) -> Option<[Range<usize>; 3]> {
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    let [low, high] = (0..8).fold(start, |[low, high], c| {
        let x = motion * planning.centre(std::array::from_fn(|a| corners[c >> a & 1][a]));
        [low.inf(&x.coords), high.sup(&x.coords)]
    });
    voxels_of_box(fraction, [low.into(), high.into()], 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{InvertOptions, PushField, invert};
    use nalgebra::Translation3;

    #[test]
    fn tissue_folded_over_a_bone_does_not_take_its_place() {
        // A block shifts by 5 mm; tissue from beyond it is thrown over it.
        let grid = Grid::axis_aligned([40, 30, 20], [2.0, 2.0, 3.0], [-40.0, -30.0, -30.0]).unwrap();
        let block =
            |x: &Point3<f64>, less: f64| x.x.abs() < 7.0 - less && x.y.abs() < 11.0 - less && x.z.abs() < 13.0 - less;
        let labels = LabelMap {
            volume: Volume::from_fn(grid.clone(), |l| u16::from(block(&grid.centre(grid.voxel(l)), 0.0)) * 4),
            names: [(4, "skull".to_owned())].into(),
        };
        let displacement = Volume::from_fn(grid.clone(), |l| {
            let x = grid.centre(grid.voxel(l));
            if block(&x, -1.0) {
                [5.0, 0.0, 0.0]
            } else if x.x > 12.0 {
                [-20.0, 0.0, 0.0]
            } else {
                [0.0; 3]
            }
        });
        let push = PushField { displacement, computed: Volume::filled(grid.clone(), true) };
        let motion = Rigid::from_parts(Translation3::new(5.0, 0.0, 0.0), nalgebra::UnitQuaternion::identity());
        let wrong = |bones: Option<&MovedBones<'_>>| {
            let (pull, _) = invert(&push, &grid, bones, &InvertOptions::default()).unwrap();
            let missed = |n: &usize| {
                let y = grid.centre(grid.voxel(*n));
                let v = pull.displacement.data()[*n];
                block(&(motion.inverse() * y), 3.0) && (v[0] + 5.0).abs() > 1e-6
            };
            (0..grid.len()).filter(missed).count()
        };
        assert!(wrong(None) > 50, "{} voxels: nothing is folded over the bone", wrong(None));
        assert_eq!(wrong(Some(&MovedBones::new(&labels, [(4, motion)].into_iter(), &grid))), 0);
        // A bone that the field does not move so is not believed.
        let other = Rigid::identity();
        assert_eq!(wrong(Some(&MovedBones::new(&labels, [(4, other)].into_iter(), &grid))), wrong(None));
    }
}
