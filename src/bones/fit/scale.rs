//! Whether the fraction's bones are as large as the planning CT's, along each axis of the patient.
//!
//! A bone keeps its size from day to day; a slice thickness that is wrong in a header does not. Each bone is stretched about
//! its own centre, so that neither posture nor couch shift takes part, and the stretch that explains the fraction best is the
//! scale (docs/decisions/inputs.md).

use super::samples::Samples;
use super::similarity::{Measure, evaluate};
use super::tissue::Tissue;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Rigid;
use crate::skeleton::{Bone, Skeleton};
use crate::warning::Warning;
use nalgebra::{Point3, Vector3};

/// Stretches that are tried, besides none.
const TRIED: [f64; 4] = [0.9, 0.95, 1.05, 1.1];
/// Beyond this the header is wrong, and below it the scale may be of noise, partial volumes and metal.
const REFUSED: f64 = 0.06;
const DOUBTFUL: f64 = 0.03;
/// A stretch counts where it leaves at most this part of what is unexplained without it.
const BETTER: f64 = 0.9;
/// A stretch is no header's doing where jointed bones are known to lie less than this share of it farther apart.
const SHARED: f64 = 1.0 / 3.0;
/// Distances alone tell beyond this, head to foot and left to right: true pairs keep them within 1.2 %, whatever the bend, the
/// breath and voxels of up to 5 mm.
const LONG: f64 = 0.025;
/// Front to back they are 2.3 % off, and beyond this only support a stretch beyond [`SUPPORTED`].
const DISTANT: f64 = 0.05;
const SUPPORTED: f64 = 0.015;
/// Least pairs of jointed bones, and least distance of their centres along an axis, mm.
const PAIRS: usize = 4;
const LEAST_MM: f64 = 10.0;
/// Samples of a bone are thinned to about so many.
const MOST: usize = 600;

/// The scale along each axis (x, y, z of the fraction, LPS) that explains the fraction best, with the unexplained contrast at
/// it as a part of that without a stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    pub(super) factor: [f64; 3],
    pub(super) left: [f64; 3],
    /// How much farther apart than in planning the centres of jointed bones lie along each axis, the middle one of the pairs;
    /// nothing where fewer than [`PAIRS`] are found.
    pub(super) apart: [Option<f64>; 3],
}

/// A bone that the image determines: its samples, already where they belong in the fraction, and their centre.
struct Placed {
    samples: Samples,
    centre: Point3<f64>,
}

