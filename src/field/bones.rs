//! Where bones come to lie: known exactly, so that their pre-images need no search, and no soft tissue that is folded
//! over a bone takes its place.

use crate::geometry::{Grid, Rigid};
use crate::volume::{LabelMap, Volume};
use nalgebra::{Point3, Vector3};

/// Index ranges of a box of voxels, low and high included.
type Range = [[usize; 2]; 3];

/// Bones of the planning frame with their rigid motions, to be found in a fraction grid.
pub struct MovedBones<'a> {
    labels: &'a Volume<u16>,
    fraction: &'a Grid,
    bones: Vec<Moved>,
}

/// One bone.
struct Moved {
    label: u16,
    back: Rigid,
    /// Where it can lie in the fraction grid.
    range: Range,
}

impl<'a> MovedBones<'a> {
    /// From the labels (planning grid) and each bone's label and motion (LPS mm, planning to fraction).
    pub fn new(labels: &'a LabelMap, motions: impl Iterator<Item = (u16, Rigid)>, fraction: &'a Grid) -> Self {
        let boxes = boxes(&labels.volume);
        let of = |(label, motion): (u16, Rigid)| {
            let range = landed(boxes.get(usize::from(label))?.as_ref()?, &motion, labels.volume.grid(), fraction)?;
            Some(Moved { label, back: motion.inverse(), range })
        };
        Self { labels: &labels.volume, fraction, bones: motions.filter_map(of).collect() }
    }

    /// For the planes of the fraction grid from `first` on: 0, or one more than the index of the bone inside which a
    /// voxel's pre-image lies, all eight voxels around it of that bone. Of bones that overlap the first is taken.
    pub(super) fn paint(&self, first: usize, owner: &mut [u16]) {
        let [nx, ny, _] = self.fraction.size();
        let planes = owner.len() / (nx * ny);
        let planning = self.labels.grid();
        for (n, bone) in self.bones.iter().enumerate() {
            let [[i0, i1], [j0, j1], [k0, k1]] = bone.range;
            let along: Vector3<f64> =
                planning.inverse_step() * (bone.back.rotation * self.fraction.step().column(0).into_owned());
            for k in k0.max(first)..(k1 + 1).min(first + planes) {
                for j in j0..=j1 {
                    let start = planning.index(&(bone.back * self.fraction.centre([i0, j, k])));
                    let row = nx * (j + ny * (k - first));
                    for (step, own) in owner[row + i0..=row + i1].iter_mut().enumerate() {
                        if *own == 0 && self.within(bone.label, &(start + along * step as f64)) {
                            *own = n as u16 + 1;
                        }
                    }
                }
            }
        }
    }

    /// The displacement from a fraction point back into the bone that `paint` found there.
    pub(super) fn back(&self, owner: u16, y: &Vector3<f64>) -> Option<Vector3<f64>> {
        let bone = self.bones.get(usize::from(owner).checked_sub(1)?)?;
        Some((bone.back * Point3::from(*y)).coords - y)
    }

    fn within(&self, label: u16, index: &Vector3<f64>) -> bool {
        let grid = self.labels.grid();
        let (size, strides) = (grid.size(), grid.strides());
        if !(0..3).all(|a| index[a] >= 0.0 && index[a] < size[a] as f64 - 1.0) {
            return false;
        }
        let low = grid.linear([0, 1, 2].map(|a| index[a] as usize));
        (0..8).all(|c| {
            let corner = (0..3).filter(|a| c >> a & 1 == 1).map(|a| strides[a]).sum::<usize>();
            self.labels.data()[low + corner] == label
        })
    }
}

/// The box of voxels of every label.
fn boxes(labels: &Volume<u16>) -> Vec<Option<Range>> {
    let [nx, ny, _] = labels.grid().size();
    let mut out: Vec<Option<Range>> = vec![None; usize::from(labels.data().iter().copied().max().unwrap_or(0)) + 1];
    for (row, line) in labels.data().chunks(nx).enumerate() {
        for (i, &label) in line.iter().enumerate().filter(|(_, l)| **l > 0) {
            let at = [i, row % ny, row / ny];
            let range = out[usize::from(label)].get_or_insert(at.map(|c| [c, c]));
            for (r, c) in range.iter_mut().zip(at) {
                *r = [r[0].min(c), r[1].max(c)];
            }
        }
    }
    out
}

/// The box of fraction voxels that a moved box of planning voxels can reach.
fn landed(range: &Range, motion: &Rigid, planning: &Grid, fraction: &Grid) -> Option<Range> {
    let start = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
    let [low, high] = (0..8).fold(start, |[low, high], c| {
        let corner: [usize; 3] = std::array::from_fn(|a| range[a][c >> a & 1]);
        let index = fraction.index(&(motion * planning.centre(corner)));
        [low.inf(&index), high.sup(&index)]
    });
    let mut out = Range::default();
    for (a, out) in out.iter_mut().enumerate() {
        let last = fraction.size()[a] as f64 - 1.0;
        let (low, high) = (low[a].floor().max(0.0), high[a].ceil().min(last));
        if low > high {
            return None;
        }
        *out = [low as usize, high as usize];
    }
    Some(out)
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
