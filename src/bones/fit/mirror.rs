//! Whether the fraction shows the patient as he is, his mirror image, or turned: what the bones explain best.
//!
//! A head or a rib cage is nearly symmetric, so that the bones of a mirrored scan are found all the same, a few millimetres
//! off. What tells is which of the two explains the fraction better: the bones as they are, or reflected left to right
//! (docs/decisions/inputs.md).

use super::planning::START_SAMPLES;
use super::problem::{Body, PoseProblem};
use super::samples::Samples;
use super::similarity::Measure;
use super::solver::solve;
use super::start::upright_motions;
use super::tissue::Tissue;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Rigid;
use crate::warning::Warning;
use nalgebra::{Matrix3, Point3, Vector3};

/// Shares of the bones' contrast that the fraction explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Twins {
    /// By the bones as they are: at their best rigid motion, or as the fit has posed them where that is more. The bones of a
    /// short scan of a bent neck are nearer to their rigid mirror image than to themselves.
    pub(super) own: f64,
    /// By their reflection in the sagittal plane (x, LPS) through their centre, at its best rigid motion.
    pub(super) mirrored: f64,
    /// A mirror image that leaves at most this part of what the bones leave unexplained is what the fraction shows.
    pub(super) sure: f64,
}

/// A mirror image that leaves at most this part of what the bones leave unexplained is what the fraction shows. Of one patient's
/// pairs it left 1.3 to 30 times as much, of mirrored ones 0.2 to 0.4 of it.
const SURE: f64 = 0.85;
/// The same of bones that each lie where the fit has them. In short mirrored scans their mirror image left 0.60 to 0.84 of what
/// they leave, in one view of a nearly symmetric phantom that is not mirrored 0.97.
const SURE_POSED: f64 = 0.92;

/// A set of bones about its centre.
struct Bones<'a> {
    samples: &'a Samples,
    centre: Point3<f64>,
    radius: f64,
}

impl<'a> Bones<'a> {
    fn new(samples: &'a Samples) -> Self {
        let n = samples.points.len().max(1) as f64;
        let centre = Point3::from(samples.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
        let square = samples.points.iter().map(|p| (p - centre).norm_squared()).sum::<f64>() / n;
        Self { samples, centre, radius: square.sqrt().max(1.0) }
    }

    /// What they explain at the best rigid motion near `start`: (share of their contrast, share of them in view).
    fn explained(&self, fraction: &Tissue, start: &Rigid, measure: Measure) -> Result<(f64, f64)> {
        let body = |base| Body {
            samples: self.samples,
            base,
            centre: self.centre,
            radius: self.radius,
            held: None,
            shape: None,
        };
        let problem =
            || PoseProblem { bodies: vec![body(*start)], links: Vec::new(), fraction: Some(fraction), measure };
        let solution = solve(problem(), 0.05, 40)?;
        let t = problem().transforms(&solution.x)[0];
        let seen = &problem().similarities(&[t], false)[0];
        Ok((seen.explained, seen.visible))
    }
}

/// The samples under a linear map about a point.
fn under(samples: &Samples, centre: &Point3<f64>, map: &Matrix3<f64>) -> Samples {
    Samples { points: samples.points.iter().map(|p| centre + map * (p - centre)).collect(), ..samples.clone() }
}

/// All bones as one, where the fit has them; each with the part of the samples that it has of the volume.
pub(super) fn posed(bones: &[Samples], transforms: &[Rigid]) -> Samples {
    let volume_mm3 = bones.iter().map(|b| b.volume_mm3).sum::<f64>();
    let mut all = Samples { volume_mm3, ..Samples::default() };
    for (bone, t) in bones.iter().zip(transforms) {
        let share = START_SAMPLES as f64 * bone.volume_mm3 / volume_mm3.max(1.0);
        let every = (bone.points.len() as f64 / share.max(1.0)).ceil().max(1.0) as usize;
        all.points.extend(bone.points.iter().step_by(every).map(|p| t * p));
        all.values.extend(bone.values.iter().step_by(every));
        all.memberships.extend(bone.memberships.iter().step_by(every));
    }
    all
}

/// What is compared at one resolution.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    /// All bones as planning shows them.
    pub(super) samples: &'a Samples,
    /// The fraction.
    pub(super) fraction: &'a Tissue,
}

