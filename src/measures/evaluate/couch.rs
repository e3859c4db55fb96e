//! The couch shift that brings chosen bones together: one motion of the whole patient, and what it leaves of each bone.
//!
//! A therapist matches the scans on the target region or on the bones that hold the patient, reads the shift, and decides by
//! what is left whether to treat or to set up again. Bones move rigidly, so the least squares over all their points
//! follow from their moments, without sampling (Kabsch, Acta Cryst. A32 (1976) 922, with each bone's weight 1).

use crate::geometry::{Grid, Rigid};
use crate::volume::LabelMap;
use crate::volume::region::box_problem;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Which bones the scans are matched on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CouchOptions {
    /// Names of the bones; none: the vertebrae (and the skull) nearest the middle of what both scans show.
    pub bones: Vec<String>,
    /// The bones in a box of the planning frame, cut to it: least then greatest x, y, z, LPS mm.
    pub box_mm: Option<[f64; 6]>,
}

impl CouchOptions {
    /// What is wrong with these values, if anything.
    pub fn problem(&self) -> Option<String> {
        if self.box_mm.is_some() && !self.bones.is_empty() {
            return Some("couch.bones and couch.box_mm are both given: one of them is needed".into());
        }
        box_problem("couch.box_mm", &self.box_mm?)
    }
}

/// Bones of the spine whose centre is so near the middle are matched, mm along the body: three or four vertebrae to each side.
const NEAR_MM: f64 = 60.0;
/// So many at least, however far they lie.
const FEWEST: usize = 3;
/// Why these are matched, in words.
pub const NEAR_MIDDLE: &str = "bones of the spine nearest the middle of what both scans show";

/// Height in planning of the middle of what both scans show, mm; `motion`: of the whole, planning to fraction.
pub fn middle(planning: &Grid, fraction: &Grid, motion: &Rigid) -> f64 {
    let back = motion.inverse();
    let range = |points: &mut dyn Iterator<Item = f64>| {
        points.fold([f64::MAX, f64::MIN], |[low, high], z| [low.min(z), high.max(z)])
    };
    let [low, high] = range(&mut planning.corners().map(|c| c.z).into_iter());
    let [from, to] = range(&mut fraction.corners().map(|c| (back * c).z).into_iter());
    // Scans that show nothing in common have no middle: planning's own.
    if from >= high || to <= low { f64::midpoint(low, high) } else { f64::midpoint(low.max(from), high.min(to)) }
}

/// Positions of the bones of the spine nearest the middle, nearest first; `heights`: of the centre of each that can be matched, mm.
pub fn near_middle(heights: &[Option<f64>], middle: f64) -> Vec<usize> {
    let off = |(n, z): (usize, &Option<f64>)| z.map(|z| ((z - middle).abs(), n));
    let mut near: Vec<(f64, usize)> = heights.iter().enumerate().filter_map(off).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let taken = near.iter().filter(|(off, _)| *off <= NEAR_MM).count().max(FEWEST).min(near.len());
    near[..taken].iter().map(|n| n.1).collect()
}

/// A rigid body by its moments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// Its centre, LPS mm.
    pub centre: Point3<f64>,
    /// Mean of (x - centre)(x - centre)^T, mm^2.
    pub spread: Matrix3<f64>,
}

/// Moments of every label, or of what of it lies in a box of LPS mm.
pub fn moments(labels: &LabelMap, within: Option<[f64; 6]>) -> BTreeMap<u16, Moments> {
    type Sums = BTreeMap<u16, (f64, Vector3<f64>, Matrix3<f64>)>;
    let grid = labels.volume.grid();
    let plane = grid.strides()[2];
    let inside = |p: &Point3<f64>| within.is_none_or(|b| (0..3).all(|a| (b[a]..=b[a + 3]).contains(&p[a])));
    let of_plane = |k: usize| {
        let mut sums = Sums::new();
        for l in k * plane..(k + 1) * plane {
            let label = labels.volume.data()[l];
            if label == 0 {
                continue;
            }
            let p = grid.centre(grid.voxel(l));
            if inside(&p) {
                let (n, first, second) = sums.entry(label).or_default();
                *n += 1.0;
                *first += p.coords;
                *second += p.coords * p.coords.transpose();
            }
        }
        sums
    };
    let planes: Vec<Sums> = (0..grid.size()[2]).into_par_iter().map(of_plane).collect();
    let mut all = Sums::new();
    for (label, (n, first, second)) in planes.into_iter().flatten() {
        let sum = all.entry(label).or_default();
        sum.0 += n;
        sum.1 += first;
        sum.2 += second;
    }
    let moments = |(n, first, second): (f64, Vector3<f64>, Matrix3<f64>)| {
        let centre = first / n;
        Moments { centre: centre.into(), spread: second / n - centre * centre.transpose() }
    };
    all.into_iter().map(|(label, sums)| (label, moments(sums))).collect()
}