/// Measures the scale from bones at their fitted places; `determined` tells which of them the image has found, `apart` is that of
/// [`distances`].
pub(super) fn scale(
    bones: &[Samples],
    transforms: &[Rigid],
    determined: &[bool],
    apart: [Option<f64>; 3],
    fraction: &Tissue,
    measure: Measure,
) -> Scale {
    let place = |((samples, t), _): ((&Samples, &Rigid), &bool)| {
        let mut samples = samples.thinned(MOST);
        samples.points.iter_mut().for_each(|p| *p = t * *p);
        let n = samples.points.len() as f64;
        let centre = Point3::from(samples.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
        Placed { samples, centre }
    };
    let found = bones.iter().zip(transforms).zip(determined).filter(|((s, _), found)| **found && s.points.len() > 50);
    let placed: Vec<Placed> = found.map(place).collect();
    let none = unexplained(&placed, fraction, measure, 0, 1.0);
    let mut scale = Scale { factor: [1.0; 3], left: [1.0; 3], apart: [None; 3] };
    if placed.is_empty() || none <= 0.0 {
        return scale;
    }
    scale.apart = apart;
    for axis in 0..3 {
        let mut tried: Vec<(f64, f64)> = vec![(1.0, none)];
        tried.extend(TRIED.map(|s| (s, unexplained(&placed, fraction, measure, axis, s))));
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let best = (0..tried.len()).min_by(|&a, &b| tried[a].1.total_cmp(&tried[b].1)).unwrap_or(0);
        scale.factor[axis] = vertex(&tried, best);
        scale.left[axis] = tried[best].1 / none;
    }
    scale
}

/// Where a parabola through the best stretch and its neighbours is least.
fn vertex(tried: &[(f64, f64)], best: usize) -> f64 {
    let at = best.clamp(1, tried.len() - 2);
    let [(x0, y0), (x1, y1), (x2, y2)] = [tried[at - 1], tried[at], tried[at + 1]];
    let (d0, d2) = ((y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1));
    let bend = (d2 - d0) / (x2 - x0);
    if bend <= 0.0 { tried[best].0 } else { ((x0 + x1) / 2.0 - d0 / (2.0 * bend)).clamp(x0, x2) }
}

/// Contrast that bones stretched about their centres leave unexplained, weighted by what they show.
fn unexplained(bones: &[Placed], fraction: &Tissue, measure: Measure, axis: usize, stretch: f64) -> f64 {
    let one = |bone: &Placed| {
        let mut samples = bone.samples.clone();
        samples.points.iter_mut().for_each(|p| p[axis] = bone.centre[axis] + stretch * (p[axis] - bone.centre[axis]));
        let seen = evaluate(&samples, fraction, &Rigid::identity(), &bone.centre, measure, None, false);
        [seen.visible * samples.volume_mm3 * (1.0 - seen.explained), seen.visible * samples.volume_mm3]
    };
    let [left, all] = bones.iter().map(one).fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
    if all > 0.0 { left / all } else { 0.0 }
}

/// Jointed bones that the image determines: the way from the parent's centre to the child's if their joint still held them, both
/// turned as they are now, and the way in the fraction, mm.
pub(super) fn joined(
    skeleton: &Skeleton,
    centres: &[Point3<f64>],
    transforms: &[Rigid],
    determined: &[bool],
) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let pair = |(b, bone): (usize, &Bone)| {
        let p = bone.parent.filter(|&p| determined[p] && determined[b])?;
        let from_joint = |n: usize| transforms[n].rotation * (centres[n] - bone.joint.centre);
        let was = from_joint(b) - from_joint(p);
        Some((was, transforms[b] * centres[b] - transforms[p] * centres[p]))
    };
    skeleton.bones.iter().enumerate().filter_map(pair).collect()
}

