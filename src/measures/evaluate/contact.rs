//! Do moved bones run into each other or come apart? And does skin meet skin?
//!
//! Bones are rigid, so a pair is judged in the planning frame: the surface of one, carried by both fitted transforms,
//! against the label and the surface of the other. Depth counts what goes beyond the planning CT, where labels that touch
//! already share their border.

use super::surface::Surface;
use crate::geometry::{Grid, Rigid};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::Point3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Two bones that overlap after their motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BoneOverlap {
    /// The two bones.
    pub bones: [String; 2],
    /// Greatest depth of a surface point of one bone inside the other, beyond that in the planning CT, mm.
    pub depth_mm: f64,
    /// Where it is deepest, fraction frame, LPS mm.
    pub at: Point3<f64>,
}

/// Least distance of the two bones of a joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JointGap {
    /// The bone and its parent.
    pub bones: [String; 2],
    /// Least distance of their surfaces in the planning CT, mm.
    pub planning_mm: f64,
    /// The same after their motion, mm.
    pub fraction_mm: f64,
    /// How far the joint's soft range lets the bones shift, mm.
    pub play_mm: f64,
}

impl JointGap {
    /// Growth of the gap, mm; below 0 where the bones come nearer.
    pub fn growth_mm(&self) -> f64 {
        self.fraction_mm - self.planning_mm
    }
}

/// What collides and what comes apart.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ContactReport {
    /// Pairs of bones that overlap by [`LISTED_MM`] or more, deepest first.
    pub overlaps: Vec<BoneOverlap>,
    /// Gap of each joint, widest growth first.
    pub joints: Vec<JointGap>,
    /// Fraction voxels where the pushed patient lies on himself beyond his skin.
    pub skin_voxels: usize,
    /// Their volume, ml.
    pub skin_ml: f64,
}

/// Overlaps below this are not listed, mm: the surface of a label is not known better than half a voxel.
pub const LISTED_MM: f64 = 0.5;

/// One bone as [`RestingBones`] needs it.
#[derive(Debug, Clone)]
pub struct Bone {
    /// Its name.
    pub name: String,
    /// Its label.
    pub label: u16,
    /// Position of its parent in the list; `None` for the root.
    pub parent: Option<usize>,
    /// How far the joint to the parent lets it shift, mm.
    pub play_mm: f64,
}

/// Bones where they lie in the planning CT: their surfaces, and what overlaps and how far joints are apart before anything moves.
#[derive(Debug, Clone)]
pub struct RestingBones {
    bones: Vec<Bone>,
    /// `None` for bones without voxels.
    solids: Vec<Option<Solid>>,
    /// Every pair of bones, with the depth of its overlap, mm; 0 for none.
    pairs: Vec<([usize; 2], f64)>,
    /// Gap of each bone's joint to its parent, mm.
    gaps: Vec<Option<f64>>,
}

impl RestingBones {
    /// Cuts bones out of a label map in the planning frame. Those without voxels take no part.
    pub fn new(labels: &LabelMap, bones: Vec<Bone>) -> Self {
        let solids = solids(labels, &bones);
        let still = Rigid::identity();
        let depth = |[a, b]: [usize; 2]| {
            let (Some(one), Some(other)) = (&solids[a], &solids[b]) else { return ([a, b], 0.0) };
            let both = [one.depth(other, &still), other.depth(one, &still)];
            ([a, b], both.into_iter().flatten().map(|d| d.0).fold(0.0, f64::max))
        };
        let all: Vec<[usize; 2]> = (0..bones.len()).flat_map(|a| (a + 1..bones.len()).map(move |b| [a, b])).collect();
        let pairs = all.into_par_iter().map(depth).collect();
        let gap = |b: usize| Some(solids[b].as_ref()?.gap(solids[bones[b].parent?].as_ref()?, &still));
        let gaps = (0..bones.len()).into_par_iter().map(gap).collect();
        Self { bones, solids, pairs, gaps }
    }