/// Refines the bones and their mirror image from `start` (planning to fraction, LPS mm). `posed` are the bones in the fraction.
///
/// # Errors
/// As the solver.
pub(super) fn twins(
    Seen { samples, fraction }: Seen<'_>,
    posed: &Samples,
    start: &Rigid,
    measure: Measure,
) -> Result<Twins> {
    let reflected = reflected(samples);
    let share =
        |samples: &Samples, start: &Rigid| Ok::<_, Error>(Bones::new(samples).explained(fraction, start, measure)?.0);
    let own = share(samples, start)?.max(share(posed, &Rigid::identity())?);
    Ok(Twins { own, mirrored: share(&reflected, start)?, sure: SURE })
}

/// As [`twins`], of bones that have no common motion: the bones as the fit has posed them, and their mirror image. In few bones
/// only a finer image than the start's tells them apart.
///
/// # Errors
/// As the solver.
pub(super) fn posed_twins(fraction: &Tissue, posed: &Samples, measure: Measure) -> Result<Twins> {
    let share =
        |samples: &Samples| Ok::<_, Error>(Bones::new(samples).explained(fraction, &Rigid::identity(), measure)?.0);
    Ok(Twins { own: share(posed)?, mirrored: share(&reflected(posed))?, sure: SURE_POSED })
}

/// Reflected in the sagittal plane through their centre.
fn reflected(samples: &Samples) -> Samples {
    under(samples, &Bones::new(samples).centre, &Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0)))
}

impl Twins {
    /// Both shares in words.
    fn both(self) -> String {
        format!(
            "the planning CT's bones explain {:.0} % of the fraction's bone contrast as they are, and {:.0} % mirrored \
             left to right",
            100.0 * self.own,
            100.0 * self.mirrored
        )
    }

    /// What they say of the fraction: nothing, or that it may be mirrored.
    ///
    /// # Errors
    /// [`Error::Registration`] where the fraction shows the mirror image.
    pub(super) fn judge(self) -> Result<Option<Warning>> {
        if 1.0 - self.mirrored < self.sure * (1.0 - self.own) {
            return Err(Error::failed(
                findings::FRACTION_MIRRORED,
                format!("the fraction looks like the mirror image of the planning CT: {}", self.both()),
                "look at the heart, the liver or a marked side in both scans: where one is mirrored, write the file anew from \
                 its DICOM series or correct the sign of its x axis; where neither is, the bones were found at a wrong place: \
                 give --start or --bone-landmarks",
            ));
        }
        Ok(self.doubt())
    }

    /// As [`Twins::judge`] of a single bone, which looks like its mirror image: a word at most.
    pub(super) fn doubt(self) -> Option<Warning> {
        (self.mirrored >= self.own).then(|| {
            let message = format!(
                "{}: they are too nearly symmetric to tell a mirrored scan; check left and right in the fusion images",
                self.both()
            );
            Warning::new(findings::SIDE_UNSURE, message)
        })
    }
}

/// Ways in which a scan comes to lie in another way than its header says.
fn ways() -> Vec<(&'static str, Matrix3<f64>)> {
    let diagonal = |x: f64, y: f64, z: f64| Matrix3::from_diagonal(&Vector3::new(x, y, z));
    let turn = |axis: usize, sign: f64| {
        let [b, c] = [(axis + 1) % 3, (axis + 2) % 3];
        let mut m = Matrix3::zeros();
        m[(axis, axis)] = 1.0;
        m[(c, b)] = sign;
        m[(b, c)] = -sign;
        m
    };
    vec![
        ("mirrored left to right", diagonal(-1.0, 1.0, 1.0)),
        ("mirrored front to back", diagonal(1.0, -1.0, 1.0)),
        ("mirrored head to foot", diagonal(1.0, 1.0, -1.0)),
        ("turned by 180 degrees about the long axis (supine for prone)", diagonal(-1.0, -1.0, 1.0)),
        ("turned head for foot, by 180 degrees about the left-right axis", diagonal(1.0, -1.0, -1.0)),
        ("turned head for foot, by 180 degrees about the front-back axis", diagonal(-1.0, 1.0, -1.0)),
        ("turned by 90 degrees about the long axis", turn(2, 1.0)),
        ("turned by -90 degrees about the long axis", turn(2, -1.0)),
        ("turned by 90 degrees about the left-right axis", turn(0, 1.0)),
        ("turned by -90 degrees about the left-right axis", turn(0, -1.0)),
        ("turned by 90 degrees about the front-back axis", turn(1, 1.0)),
        ("turned by -90 degrees about the front-back axis", turn(1, -1.0)),
    ]
}