/// How much farther apart jointed bones lie along each axis: pairs of (what it would be if the joint held, what it is), mm.
pub(super) fn distances(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> [Option<f64>; 3] {
    std::array::from_fn(|a| {
        let along = pairs.iter().filter(|(was, _)| was[a].abs() > LEAST_MM);
        let mut ratios: Vec<f64> = along.map(|(was, is)| is[a] / was[a]).collect();
        ratios.sort_by(f64::total_cmp);
        (ratios.len() >= PAIRS).then(|| ratios[ratios.len() / 2])
    })
}

impl Scale {
    /// The scale of an axis as far as it is certain, and as far as it is likely.
    fn of(&self, a: usize) -> [f64; 2] {
        let stretch = self.factor[a];
        let certain = if self.left[a] < BETTER { stretch } else { 1.0 };
        let Some(apart) = self.apart[a] else { return [certain; 2] };
        let farther = |one: f64, other: f64| if (one - 1.0).abs() > (other - 1.0).abs() { one } else { other };
        let agree = |stretch: f64| (stretch - 1.0) * (apart - 1.0) > 0.0;
        // Edges without partial volumes, as drawn objects have them, make bones seem smaller where they are.
        if !agree(certain) || (apart - 1.0).abs() < SHARED * (certain - 1.0).abs() {
            let supported = agree(stretch) && (stretch - 1.0).abs() > SUPPORTED && (apart - 1.0).abs() > DISTANT;
            let long = a != 1 && (apart - 1.0).abs() > LONG;
            return [1.0, if supported || long { apart } else { 1.0 }];
        }
        let likely = farther(certain, apart);
        [if a == 2 { likely } else { certain }, likely]
    }

    /// What it says of the headers.
    ///
    /// # Errors
    /// [`Error::Registration`] where an axis is stretched beyond doubt.
    pub(super) fn judge(&self) -> Result<Option<Warning>> {
        let names = ["left-right", "front-back", "head-foot"];
        let told = |which: usize, least: f64| {
            let beyond = (0..3).map(|a| (names[a], self.of(a)[which])).filter(|(_, s)| (s - 1.0).abs() > least);
            let axes: Vec<String> = beyond.map(|(name, s)| format!("{name} by about {s:.2}")).collect();
            (!axes.is_empty())
                .then(|| format!("the fraction shows the planning CT's bones at another scale: {}", axes.join(", ")))
        };
        let remedy = "bones keep their size: compare voxel spacing and slice thickness of both files with their DICOM \
                      series, and correct the one that is wrong";
        if let Some(problem) = told(0, REFUSED) {
            return Err(Error::failed(findings::FRACTION_SCALED, problem, remedy));
        }
        Ok(told(1, DOUBTFUL).map(|problem| Warning::new(findings::FRACTION_SCALED, format!("{problem}; {remedy}"))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_is_refused_warned_of_or_passed() {
        let scale = |factor, left, apart: [f64; 3]| Scale { factor, left, apart: apart.map(Some) };
        let none = [1.0; 3];
        // As measured on real pairs: a neck, a chest that breathes, and the same with one axis at 0.9.
        let fine = [
            scale([1.001, 1.001, 1.002], none, [1.0, 1.017, 0.994]),
            scale([0.999, 0.994, 0.999], none, [0.994, 0.939, 0.999]),
        ];
        assert!(fine.iter().all(|s| s.judge().unwrap().is_none()));
        let z = scale([1.003, 0.999, 0.929], [1.0, 1.0, 0.456], [1.0, 1.0, 0.899]);
        let error = z.judge().unwrap_err();
        assert_eq!((error.exit_code(), error.code()), (6, "fraction-scaled"));
        assert!(error.to_string().contains("head-foot by about 0.90"), "{error}");
        // By distances alone it is a doubt: slices 5 % thicker than they are said to be.
        let thick = scale([1.003, 1.002, 0.997], none, [1.0, 1.017, 0.947]);
        assert!(thick.judge().unwrap().unwrap().message.contains("head-foot by about 0.95"));
        // Bones that shrink where they are, or of which nothing more is known.
        let drawn = scale([1.008, 1.02, 0.9], [1.0, 1.0, 0.55], [1.0, 1.0, 0.999]);
        assert!(drawn.judge().unwrap().is_none());
        assert!(Scale { apart: [None; 3], ..drawn }.judge().is_err());
        let x = scale([0.972, 0.994, 1.006], [0.978, 1.0, 1.0], [0.965, 0.982, 1.0]);
        assert!(x.judge().unwrap().unwrap().message.contains("left-right by about 0.96"));
    }

    #[test]
    fn distances_are_the_middle_of_the_pairs_that_reach_far_enough() {
        let pair = |z: f64, to: f64| (Vector3::new(3.0, 0.0, z), Vector3::new(30.0, 0.0, to));
        let pairs = [pair(20.0, 18.0), pair(-20.0, -18.0), pair(15.0, 14.0), pair(18.0, 16.2), pair(5.0, 50.0)];
        let [x, _, z] = distances(&pairs);
        assert!((z.unwrap() - 0.9).abs() < 1e-12 && x.is_none(), "{x:?} {z:?}");
    }

    #[test]
    fn a_parabola_has_its_vertex() {
        let least: f64 = 1.013;
        let tried: Vec<(f64, f64)> =
            [0.9, 0.96, 1.0, 1.05, 1.1].map(|s: f64| (s, 3.0 + 7.0 * (s - least).powi(2))).to_vec();
        assert!((vertex(&tried, 2) - least).abs() < 1e-9);
        // From the last that was tried, too.
        let last: Vec<(f64, f64)> = [0.9, 0.96, 1.0, 1.05, 1.1].map(|s: f64| (s, (s - 1.1).abs())).to_vec();
        assert!((vertex(&last, 4) - 1.1).abs() < 1e-12);
        let bent: Vec<(f64, f64)> =
            [0.8, 0.9, 1.0, 1.1, 1.2].map(|s: f64| (s, if s > 0.95 { (s - 1.18).powi(2) } else { 1.0 - s })).to_vec();
        assert!((vertex(&bent, 4) - 1.18).abs() < 1e-9);
        // At an end it stays within what was tried; a hump gives the best that was tried.
        let falling: Vec<(f64, f64)> = [0.9, 1.0, 1.1].map(|s| (s, (s - 2.0f64).powi(2))).to_vec();
        assert!((vertex(&falling, 2) - 1.1).abs() < 1e-12);
        let hump: Vec<(f64, f64)> = [0.9, 1.0, 1.1].map(|s| (s, -(s - 1.02f64).powi(2))).to_vec();
        assert!((vertex(&hump, 0) - 0.9).abs() < 1e-12);
    }
}