    /// Overlaps and joint gaps after motions, planning to fraction, one for each bone.
    pub fn moved(&self, motions: &[Rigid]) -> ContactReport {
        let names = |a: usize, b: usize| [a, b].map(|n| self.bones[n].name.clone());
        let overlap = |&([a, b], before): &([usize; 2], f64)| {
            let (one, other) = (self.solids[a].as_ref()?, self.solids[b].as_ref()?);
            let (ta, tb) = (motions[a], motions[b]);
            let there = tb.inverse() * ta;
            let (depth, at) = [
                one.depth(other, &there).map(|(d, p)| (d, ta * p)),
                other.depth(one, &there.inverse()).map(|(d, p)| (d, tb * p)),
            ]
            .into_iter()
            .flatten()
            .max_by(|x, y| x.0.total_cmp(&y.0))?;
            (depth - before >= LISTED_MM).then(|| BoneOverlap { bones: names(a, b), depth_mm: depth - before, at })
        };
        let mut overlaps: Vec<BoneOverlap> = self.pairs.par_iter().filter_map(overlap).collect();
        overlaps.sort_by(|a, b| b.depth_mm.total_cmp(&a.depth_mm));
        let gap = |b: usize| {
            let parent = self.bones[b].parent?;
            let (own, other) = (self.solids[b].as_ref()?, self.solids[parent].as_ref()?);
            let there = motions[parent].inverse() * motions[b];
            Some(JointGap {
                bones: names(b, parent),
                planning_mm: self.gaps[b]?,
                fraction_mm: own.gap(other, &there),
                play_mm: self.bones[b].play_mm,
            })
        };
        let mut joints: Vec<JointGap> = (0..self.bones.len()).into_par_iter().filter_map(gap).collect();
        joints.sort_by(|a, b| b.growth_mm().total_cmp(&a.growth_mm()));
        ContactReport { overlaps, joints, ..ContactReport::default() }
    }
}

/// Points that stand for a surface when the least distance is looked for.
const SAMPLES: usize = 1500;
/// Points this near to the nearest sample are then looked at one by one, mm.
const NEIGHBOURHOOD_MM: f64 = 12.0;

/// A bone in its own box of the label map.
#[derive(Debug, Clone)]
struct Solid {
    inside: Mask,
    surface: Surface,
    low: Point3<f64>,
    high: Point3<f64>,
}

