//! Bone motions from labels of both scans: a bone's surface in planning is laid on its surface in the fraction.
//!
//! Iterated closest points (Besl and McKay, IEEE PAMI 14 (1992) 239), trimmed, from the labels' centres and from their principal
//! axes. Only what both scans show is compared, a label's open side at the edge of its scan left out, and the smaller label seeks
//! its place on the larger: part of a bone lies on the whole, not the whole on a part.

use super::given::GivenMotion;
use crate::error::{Error, Result};
use crate::evaluate::Surface;
use crate::evaluate::rigidity::best_rigid;
use crate::findings;
use crate::geometry::{Grid, Rigid};
use crate::skeleton::{Bone, Skeleton};
use crate::volume::LabelMap;
use crate::warning::Warning;
use nalgebra::{Matrix3, Point3, Rotation3, SymmetricEigen, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Vertices of a surface that take part, about.
const VERTICES: usize = 1500;
/// Every so-manieth of them, and rounds of closest points, for each start.
const COARSE: (usize, usize) = (8, 25);
/// Rounds of closest points with all of them: a long bone slides home slowly.
const ROUNDS: usize = 100;
/// Distances beyond count as this, mm.
const MOST_MM: f64 = 10.0;
/// A round that moves a bone by less has settled, mm and radians of its vertices.
const SETTLED_MM: f64 = 5e-4;
/// Pairs farther apart than this many times the middle one are left out, but for the least distance, mm.
const TRIM: f64 = 2.5;
const LEAST_TRIM_MM: f64 = 6.0;
/// Whole labels of one bone have volumes of at least this ratio.
const LEAST_RATIO: f64 = 0.6;
/// And of labels that an edge cuts: more cut off leaves their place along the bone open.
const LEAST_CUT: f64 = 0.8;
/// Labels whose volumes are nearer than this share seek each other.
const ALIKE: f64 = 0.1;
/// A turn by the principal axes must fit so much better than none: vertebrae are nearly their own mirror images.
const BETTER: f64 = 0.8;
/// Labels that stay farther apart than this, or than a mean voxel edge, are no labels of one bone, rms mm.
const MOST_RMS_MM: f64 = 1.5;
/// Share of a label's error that its bone's place has: a label's surface errs in patches, not voxel by voxel.
const PLACE: f64 = 0.5;
/// Lengths that differ by less are of one bone, mm.
const LEAST_ROOM_MM: f64 = 3.0;
/// Fewer vertices tell no turn.
const FEWEST: usize = 50;
/// A bone that the image places farther from its label's place than this is told, mm.
const CONTRADICTS_MM: f64 = 3.0;

/// Each bone's motion by its labels in both scans, in the order of the skeleton; `None` for bones without, or whose labels do
/// not fit each other, which are told.
///
/// # Errors
/// [`Error::Input`] when no bone has a label in both scans that fits.
pub fn from_labels(
    skeleton: &Skeleton,
    planning: &LabelMap,
    fraction: &LabelMap,
) -> Result<(Vec<Option<GivenMotion>>, Vec<Warning>)> {
    let edge = [planning, fraction].iter().map(|m| m.volume.grid().mean_edge()).fold(0.0, f64::max);
    let bound = MOST_RMS_MM.max(edge);
    let found: Vec<Option<Fitted>> =
        skeleton.bones.par_iter().with_max_len(1).map(|bone| fitted(bone, planning, fraction)).collect();
    let mut warnings = Vec::new();
    let mut motion = |(bone, found): (&Bone, Option<Fitted>)| {
        let Fitted { transform, rms } = found?;
        if rms > bound {
            let why = if rms.is_finite() {
                format!("stay {rms:.1} mm apart (rms, at most {bound:.1})")
            } else {
                "show unlike parts of it, so that its place along them is not known".to_owned()
            };
            let message = format!("{}: its labels in planning and fraction {why}: they are not used", bone.name);
            warnings.push(Warning::new(findings::FRACTION_LABEL_UNLIKE, message));
            return None;
        }
        let source = format!("labels of both scans, {rms:.2} mm rms");
        Some(GivenMotion { transform, position_sd_mm: PLACE * rms, source })
    };
    let motions: Vec<_> = skeleton.bones.iter().zip(found).map(&mut motion).collect();
    if motions.iter().all(Option::is_none) {
        let names: Vec<&str> = fraction.names.values().map(String::as_str).take(8).collect();
        return Err(Error::input(
            "the fraction's bone labels",
            format!(
                "no bone of the skeleton has labels in both scans that fit; the fraction's are {}",
                names.join(", ")
            ),
            "name the fraction's labels as planning's, or leave them out",
        ));
    }
    Ok((motions, warnings))
}

/// Bones that the image has placed elsewhere than their labels say.
pub fn contradictions(skeleton: &Skeleton, by_labels: &[Option<GivenMotion>], transforms: &[Rigid]) -> Vec<Warning> {
    let all = skeleton.bones.iter().zip(by_labels).zip(transforms);
    let told = all.filter_map(|((bone, label), image)| {
        let label = label.as_ref()?;
        let apart = (label.transform * bone.centroid - image * bone.centroid).norm();
        (apart > CONTRADICTS_MM).then(|| {
            let message = format!("{}: the image places it {apart:.1} mm from where its labels say", bone.name);
            Warning::new(findings::FRACTION_LABEL_CONTRADICTS, message)
        })
    });
    told.collect()
}

/// A bone laid on its label in the fraction.
struct Fitted {
    transform: Rigid,
    /// Root mean square distance of the label that seeks from the other's surface, mm.
    rms: f64,
}

/// A label's surface with what of it is no cut.
struct Side {
    surface: Surface,
    vertices: Vec<Point3<f64>>,
    volume: f64,
    /// What its scan shows.
    grid: Grid,
    /// Whether no edge of the scan cuts it.
    whole: bool,
}

impl Side {
    fn of(labels: &LabelMap, label: u16) -> Option<Self> {
        let grid = labels.volume.grid();
        let surface = Surface::of(&labels.volume, |l| l == label)?;
        let whole: Vec<Point3<f64>> = surface.vertices.iter().filter(|v| !at_the_edge(grid, v)).copied().collect();
        let uncut = whole.len() == surface.vertices.len();
        let every = whole.len().div_ceil(VERTICES).max(1);
        let vertices: Vec<_> = whole.into_iter().step_by(every).collect();
        let voxels = labels.volume.data().par_iter().filter(|l| **l == label).count();
        let volume = voxels as f64 * grid.voxel_volume();
        (vertices.len() >= FEWEST).then(|| Self { surface, vertices, volume, grid: grid.clone(), whole: uncut })
    }

    fn centre(&self) -> Vector3<f64> {
        self.vertices.iter().map(|v| v.coords).sum::<Vector3<f64>>() / self.vertices.len() as f64
    }

    /// Its length along a direction, mm.
    fn length(&self, along: &Vector3<f64>) -> f64 {
        let places = self.vertices.iter().map(|v| along.dot(&v.coords));
        let [low, high] = places.fold([f64::MAX, f64::MIN], |[low, high], p| [low.min(p), high.max(p)]);
        high - low
    }

    /// Principal axes of its vertices, a right-handed frame, the longest first.
    fn axes(&self) -> Matrix3<f64> {
        let centre = self.centre();
        let spread = self.vertices.iter().fold(Matrix3::zeros(), |m, v| {
            let d = v.coords - centre;
            m + d * d.transpose()
        });
        let eigen = SymmetricEigen::new(spread);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [x, y] = [order[0], order[1]].map(|n| eigen.eigenvectors.column(n).into_owned());
        Matrix3::from_columns(&[x, y, x.cross(&y)])
    }
}

/// Whether a point lies outside of a grid or in its outermost layer, where a label may be cut.
fn at_the_edge(grid: &Grid, p: &Point3<f64>) -> bool {
    let (index, size) = (grid.index(p), grid.size());
    (0..3).any(|a| index[a] < 0.5 || index[a] > size[a] as f64 - 1.5)
}

fn fitted(bone: &Bone, planning: &LabelMap, fraction: &LabelMap) -> Option<Fitted> {
    let label = fraction.names.iter().find(|(_, name)| **name == bone.name).map(|(label, _)| *label)?;
    let (from, to) = (Side::of(planning, bone.label)?, Side::of(fraction, label)?);
    // Half of a smooth bone slides along the whole without a better or a worse place (7 mm in the test below).
    let least = if from.whole && to.whole { LEAST_RATIO } else { LEAST_CUT };
    if !(least..=1.0 / least).contains(&(to.volume / from.volume)) {
        return Some(Fitted { transform: Rigid::identity(), rms: f64::INFINITY });
    }
    let (own, other) = (from.axes(), to.axes());
    let coarse = |turn: &Matrix3<f64>| {
        // Part of a long bone may be either end of it.
        let along = turn * own.column(0);
        let room = 0.5 * (from.length(&own.column(0).into_owned()) - to.length(&along));
        let slides: &[f64] = if room.abs() > LEAST_ROOM_MM { &[0.0, -1.0, 1.0] } else { &[0.0] };
        let tried = slides.iter().map(|slide| {
            let start = start(&from, &to, turn, &(along * (slide * room)));
            closest_points(&from, &to, start, COARSE.0, COARSE.1)
        });
        tried.min_by(|a, b| a.rms.total_cmp(&b.rms))
    };
    let plain = coarse(&Matrix3::identity())?;
    let turns = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|[a, b]| {
        let flipped = Matrix3::from_columns(&[other.column(0) * a, other.column(1) * b, other.column(2) * (a * b)]);
        flipped * own.transpose()
    });
    let turned = turns.iter().filter_map(coarse).min_by(|a, b| a.rms.total_cmp(&b.rms))?;
    let best = if turned.rms < BETTER * plain.rms { turned } else { plain };
    Some(closest_points(&from, &to, best.transform, 1, ROUNDS))
}