/// A bone and its motion from planning to fraction.
#[derive(Debug, Clone)]
pub struct CouchBone<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its shape in planning.
    pub moments: Moments,
    /// Its motion.
    pub motion: Rigid,
    /// Whether the scans are matched on it.
    pub matched: bool,
}

/// What a couch shift leaves of a bone's motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CouchResidual {
    /// Name of the bone.
    pub bone: String,
    /// Whether the scans were matched on it.
    pub matched: bool,
    /// Root mean square distance of its points after the translation alone, mm.
    pub shift_mm: f64,
    /// The same after translation and rotation, mm.
    pub rotation_mm: f64,
}

/// A couch shift, planning to fraction, and what it leaves.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CouchMatch {
    /// The bones that were matched.
    pub on: Vec<String>,
    /// Why these, in words.
    pub chosen: String,
    /// The translation alone, LPS mm; scanner origins included.
    pub shift_mm: [f64; 3],
    /// Rotation about `centre` that goes with the same translation: a rotation vector, degrees about x, y, z.
    pub rotation_deg: [f64; 3],
    /// Centre of the matched bones in planning, LPS mm.
    pub centre: [f64; 3],
    /// Each bone's residual, in the order of the skeleton.
    pub residuals: Vec<CouchResidual>,
}

impl CouchMatch {
    /// The least-squares match on the bones with `matched`; where none is, the whole moves by `otherwise`.
    pub fn of(bones: &[CouchBone<'_>], chosen: String, otherwise: Vector3<f64>) -> Self {
        let on: Vec<&CouchBone<'_>> = bones.iter().filter(|b| b.matched).collect();
        let n = on.len() as f64;
        let mean = |of: &dyn Fn(&CouchBone<'_>) -> Vector3<f64>| on.iter().map(|b| of(b)).sum::<Vector3<f64>>() / n;
        let (centre, shift, turn) = if on.is_empty() {
            (Vector3::zeros(), otherwise, Rotation3::identity())
        } else {
            let from = mean(&|b| b.moments.centre.coords);
            let to = mean(&|b| (b.motion * b.moments.centre).coords);
            let cross = |b: &&CouchBone<'_>| {
                let there = (b.motion * b.moments.centre).coords - to;
                let turned = b.motion.rotation.to_rotation_matrix().into_inner() * b.moments.spread;
                turned + there * (b.moments.centre.coords - from).transpose()
            };
            (from, to - from, nearest_rotation(on.iter().map(cross).sum()))
        };
        let shifted = Rigid::from_parts(shift.into(), UnitQuaternion::identity());
        let turned = about(&turn, &centre, &shift);
        let residual = |b: &CouchBone<'_>| CouchResidual {
            bone: b.name.to_owned(),
            matched: b.matched,
            shift_mm: apart(b, &shifted),
            rotation_mm: apart(b, &turned),
        };
        Self {
            on: on.iter().map(|b| b.name.to_owned()).collect(),
            chosen,
            shift_mm: shift.into(),
            // By the quaternion: the matrix's trace may exceed 3 by rounding, and has no angle then.
            rotation_deg: UnitQuaternion::from_rotation_matrix(&turn).scaled_axis().map(f64::to_degrees).into(),
            centre: centre.into(),
            residuals: bones.iter().map(residual).collect(),
        }
    }

    /// The translation, LPS mm.
    pub fn shift(&self) -> Vector3<f64> {
        self.shift_mm.into()
    }