impl Solid {
    /// Greatest depth of this bone's surface, moved by `there`, inside another, with the point of this bone.
    fn depth(&self, other: &Self, there: &Rigid) -> Option<(f64, Point3<f64>)> {
        // A ball around the box is enough to tell most pairs apart.
        let middle = there * nalgebra::center(&self.low, &self.high);
        let radius = (self.high - self.low).norm() / 2.0;
        if (0..3).any(|a| middle[a] + radius < other.low[a] || middle[a] - radius > other.high[a]) {
            return None;
        }
        let within = |p: &Point3<f64>| other.inside.grid().voxel_at(p).is_some_and(|voxel| *other.inside.at(voxel));
        let (own, moved): (Vec<_>, Vec<_>) =
            self.surface.vertices.iter().map(|p| (*p, there * p)).filter(|(_, q)| within(q)).unzip();
        own.into_iter().zip(other.surface.distances(&moved)).map(|(p, d)| (d, p)).max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Least distance of this bone's surface, moved by `there`, from another's; 0 when they overlap.
    fn gap(&self, other: &Self, there: &Rigid) -> f64 {
        if self.depth(other, there).is_some() {
            return 0.0;
        }
        let points = &self.surface.vertices;
        let samples: Vec<Point3<f64>> = points.iter().step_by(points.len() / SAMPLES + 1).map(|p| there * p).collect();
        let distances = other.surface.distances(&samples);
        let Some(start) = (0..samples.len()).min_by(|&a, &b| distances[a].total_cmp(&distances[b])) else {
            return f64::INFINITY;
        };
        let near: Vec<Point3<f64>> =
            points.iter().map(|p| there * p).filter(|p| (p - samples[start]).norm() <= NEIGHBOURHOOD_MM).collect();
        other.surface.distances(&near).into_iter().fold(distances[start], f64::min)
    }
}

/// Each bone cut out of the label map; `None` for those without voxels.
fn solids(labels: &LabelMap, bones: &[Bone]) -> Vec<Option<Solid>> {
    let grid = labels.volume.grid();
    let mut slot = vec![usize::MAX; usize::from(u16::MAX) + 1];
    bones.iter().enumerate().for_each(|(b, bone)| slot[usize::from(bone.label)] = b);
    let mut boxes = vec![[[usize::MAX; 3], [0usize; 3]]; bones.len()];
    for (l, &label) in labels.volume.data().iter().enumerate().filter(|(_, l)| **l > 0) {
        if let Some([low, high]) = boxes.get_mut(slot[usize::from(label)]) {
            let v = grid.voxel(l);
            *low = std::array::from_fn(|a| low[a].min(v[a]));
            *high = std::array::from_fn(|a| high[a].max(v[a]));
        }
    }
    let cut = |(bone, [low, high]): (&Bone, &[[usize; 3]; 2])| {
        if low[0] > high[0] {
            return None;
        }
        let size = std::array::from_fn(|a| high[a] - low[a] + 1);
        let own = Grid::new(size, grid.spacing(), grid.centre(*low), *grid.direction()).ok()?;
        let inside = Volume::from_fn(own.clone(), |l| {
            let v = own.voxel(l);
            *labels.volume.at(std::array::from_fn(|a| low[a] + v[a])) == bone.label
        });
        let surface = Surface::of(&inside, |v| v)?;
        let first = surface.vertices[0];
        let (low, high) = surface.vertices.iter().fold((first, first), |(l, h), p| (l.inf(p), h.sup(p)));
        Some(Solid { inside, surface, low, high })
    };
    bones.par_iter().zip(&boxes).map(cut).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use std::collections::BTreeMap;

    /// Two balls of radius 10 mm, 24 mm apart along a slanted grid's first axis, and a third far away.
    fn scene() -> LabelMap {
        let turn = nalgebra::Rotation3::from_euler_angles(0.2, -0.1, 0.3);
        let grid = Grid::new([80, 40, 24], [1.0, 1.0, 2.0], Point3::new(-30.0, 11.0, 5.0), turn.into_inner()).unwrap();
        let centre = |x: f64| grid.world(&Vector3::new(x, 20.0, 12.0));
        let centres = [centre(14.0), centre(38.0), centre(68.0)];
        let volume = Volume::from_fn(grid.clone(), |l| {
            let p = grid.centre(grid.voxel(l));
            centres.iter().position(|c| (p - c).norm() <= 10.0).map_or(0, |n| n as u16 + 1)
        });
        LabelMap { volume, names: BTreeMap::new() }
    }

    fn moved(shift_mm: f64) -> ContactReport {
        let labels = scene();
        let along = labels.volume.grid().direction().column(0).into_owned();
        let common =
            crate::geometry::about(&Point3::origin(), Vector3::new(0.3, 0.2, -0.4), Vector3::new(400.0, 0.0, 7.0));
        let own = common * nalgebra::Translation3::from(along * shift_mm);
        let bone = |name: &str, label, parent| Bone { name: name.into(), label, parent, play_mm: 1.0 };
        let bones = vec![bone("a", 1, None), bone("b", 2, Some(0)), bone("c", 3, Some(1))];
        RestingBones::new(&labels, bones).moved(&[own, common, common])
    }

    #[test]
    fn balls_overlap_by_as_much_as_they_are_pushed() {
        for (shift, depth) in [(7.0, 3.0), (10.0, 6.0)] {
            let r = moved(shift);
            assert_eq!(r.overlaps.len(), 1, "{r:?}");
            let o = &r.overlaps[0];
            assert_eq!(o.bones, ["a", "b"]);
            assert!((o.depth_mm - depth).abs() < 0.4, "{} for {depth}", o.depth_mm);
            assert!(r.joints.iter().any(|j| j.bones == ["b", "a"] && j.fraction_mm == 0.0));
        }
        assert!(moved(3.5).overlaps.is_empty());
    }

    #[test]
    fn joints_come_apart_by_as_much_as_they_are_pulled() {
        let r = moved(-5.0);
        let joint = &r.joints[0];
        assert_eq!(joint.bones, ["b", "a"]);
        assert!((joint.planning_mm - 4.0).abs() < 0.5 && (joint.growth_mm() - 5.0).abs() < 0.1, "{joint:?}");
        assert!(r.joints[1].growth_mm().abs() < 1e-6 && r.overlaps.is_empty());
    }

    #[test]
    fn labels_that_touch_already_do_not_count() {
        let grid = Grid::axis_aligned([20, 12, 12], [1.0, 1.0, 1.0], [0.0; 3]).unwrap();
        let volume = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] < 10 { 1 } else { 2u16 });
        let labels = LabelMap { volume, names: BTreeMap::new() };
        let still = Rigid::identity();
        let bone = |name: &str, label| Bone { name: name.into(), label, parent: None, play_mm: 0.0 };
        let bones = RestingBones::new(&labels, vec![bone("a", 1), bone("b", 2)]);
        assert!(bones.moved(&[still, still]).overlaps.is_empty());
        let r = bones.moved(&[Rigid::translation(2.0, 0.0, 0.0), still]);
        assert!((r.overlaps[0].depth_mm - 2.0).abs() < 0.6, "{r:?}");
    }
}