/// A turn about the centres and a shift of them, as a start.
fn start(from: &Side, to: &Side, turn: &Matrix3<f64>, slide: &Vector3<f64>) -> Rigid {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*turn));
    Rigid::from_parts(Translation3::from(to.centre() + slide - turn * from.centre()), turn)
}

/// Closest points from a start, with every so-manieth vertex.
fn closest_points(from: &Side, to: &Side, start: Rigid, every: usize, rounds: usize) -> Fitted {
    let ratio = to.volume / from.volume;
    let seeks = [ratio < 1.0 + ALIKE, ratio > 1.0 - ALIKE];
    let [own, other] = [from, to].map(|side| side.vertices.iter().step_by(every).copied().collect::<Vec<_>>());
    let mut fitted = Fitted { transform: start, rms: f64::INFINITY };
    for _ in 0..rounds {
        let transform = fitted.transform;
        let mut pairs: Vec<(Point3<f64>, Point3<f64>)> = Vec::new();
        if seeks[0] {
            // The fraction's label, as far as it is there, lies on planning's.
            let back = transform.inverse();
            let shown = |v: &&Point3<f64>| !at_the_edge(&from.grid, &(back * *v));
            let seen: Vec<Point3<f64>> = other.iter().filter(shown).copied().collect();
            let there: Vec<Point3<f64>> = seen.iter().map(|v| back * v).collect();
            pairs.extend(from.surface.closest(&there).into_iter().zip(seen));
        }
        if seeks[1] {
            let shown = |v: &&Point3<f64>| !at_the_edge(&to.grid, &(transform * *v));
            let seen: Vec<Point3<f64>> = own.iter().filter(shown).copied().collect();
            let moved: Vec<Point3<f64>> = seen.iter().map(|v| transform * v).collect();
            pairs.extend(seen.into_iter().zip(to.surface.closest(&moved)));
        }
        let apart = |pair: &(Point3<f64>, Point3<f64>)| (transform * pair.0 - pair.1).norm();
        if pairs.len() < FEWEST.min(own.len().min(other.len())) {
            break;
        }
        let mut distances: Vec<f64> = pairs.iter().map(apart).collect();
        // What is left out of the fit still speaks against it.
        let square: f64 = distances.iter().map(|mm| mm.min(MOST_MM).powi(2)).sum();
        fitted.rms = (square / distances.len().max(1) as f64).sqrt();
        distances.sort_by(f64::total_cmp);
        let bound = (TRIM * distances.get(distances.len() / 2).copied().unwrap_or(0.0)).max(LEAST_TRIM_MM);
        pairs.retain(|pair| apart(pair) <= bound);
        let next = best_rigid(pairs.iter().copied());
        let step = own.iter().map(|v| (next * v - transform * v).norm()).fold(0.0, f64::max);
        fitted.transform = next;
        if step < SETTLED_MM {
            break;
        }
    }
    fitted
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Volume;
    use std::collections::BTreeMap;

    const NAMES: [&str; 2] = ["vertebrae_C5", "humerus_left"];

    /// A lopsided body and a long bent one, moved rigidly each, on a grid.
    fn labels(grid: &Grid, motions: &[Rigid; 2]) -> LabelMap {
        let back = motions.map(|m| m.inverse());
        let inside = |y: &Point3<f64>| {
            let p = back[0] * y;
            let body = ((p.x / 14.0).powi(2) + (p.y / 11.0).powi(2) + (p.z / 8.0).powi(2)) < 1.0;
            let process = (p.x - 3.0).abs() < 4.0 && (8.0..26.0).contains(&p.y) && (p.z + 2.0).abs() < 4.0;
            if body || process {
                return 1;
            }
            let q = back[1] * y;
            let along = q.x - 60.0;
            let bend = 0.004 * along.powi(2);
            let thick = if along > 25.0 { 9.0 } else { 6.0 };
            let near = (q.y - bend).hypot(q.z) < thick && along.abs() < 40.0;
            if near { 2 } else { 0 }
        };
        let volume = Volume::from_fn(grid.clone(), |l| inside(&grid.centre(grid.voxel(l))));
        let names = NAMES.iter().enumerate().map(|(n, name)| (n as u16 + 1, (*name).to_owned())).collect();
        LabelMap { volume, names }
    }

    fn skeleton(labels: &LabelMap) -> Skeleton {
        crate::skeleton::build(labels).unwrap().skeleton
    }

    fn grid(size: [usize; 3], spacing: [f64; 3], origin: [f64; 3]) -> Grid {
        Grid::axis_aligned(size, spacing, origin).unwrap()
    }

    fn whole() -> Grid {
        grid([76, 60, 50], [2.0, 2.0, 2.5], [-40.0, -50.0, -60.0])
    }

    fn rigid(shift: [f64; 3], turn_deg: [f64; 3]) -> Rigid {
        Rigid::new(Vector3::from(shift), Vector3::from(turn_deg).map(f64::to_radians))
    }

    /// Root mean square distance of each bone's points from where they truly go, mm.
    fn errors(planning: &LabelMap, fraction: &LabelMap, truth: &[Rigid; 2]) -> Vec<f64> {
        let skeleton = skeleton(planning);
        let (motions, warnings) = from_labels(&skeleton, planning, fraction).unwrap();
        assert_eq!(warnings, []);
        let one = |(bone, motion): (&Bone, Option<GivenMotion>)| {
            let true_motion = &truth[usize::from(bone.label) - 1];
            let found = motion.expect("both bones have labels").transform;
            let side = Side::of(planning, bone.label).unwrap();
            let square: f64 = side.vertices.iter().map(|v| (found * v - true_motion * v).norm_squared()).sum();
            (square / side.vertices.len() as f64).sqrt()
        };
        skeleton.bones.iter().zip(motions).map(one).collect()
    }

    #[test]
    fn bones_are_found_wherever_they_went() {
        let still = [Rigid::identity(); 2];
        let planning = labels(&whole(), &still);
        let there = grid([120, 110, 90], [1.5, 2.0, 2.0], [-60.0, -110.0, -80.0]);
        let near = [rigid([5.0, -4.0, 3.0], [6.0, -8.0, 10.0]), rigid([2.0, 3.0, -5.0], [0.0, 12.0, -9.0])];
        for truth in [near, [rigid([-12.0, 6.0, 8.0], [20.0, 5.0, 30.0]), rigid([-20.0, 10.0, 5.0], [0.0, 0.0, -75.0])]]
        {
            let errors = errors(&planning, &labels(&there, &truth), &truth);
            assert!(errors.iter().all(|mm| *mm < 1.0), "{errors:?}");
        }
    }

    #[test]
    fn a_bone_of_which_one_scan_shows_half_is_told_and_not_used() {
        let planning = labels(&whole(), &[Rigid::identity(); 2]);
        let truth = [rigid([3.0, -2.0, 4.0], [4.0, 0.0, 6.0]), rigid([3.0, -2.0, 4.0], [0.0, 6.0, 0.0])];
        // The edge cuts the long bone in half.
        let cut = labels(&grid([52, 60, 60], [2.0, 2.0, 2.0], [-40.0, -50.0, -60.0]), &truth);
        let full = labels(&whole(), &truth);
        let share =
            |l: &LabelMap| l.volume.data().iter().filter(|v| **v == 2).count() as f64 * l.volume.grid().voxel_volume();
        assert!(share(&cut) < 0.7 * share(&full));
        let skeleton = skeleton(&planning);
        let (motions, warnings) = from_labels(&skeleton, &planning, &cut).unwrap();
        let used: Vec<&str> =
            skeleton.bones.iter().zip(&motions).filter(|(_, m)| m.is_some()).map(|(b, _)| b.name.as_str()).collect();
        assert_eq!(used, ["vertebrae_C5"]);
        assert!(warnings.len() == 1 && warnings[0].message.contains("humerus_left: its labels"), "{warnings:?}");
    }

    #[test]
    fn labels_of_another_bone_are_told_and_none_at_all_is_refused() {
        let planning = labels(&whole(), &[Rigid::identity(); 2]);
        let skeleton = skeleton(&planning);
        let mut swapped = labels(&whole(), &[Rigid::identity(); 2]);
        swapped.names = [(2, NAMES[0].to_owned()), (1, "sacrum".to_owned())].into();
        let refused = from_labels(&skeleton, &planning, &swapped).unwrap_err().to_string();
        assert!(refused.contains("no bone of the skeleton has labels in both scans"), "{refused}");
        swapped.names = BTreeMap::from([(1, NAMES[0].to_owned()), (2, NAMES[1].to_owned())]);
        swapped.volume = swapped.volume.map(|l| if *l == 2 { 1 } else { 2 * u16::from(*l == 1) });
        let mut half = swapped.clone();
        half.names.insert(3, NAMES[1].to_owned());
        assert!(from_labels(&skeleton, &planning, &swapped).is_err());
        // A bone that the image has placed elsewhere.
        let (motions, _) = from_labels(&skeleton, &planning, &planning).unwrap();
        let elsewhere = [rigid([0.0; 3], [0.0; 3]), rigid([0.0, 4.0, 0.0], [0.0; 3])];
        let told = contradictions(&skeleton, &motions, &elsewhere);
        assert!(told.len() == 1 && told[0].message.contains("4.0 mm"), "{told:?}");
    }
}