    /// Where the shift has brought the patient, mm to his own sides: `left 4.6, front 0.3, head 3.9`.
    pub fn towards(&self) -> String {
        let sides = [["right", "left"], ["front", "back"], ["feet", "head"]];
        let of = |(mm, [minus, plus]): (f64, [&str; 2])| {
            let tenths = (mm * 10.0).round() / 10.0;
            format!("{} {:.1}", if tenths < 0.0 { minus } else { plus }, tenths.abs())
        };
        self.shift_mm.into_iter().zip(sides).map(of).collect::<Vec<_>>().join(", ")
    }

    /// Translation and rotation, planning to fraction.
    pub fn rigid(&self) -> Rigid {
        let turn = Rotation3::new(Vector3::from(self.rotation_deg).map(f64::to_radians));
        about(&turn, &self.centre.into(), &self.shift())
    }

    /// Angle of the rotation, degrees.
    pub fn angle_deg(&self) -> f64 {
        Vector3::from(self.rotation_deg).norm()
    }

    /// The matched bone that is left farthest off by the translation alone.
    pub fn worst(&self) -> Option<&CouchResidual> {
        self.residuals.iter().filter(|r| r.matched).max_by(|a, b| a.shift_mm.total_cmp(&b.shift_mm))
    }
}

/// A rotation about a centre, then a shift.
fn about(turn: &Rotation3<f64>, centre: &Vector3<f64>, shift: &Vector3<f64>) -> Rigid {
    Rigid::from_parts(Translation3::from(centre + shift - turn * centre), UnitQuaternion::from_rotation_matrix(turn))
}

/// The rotation that a sum of there * here^T is nearest to.
fn nearest_rotation(cross: Matrix3<f64>) -> Rotation3<f64> {
    let svd = cross.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Rotation3::identity() };
    let sign = (u * v_t).determinant().signum();
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

