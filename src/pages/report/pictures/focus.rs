//! Which planes matter: the level of the largest residual, the middle of the spine, the bone that
//! moves most.

use super::super::plane::{KINDS, Kind, Region};
use crate::pipeline::{Outcome, is_placed, moves_most};
use nalgebra::Point3;

/// What the bones of the spine are called.
const SPINE: &str = "vertebrae_";
/// Least part of the patient's mean section that a plane shows.
const LEAST_SHARE: f64 = 0.5;

/// A place in the planning CT, the one that it corresponds to in the fraction, and what it is. Its
/// coordinates need not belong together: the axial plane takes one, the coronal one another, the
/// sagittal one the third.
pub(in crate::report) struct Focus {
    pub(super) from: Point3<f64>,
    pub(in crate::report) to: Point3<f64>,
    /// What the planes go through.
    pub(super) told: String,
}

/// Where an axial, a coronal and a sagittal plane show what matters, of what lies in these boxes of planning and fraction;
/// `middles` where nothing does.
pub(in crate::report) fn focus(
    outcome: &Outcome,
    [planning, fraction]: [Option<Region>; 2],
    middles: [Point3<f64>; 2],
) -> Focus {
    let within = |region: &Option<Region>, p: &Point3<f64>| region.as_ref().is_some_and(|r| r.contains(p));
    let seen = |(from, to, _): &(Point3<f64>, Point3<f64>, String)| within(&planning, from) && within(&fraction, to);
    let bone =
        moved(outcome).filter(|(_, place)| seen(place)).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, place)| place);
    let spine: Vec<_> = spine(outcome).filter(|(from, to)| within(&planning, from) && within(&fraction, to)).collect();
    let middle = |n: usize| {
        let x = |pair: &(Point3<f64>, Point3<f64>)| if n == 0 { pair.0.x } else { pair.1.x };
        spine.iter().map(x).sum::<f64>() / spine.len() as f64
    };
    let worst =
        residual(outcome).filter(|(_, place)| seen(place)).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, place)| place);
    let [mut from, mut to] = bone.as_ref().map_or(middles, |(from, to, _)| [*from, *to]);
    let most = bone.map_or("the middle of the scans".to_owned(), |(.., what)| what);
    let mut told = Vec::new();
    if let Some((planning, fraction, what)) = worst {
        (from.z, to.z) = (planning.z, fraction.z);
        told.push(format!("axial at {what}"));
    }
    if !spine.is_empty() {
        (from.x, to.x) = (middle(0), middle(1));
        told.push("sagittal through the middle of the spine".into());
    }
    let others = match (told.len(), spine.is_empty()) {
        (2, _) => "coronal",
        (0, _) => "all",
        (_, true) => "coronal and sagittal",
        (_, false) => "axial and coronal",
    };
    told.push(format!("{others} through {most}"));
    Focus { from, to, told: told.join(", ") }
}

/// Motion of each placed bone apart from the couch shift, mm, its centroid in planning and
/// fraction, and its description.
fn moved(outcome: &Outcome) -> impl Iterator<Item = (f64, (Point3<f64>, Point3<f64>, String))> {
    let own = outcome.own_motion_mm();
    let most = moves_most(&outcome.bone_fits, &own);
    let bones = outcome.skeleton.bones.iter().zip(&outcome.bone_fits).zip(own).enumerate();
    bones.filter(|(_, ((_, fit), _))| is_placed(fit)).map(move |(n, ((bone, fit), mm))| {
        let which = if most == Some(n) { "the bone that moves most" } else { "the bone in view that moves most" };
        let what = format!("{which} apart from the couch shift: {} ({mm:.1} mm)", bone.name);
        (mm, (bone.centroid, fit.transform * bone.centroid, what))
    })
}

/// Centroids of the spine's bones in planning and fraction.
fn spine(outcome: &Outcome) -> impl Iterator<Item = (Point3<f64>, Point3<f64>)> {
    let bones = outcome.skeleton.bones.iter().zip(&outcome.bone_fits);
    bones
        .filter(|(bone, _)| bone.name.starts_with(SPINE))
        .map(|(bone, fit)| (bone.centroid, fit.transform * bone.centroid))
}

