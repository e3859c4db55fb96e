//! Bone motions that come from elsewhere than the image: landmarks on bones (thesis 6.3.2), a pose by hand, a file.

use super::prior::BeyondRange;
use super::problem::{Body, End, Link, PoseProblem};
use super::samples::Samples;
use super::similarity::Measure;
use super::solver::solve;
use super::stop::Stop;
use super::{BoneFit, DeterminedBy, FitResult};
use crate::error::{Error, Result};
use crate::evaluate::rigidity::best_rigid;
use crate::geometry::Rigid;
use crate::skeleton::{Bone, Skeleton};
use nalgebra::{Point3, Translation3};
use serde::{Deserialize, Serialize};

/// A point on a bone, known in both images, LPS mm.
#[derive(Debug, Clone, PartialEq)]
pub struct BoneLandmark {
    /// Name of the bone it lies on.
    pub bone: String,
    /// Its own name.
    pub name: String,
    /// Where it is in planning.
    pub planning: Point3<f64>,
    /// Where it is in the fraction.
    pub fraction: Point3<f64>,
}

/// What bone landmarks do in a registration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LandmarkUse {
    /// They place the skeleton; the image then refines it.
    #[default]
    Start,
    /// They replace the image: bones with landmarks move as these say, the others follow their joints.
    Replace,
}

/// A bone's motion and where it comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct GivenMotion {
    /// Planning to fraction, LPS mm.
    pub transform: Rigid,
    /// Standard deviation of its position, mm; 0 for a motion that is exact by definition.
    pub position_sd_mm: f64,
    /// The source in words.
    pub source: String,
}

/// Least number of landmarks that determine a bone's motion.
const LEAST_POINTS: usize = 3;
/// Landmarks whose spread across their best line is below this, mm, leave the turn about that line open.
const LEAST_SPREAD_MM: f64 = 2.0;

/// The rigid motion of each bone that has landmarks, in the order of the skeleton; `None` for the others.
///
/// # Errors
/// [`Error::Input`] when a landmark names no bone of the skeleton, when a bone has fewer than three landmarks or all on one
/// line, or when there is none at all.
pub fn from_landmarks(skeleton: &Skeleton, landmarks: &[BoneLandmark]) -> Result<Vec<Option<GivenMotion>>> {
    if let Some(l) = landmarks.iter().find(|l| skeleton.bones.iter().all(|b| b.name != l.bone)) {
        return Err(Error::input(
            "bone landmarks",
            format!("landmark {} lies on {}, which is no bone of this skeleton", l.name, l.bone),
            "use the names that `aventail skeleton` shows",
        ));
    }
    if landmarks.is_empty() {
        return Err(Error::input("bone landmarks", "there is none", "give three or more on at least one bone"));
    }
    skeleton.bones.iter().map(|bone| one(bone, landmarks)).collect()
}

fn one(bone: &Bone, landmarks: &[BoneLandmark]) -> Result<Option<GivenMotion>> {
    let own: Vec<_> = landmarks.iter().filter(|l| l.bone == bone.name).map(|l| (l.planning, l.fraction)).collect();
    if own.is_empty() {
        return Ok(None);
    }
    if own.len() < LEAST_POINTS || spread(&own) < LEAST_SPREAD_MM {
        return Err(Error::input(
            "bone landmarks",
            format!("{} has {} landmarks, on a line within {:.1} mm", bone.name, own.len(), spread(&own)),
            "give three or more that span a triangle of some cm, or none on this bone",
        ));
    }
    let transform = best_rigid(own.iter().copied());
    let square: f64 = own.iter().map(|(p, f)| (transform * p - f).norm_squared()).sum();
    // Three coordinates each, less the six of the motion; the mean of n points has 1/n of the variance.
    let free = (3 * own.len()).saturating_sub(6).max(1) as f64;
    Ok(Some(GivenMotion {
        transform,
        position_sd_mm: (square / free / own.len() as f64).sqrt(),
        source: format!("{} landmarks, {:.2} mm rms", own.len(), (square / own.len() as f64).sqrt()),
    }))
}