/// Root mean square distance of a bone's points under its own motion and another, mm.
fn apart(bone: &CouchBone<'_>, other: &Rigid) -> f64 {
    let matrix = |r: &Rigid| r.rotation.to_rotation_matrix().into_inner();
    let turn = matrix(&bone.motion) - matrix(other);
    let of_centre = (bone.motion * bone.moments.centre - other * bone.moments.centre).norm_squared();
    ((turn * bone.moments.spread * turn.transpose()).trace() + of_centre).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Volume;

    /// Two bones of unlike size and shape, and every point of them.
    fn two() -> (LabelMap, Vec<(u16, Point3<f64>)>) {
        let grid = Grid::axis_aligned([24, 20, 30], [2.0, 1.5, 3.0], [-20.0, 5.0, 100.0]).unwrap();
        let label = |l: usize| {
            let [i, j, k] = grid.voxel(l);
            match (i, j, k) {
                (2..12, 3..9, 2..8) => 1,
                (6..20, 8..18, 14..29) if i + j > 16 => 2,
                _ => 0,
            }
        };
        let volume = Volume::from_fn(grid.clone(), label);
        let labelled = |l: usize| (volume.data()[l], grid.centre(grid.voxel(l)));
        let points = (0..grid.len()).map(labelled).filter(|p| p.0 > 0).collect();
        let names = BTreeMap::from([(1, "vertebrae_C7".to_owned()), (2, "skull".to_owned())]);
        (LabelMap { volume, names }, points)
    }

    fn motions() -> [Rigid; 2] {
        let of = |t: [f64; 3], r: [f64; 3]| Rigid::new(Vector3::from(t), Vector3::from(r));
        [of([2.0, -5.0, 1.0], [0.05, 0.0, -0.1]), of([-1.0, 9.0, 4.0], [0.3, 0.1, 0.0])]
    }

    fn matched(on: [bool; 2]) -> CouchMatch {
        let all = moments(&two().0, None);
        let of = |(n, name): (usize, &'static str)| CouchBone {
            name,
            moments: all[&(n as u16 + 1)],
            motion: motions()[n],
            matched: on[n],
        };
        let bones: Vec<_> = ["vertebrae_C7", "skull"].into_iter().enumerate().map(of).collect();
        CouchMatch::of(&bones, String::new(), Vector3::new(7.0, 8.0, 9.0))
    }

    /// Mean over both bones, each with weight 1, of the squared distances under a motion of the whole.
    fn cost(whole: &Rigid) -> f64 {
        let (_, points) = two();
        let of = |n: usize| {
            let own: Vec<_> = points.iter().filter(|p| usize::from(p.0) == n + 1).collect();
            own.iter().map(|(_, p)| (motions()[n] * p - whole * p).norm_squared()).sum::<f64>() / own.len() as f64
        };
        f64::midpoint(of(0), of(1))
    }

    #[test]
    fn a_shift_is_told_by_the_patients_sides() {
        let of = |shift_mm: [f64; 3]| CouchMatch { shift_mm, ..CouchMatch::default() }.towards();
        assert_eq!(of([4.56, -4.64, 3.9]), "left 4.6, front 4.6, head 3.9");
        assert_eq!(of([-0.04, 0.26, -12.0]), "left 0.0, back 0.3, feet 12.0");
    }

    #[test]
    fn one_bone_is_brought_home_whole() {
        let one = matched([true, false]);
        assert!((one.rigid().to_homogeneous() - motions()[0].to_homogeneous()).norm() < 1e-9);
        assert!(one.residuals[0].rotation_mm < 1e-6 && one.residuals[0].shift_mm > 0.3, "{:?}", one.residuals);
        assert_eq!(
            (one.on.as_slice(), one.worst().unwrap().bone.as_str()),
            (["vertebrae_C7".to_owned()].as_slice(), "vertebrae_C7")
        );
    }

    #[test]
    fn residuals_are_those_of_every_point() {
        let both = matched([true, true]);
        let (_, points) = two();
        for (n, residual) in both.residuals.iter().enumerate() {
            let own: Vec<_> = points.iter().filter(|p| usize::from(p.0) == n + 1).map(|p| p.1).collect();
            let rms = |whole: &dyn Fn(&Point3<f64>) -> Point3<f64>| {
                let squares = own.iter().map(|p| (motions()[n] * p - whole(p)).norm_squared());
                (squares.sum::<f64>() / own.len() as f64).sqrt()
            };
            assert!((residual.shift_mm - rms(&|p| p + both.shift())).abs() < 1e-9);
            assert!((residual.rotation_mm - rms(&|p| both.rigid() * p)).abs() < 1e-9);
        }
    }

    #[test]
    fn no_other_motion_of_the_whole_is_nearer() {
        let both = matched([true, true]);
        let (best, shift) = (cost(&both.rigid()), cost(&Rigid::new(both.shift(), Vector3::zeros())));
        assert!(best < shift);
        for axis in 0..6 {
            for step in [-0.01, 0.01] {
                let mut by = [0.0; 6];
                by[axis] = step;
                let off = Rigid::new(Vector3::new(by[0], by[1], by[2]), Vector3::zeros());
                let turn = Rotation3::new(Vector3::new(by[3], by[4], by[5]));
                let near = off * about(&turn, &(both.rigid() * Point3::from(both.centre)).coords, &Vector3::zeros());
                assert!(cost(&(near * both.rigid())) > best, "axis {axis}");
                assert!(cost(&(off * Rigid::new(both.shift(), Vector3::zeros()))) >= shift, "axis {axis}");
            }
        }
    }

    #[test]
    fn without_a_bone_the_whole_moves_by_its_mean_motion_and_a_box_cuts_bones() {
        let none = matched([false, false]);
        assert_eq!((none.on.len(), none.shift_mm, none.rotation_deg), (0, [7.0, 8.0, 9.0], [0.0; 3]));
        let (labels, points) = two();
        let within = [-30.0, 0.0, 100.0, 40.0, 40.0, 113.0];
        let part = moments(&labels, Some(within));
        let own: Vec<_> = points.iter().filter(|(l, p)| *l == 1 && p.z <= 113.0).map(|p| p.1.coords).collect();
        assert_eq!(part.keys().copied().collect::<Vec<_>>(), [1]);
        let mean = own.iter().sum::<Vector3<f64>>() / own.len() as f64;
        assert!((part[&1].centre.coords - mean).norm() < 1e-9);
        let problem = |bones: &[&str], box_mm| {
            CouchOptions { bones: bones.iter().map(|b| (*b).to_owned()).collect(), box_mm }.problem()
        };
        assert_eq!([problem(&["skull"], None), problem(&[], Some(within)), problem(&[], None)], [None, None, None]);
        assert!(problem(&["skull"], Some(within)).is_some() && problem(&[], Some([0.0; 6])).is_some());
    }
}