/// Residual of each landmark, mm, where it is in planning and fraction, and its description.
fn residual(outcome: &Outcome) -> impl Iterator<Item = (f64, (Point3<f64>, Point3<f64>, String))> {
    let each = outcome.landmarks.iter().flat_map(|report| &report.each);
    each.filter_map(|r| {
        let after = r.after?;
        let what = format!("the level of the largest residual, {} ({after:.1} mm)", r.landmark.name);
        Some((after, (r.landmark.planning, r.landmark.fraction, what)))
    })
}

/// The place nearest to `p` whose planes each show half of the patient's mean section at least.
/// `points` fill the patient, about `apart` mm from each other.
pub(in crate::report) fn in_the_patient(points: &[Point3<f64>], p: &Point3<f64>, apart: f64) -> Point3<f64> {
    let mut place = *p;
    for kind in KINDS {
        place[kind.across()] = level(points, kind, p[kind.across()], apart);
    }
    place
}

/// The same along the axis across the planes of one kind.
fn level(points: &[Point3<f64>], kind: Kind, at: f64, apart: f64) -> f64 {
    let a = kind.across();
    let low = points.iter().map(|q| q[a]).fold(f64::INFINITY, f64::min);
    let mut sections: Vec<usize> = Vec::new();
    for q in points {
        let n = ((q[a] - low) / apart) as usize;
        sections.resize(sections.len().max(n + 1), 0);
        sections[n] += 1;
    }
    let mean = points.len() as f64 / sections.len().max(1) as f64;
    let shows = |n: &usize| sections[*n] as f64 >= LEAST_SHARE * mean;
    let own = (at - low) / apart;
    if own >= 0.0 && (own as usize) < sections.len() && shows(&(own as usize)) {
        return at;
    }
    let centre = |n: usize| low + (n as f64 + 0.5) * apart;
    let all = (0..sections.len()).filter(shows).map(centre);
    all.min_by(|a, b| (a - at).abs().total_cmp(&(b - at).abs())).unwrap_or(at)
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;

    #[test]
    fn planes_go_through_the_worst_landmark_the_spine_and_the_bone_that_moves_most() {
        let (_, mut outcome, _) = example::small();
        let everywhere = || {
            let low = Point3::new(-500.0, -500.0, -500.0);
            Some(Region { low, high: -low })
        };
        let middles = [Point3::origin(); 2];
        let seen = focus(&outcome, [everywhere(), everywhere()], middles);
        let worst = &outcome.landmarks.as_ref().unwrap().each[11];
        assert!(
            (seen.to.z - worst.landmark.fraction.z).abs() < 1e-9
                && (seen.from.z - worst.landmark.planning.z).abs() < 1e-9
        );
        let [spine, skull] = [0, 1].map(|n| outcome.bone_fits[n].transform * outcome.skeleton.bones[n].centroid);
        assert!((seen.to.x - spine.x).abs() < 1e-9 && (seen.to.y - skull.y).abs() < 1e-9, "{}", seen.to);
        assert!(
            seen.told.contains("landmark_11") && seen.told.contains("spine") && seen.told.contains("skull"),
            "{}",
            seen.told
        );
        // Without landmarks the axial plane goes through that bone too.
        outcome.landmarks = None;
        let seen = focus(&outcome, [everywhere(), everywhere()], middles);
        assert!((seen.to.z - skull.z).abs() < 1e-9 && seen.told.contains("axial and coronal through"), "{}", seen.told);
        // Where nothing is seen: the middles.
        let seen = focus(&outcome, [None, None], middles);
        assert_eq!((seen.from, seen.to), (middles[0], middles[1]));
    }

    #[test]
    fn a_plane_that_hardly_meets_the_patient_is_moved_to_where_it_does() {
        // A trunk of 200 x 100 x 200 mm with a thin arm far to the left.
        let mut points = Vec::new();
        for k in 0..50 {
            for j in 0..25 {
                for i in 0..100 {
                    let p = Point3::new(f64::from(i) * 4.0, f64::from(j) * 4.0, f64::from(k) * 4.0);
                    if i < 50 || (j < 5 && k < 10) {
                        points.push(p);
                    }
                }
            }
        }
        let inside = Point3::new(100.0, 50.0, 20.0);
        assert_eq!(in_the_patient(&points, &inside, 4.0), inside);
        let moved = in_the_patient(&points, &Point3::new(300.0, 50.0, 20.0), 4.0);
        assert!((moved - Point3::new(198.0, 50.0, 20.0)).norm() < 1e-9, "{moved}");
        assert!((in_the_patient(&points, &Point3::new(100.0, 900.0, 20.0), 4.0).y - 98.0).abs() < 1e-9);
    }
}