/// Root mean square distance of the planning points from their best line, mm.
fn spread(points: &[(Point3<f64>, Point3<f64>)]) -> f64 {
    let n = points.len() as f64;
    let mean = points.iter().map(|p| p.0.coords).sum::<nalgebra::Vector3<f64>>() / n;
    let scatter = points.iter().fold(nalgebra::Matrix3::zeros(), |m, p| {
        let d = p.0.coords - mean;
        m + d * d.transpose()
    });
    let mut eigen = scatter.symmetric_eigenvalues();
    eigen.as_mut_slice().sort_by(f64::total_cmp);
    ((eigen[0] + eigen[1]).max(0.0) / n).sqrt()
}

/// Size of a bone for the solver's parameters, mm.
fn radius(bone: &Bone) -> f64 {
    bone.volume_mm3.max(1.0).cbrt()
}

/// All bones' motions from those of some: the others take the place that their joints like best.
///
/// # Errors
/// [`Error::Input`] when no bone's motion is given; of the solver.
pub fn follow(skeleton: &Skeleton, known: &[Option<GivenMotion>]) -> Result<Vec<Rigid>> {
    let bones = &skeleton.bones;
    let neighbours =
        |b: usize| (0..bones.len()).filter(move |&o| bones[b].parent == Some(o) || bones[o].parent == Some(b));
    // Outwards from the given bones, each first takes over its neighbour's motion.
    let mut start: Vec<Option<Rigid>> = known.iter().map(|k| k.as_ref().map(|k| k.transform)).collect();
    while let Some((b, t)) = (0..bones.len())
        .filter(|&b| start[b].is_none())
        .find_map(|b| neighbours(b).find_map(|o| start[o]).map(|t| (b, t)))
    {
        start[b] = Some(t);
    }
    let start: Option<Vec<Rigid>> = start.into_iter().collect();
    let mut out = start.ok_or_else(|| {
        Error::input(
            "bone motions",
            "none is given that all bones are joined to",
            "give the motion of one bone or more",
        )
    })?;
    let free: Vec<usize> = (0..bones.len()).filter(|&b| known[b].is_none()).collect();
    if free.is_empty() {
        return Ok(out);
    }
    let nothing = Samples::default();
    let end = |b: usize| free.iter().position(|&f| f == b).map_or(End::Held(out[b]), End::Moving);
    let body = |b: usize| Body {
        samples: &nothing,
        base: out[b],
        centre: bones[b].centroid,
        radius: radius(&bones[b]),
        held: None,
        shape: None,
    };
    let problem = PoseProblem {
        bodies: free.iter().map(|&b| body(b)).collect(),
        links: bones
            .iter()
            .enumerate()
            .filter_map(|(b, bone)| Some(Link { joint: &bone.joint, parent: end(bone.parent?), child: end(b) }))
            .collect(),
        fraction: None,
        measure: Measure::default(),
    };
    let bodies: Vec<Rigid> = {
        let solution = solve(problem, 1e-6, 200)?;
        let moved = |(n, &b): (usize, &usize)| body(b).transform(&solution.x.as_slice()[6 * n..6 * n + 6]);
        free.iter().enumerate().map(moved).collect()
    };
    for (&b, t) in free.iter().zip(bodies) {
        out[b] = t;
    }
    Ok(out)
}