/// How much more of what is left a way must explain than the bones as they are, to be named as the likely cause.
const LIKELY: f64 = 0.15;

/// Less than this share says nothing: the bones of another region explain so much of a scan, turned some way.
const LEAST_LIKELY: f64 = 0.3;

/// The likely reason why no bone is found: the way in which the bones explain the fraction best. `coarse` and `fine` are the
/// bones and the fraction at the start's resolution and at a finer one; `explained` is what the bones explain there as they are.
pub(super) fn likely_way(
    coarse: Seen<'_>,
    fine: Seen<'_>,
    explained: f64,
    measure: Measure,
) -> Option<(&'static str, f64)> {
    let centre = Bones::new(coarse.samples).centre;
    let of_way = |(name, map): (&'static str, Matrix3<f64>)| {
        let starts = upright_motions(&under(coarse.samples, &centre, &map), coarse.fraction, measure).ok()?;
        let placed = under(fine.samples, &centre, &map);
        let bones = Bones::new(&placed);
        let shares = starts.iter().filter_map(|(t, _)| bones.explained(fine.fraction, t, measure).ok());
        let best = shares.map(|(share, visible)| share * visible).fold(0.0, f64::max);
        Some((name, best))
    };
    let best = ways().into_iter().filter_map(of_way).max_by(|a, b| a.1.total_cmp(&b.1))?;
    (best.1 > (explained.max(0.0) + LIKELY).max(LEAST_LIKELY)).then_some(best)
}

/// What the bones explain as they are, at the best rigid motion near `start`, times what of them is in view.
pub(super) fn as_they_are(samples: &Samples, fraction: &Tissue, start: &Rigid, measure: Measure) -> f64 {
    Bones::new(samples).explained(fraction, start, measure).map_or(0.0, |(share, visible)| share * visible)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_better_explained_twin_decides() {
        // Real pairs, a mirrored real head, and a symmetric phantom.
        for (own, mirrored) in [(0.83, 0.53), (0.32, 0.21), (0.82, 0.51), (0.695, 0.689)] {
            assert_eq!(Twins { own, mirrored, sure: SURE }.judge().unwrap(), None);
        }
        for (own, mirrored) in [(0.64, 0.92), (0.53, 0.83), (0.51, 0.82)] {
            let error = Twins { own, mirrored, sure: SURE }.judge().unwrap_err();
            assert_eq!((error.exit_code(), error.code()), (6, "fraction-mirrored"));
        }
        for (own, mirrored) in [(0.818, 0.847), (0.831, 0.868), (0.796, 0.830), (0.805, 0.883)] {
            let error = Twins { own, mirrored, sure: SURE_POSED }.judge().unwrap_err();
            assert_eq!(error.code(), "fraction-mirrored");
        }
        for (own, mirrored, sure) in [(0.689, 0.695, SURE), (0.667, 0.677, SURE_POSED)] {
            assert_eq!(Twins { own, mirrored, sure }.judge().unwrap().unwrap().code, "side-unsure");
        }
        // A piece of the skull alone in view, at its true place.
        assert!(Twins { own: 0.64, mirrored: 0.8, sure: SURE }.doubt().is_some_and(|w| w.is(findings::SIDE_UNSURE)));
    }

    #[test]
    fn ways_are_right_angles_and_the_mirrored_ones_are_no_rotations() {
        for (name, map) in ways() {
            assert!((map * map.transpose() - Matrix3::identity()).norm() < 1e-12, "{name}");
            assert_eq!(map.determinant() < 0.0, name.starts_with("mirrored"), "{name}");
        }
    }
}