/// The given motions as a fit: what a report needs to know about bones that no image has placed.
///
/// # Errors
/// [`Error::Input`] when no motion is given; of the solver.
pub fn given(skeleton: &Skeleton, known: &[Option<GivenMotion>]) -> Result<FitResult> {
    let transforms = follow(skeleton, known)?;
    let pose = skeleton.pose_of(&transforms);
    let excess = skeleton.excess(&pose);
    let bones = skeleton.bones.iter().enumerate().map(|(b, bone)| {
        let sd = known[b].as_ref().map_or(f64::MAX, |k| k.position_sd_mm);
        BoneFit {
            name: bone.name.clone(),
            transform: transforms[b],
            visible: 0.0,
            similarity_before: None,
            similarity_after: None,
            stop: known[b].as_ref().map_or(Stop::FollowsJoint, |k| Stop::Other(k.source.clone())),
            position_sd_mm: sd,
            rotation_sd_deg: if sd < f64::MAX { (sd / radius(bone)).to_degrees() } else { f64::MAX },
            unsettled_mm: 0.0,
            beyond_range: bone.parent.map(|_| BeyondRange::of(&excess[b])).unwrap_or_default(),
            motion_mm: (transforms[b] * bone.centroid - bone.centroid).norm(),
            determined_by: if known[b].is_some() { DeterminedBy::Given } else { DeterminedBy::Joint },
        }
    });
    // The whole skeleton's shift: of the largest bone that is given.
    let most = (0..known.len())
        .filter(|&b| known[b].is_some())
        .max_by(|&a, &b| skeleton.bones[a].volume_mm3.total_cmp(&skeleton.bones[b].volume_mm3).then(b.cmp(&a)));
    let common = most.map_or_else(Rigid::identity, |b| {
        let c = skeleton.bones[b].centroid;
        Rigid::from_parts(Translation3::from(transforms[b] * c - c), nalgebra::UnitQuaternion::identity())
    });
    Ok(FitResult {
        pose,
        bones: bones.collect(),
        transforms,
        common,
        common_share: 0.0,
        open: None,
        warnings: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::about;
    use crate::skeleton::Joint;
    use nalgebra::{Matrix3, Vector3};

    /// Three vertebrae in a row, 20 mm apart.
    fn spine() -> Skeleton {
        let bone = |n: usize| {
            let z = 20.0 * n as f64;
            Bone {
                name: format!("vertebrae_C{}", 7 - n),
                label: n as u16 + 1,
                parent: n.checked_sub(1),
                joint: Joint {
                    name: format!("j{n}"),
                    centre: Point3::new(0.0, 0.0, z - 10.0),
                    axes: Matrix3::identity(),
                    rotation_range_deg: [[-10.0, 10.0]; 3],
                    translation_range_mm: [2.0; 3],
                    source: String::new(),
                },
                centroid: Point3::new(0.0, 0.0, z),
                volume_mm3: 15_000.0,
            }
        };
        Skeleton { bones: (0..3).map(bone).collect() }
    }

    fn marks(bone: &str, t: &Rigid, at: &Point3<f64>) -> Vec<BoneLandmark> {
        let arms = [Vector3::x() * 15.0, Vector3::y() * 15.0, -Vector3::x() * 12.0, Vector3::z() * 5.0];
        let mark = |d: &Vector3<f64>| BoneLandmark {
            bone: bone.into(),
            name: "p".into(),
            planning: at + d,
            fraction: t * (at + d),
        };
        arms.iter().map(mark).collect()
    }

    #[test]
    fn a_bone_between_two_given_ones_shares_their_turn() {
        let s = spine();
        let turn = about(&Point3::new(0.0, 0.0, 20.0), Vector3::x() * 0.2, Vector3::new(30.0, 0.0, 0.0));
        let shift = Rigid::translation(30.0, 0.0, 0.0);
        let all =
            [marks("vertebrae_C7", &shift, &s.bones[0].centroid), marks("vertebrae_C5", &turn, &s.bones[2].centroid)];
        let known = from_landmarks(&s, &all.concat()).unwrap();
        let fit = given(&s, &known).unwrap();
        assert!((fit.transforms[2].to_homogeneous() - turn.to_homogeneous()).amax() < 1e-9);
        assert!((fit.transforms[0].to_homogeneous() - shift.to_homogeneous()).amax() < 1e-9);
        // Equal joints on both sides: half of the turn.
        assert!((fit.transforms[1].rotation.angle() - 0.1).abs() < 0.01, "{}", fit.transforms[1].rotation.angle());
        assert_eq!(fit.bones[1].determined_by, DeterminedBy::Joint);
        assert!((fit.common.translation.vector.x - 30.0).abs() < 1e-9);
    }

    #[test]
    fn too_few_collinear_or_foreign_landmarks_are_refused() {
        let s = spine();
        let all = marks("vertebrae_C7", &Rigid::identity(), &s.bones[0].centroid);
        let problem = |l: &[BoneLandmark]| from_landmarks(&s, l).unwrap_err().to_string();
        assert!(problem(&all[..2]).contains("2 landmarks"));
        let line: Vec<_> =
            (0..4).map(|n| BoneLandmark { planning: Point3::new(f64::from(n), 0.0, 0.0), ..all[0].clone() }).collect();
        assert!(problem(&line).contains("line"));
        assert!(problem(&[BoneLandmark { bone: "tail".into(), ..all[0].clone() }]).contains("tail"));
        assert!(problem(&[]).contains("none"));
        assert!(follow(&s, &[None, None, None]).is_err());
    }
}
