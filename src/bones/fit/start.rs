//! The start of the fit: couch shift and scanner-origin offset, found by exhaustive search.
//!
//! No common field of view or origin is assumed: for a few turns, every shift that brings enough of the bones into the
//! fraction image is scored by the share of bone HU variance that it explains, at coarse resolution; the best are refined
//! (docs/method.md).

use super::given::GivenMotion;
use super::problem::{Body, PoseProblem};
use super::relation;
use super::samples::Samples;
use super::similarity::{Measure, evaluate};
use super::solver::solve;
use super::tissue::Tissue;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::{Rigid, vectorised};
use crate::volume::Volume;
use crate::volume::ranges::RANGES;
use crate::warning::Warning;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// Motions of all bones together, with the share of the bones' contrast that each explains.
pub(super) type Starts = Vec<(Rigid, f64)>;

/// Where a fit begins.
#[derive(Debug, Clone, Copy)]
pub enum FitStart<'a> {
    /// With a search over all shifts of the bones together.
    Search,
    /// Near a common motion of all bones, planning to fraction, that is known. Where it explains little of the bones' contrast
    /// all shifts are searched.
    Near(Rigid),
    /// With each bone where it is given (one per bone); the image refines that.
    Placed(&'a [Option<GivenMotion>]),
}

/// Explained share of the couch shift below which the user should look twice.
pub(super) const WEAK_START: f64 = 0.4;

impl FitStart<'_> {
    /// Which bones are given their motion; none where no single one is.
    pub(super) fn given(&self) -> Vec<bool> {
        match self {
            Self::Placed(known) => known.iter().map(Option::is_some).collect(),
            Self::Search | Self::Near(_) => Vec::new(),
        }
    }
}

/// Step of the exhaustive search, mm. Half the width of the blur that the images get for it.
/// With half of it, and as many finalists, a cone-beam CT is not found.
const STEP_MM: f64 = 10.0;
/// Candidates that are refined.
const CANDIDATES: usize = 16;
/// Candidates closer than this to a better one are the same optimum, mm.
const APART_MM: f64 = 35.0;
/// Starts that a fit is begun from at most, while none before has led anywhere.
const STARTS: usize = 4;
/// Another place that explains this much more of the bones' contrast than a given start is told of.
const BETTER: f64 = 0.05;
/// Refined starts that take the bones to places closer than this are one, mm.
const SAME_MM: f64 = 20.0;
/// Least explained share of the refined start; below it the images show no common anatomy.
const LEAST_EXPLAINED: f64 = 0.15;

/// Explained share of an upright start, and share of the bones that it has in view, beyond which no turned one is looked for: a
/// corner of the bones fits many places.
const CLEAR: f64 = 0.7;
const IN_VIEW: f64 = 0.5;

/// Shifts that bring enough of the bones' box into the image's.
struct Range {
    /// Box of the points and of the image, mm.
    points: [Vector3<f64>; 2],
    image: [Vector3<f64>; 2],
    low: Vector3<f64>,
    count: [usize; 3],
}

impl Range {
    fn new(points: &[Point3<f64>], fraction: &Volume<f32>) -> Self {
        let extent = |ps: &mut dyn Iterator<Item = Point3<f64>>| {
            let none = [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
            ps.fold(none, |[low, high], p| [low.inf(&p.coords), high.sup(&p.coords)])
        };
        let points = extent(&mut points.iter().copied());
        let image = extent(&mut fraction.grid().corners().into_iter());
        let low = image[0] - points[1];
        let count = std::array::from_fn(|a| ((image[1][a] - points[0][a] - low[a]) / STEP_MM).ceil() as usize + 1);
        Self { points, image, low, count }
    }

    fn shift(&self, n: usize) -> Vector3<f64> {
        let [ni, nj, _] = self.count;
        self.low + Vector3::new((n % ni) as f64, (n / ni % nj) as f64, (n / ni / nj) as f64) * STEP_MM
    }

    fn overlaps(&self, shift: &Vector3<f64>) -> bool {
        let share = |a: usize| {
            let (low, high) = (self.points[0][a] + shift[a], self.points[1][a] + shift[a]);
            let smaller = (high - low).min(self.image[1][a] - self.image[0][a]).max(STEP_MM);
            ((high.min(self.image[1][a]) - low.max(self.image[0][a])) / smaller).clamp(0.0, 1.0)
        };
        share(0) * share(1) * share(2) >= LEAST_OVERLAP
    }
}

/// Lower grey values count as this, HU, that of fat: air where a limb has gone from must not outweigh all bones that are there.
/// At -50 and at -200 the 99.5th percentile of a cone-beam CT is 6.8 and 6.7 mm for 6.3.
const LEAST_HU: f64 = -100.0;

/// Evidence for one shift, visible share times `-ln(1 - correlation^2)`, by nearest voxels (the images are blurred wider than a voxel).
#[inline(always)]
fn evidence(points: &[Vector3<f64>], values: &[f64], fraction: &Volume<f32>, shift: &Vector3<f64>) -> f64 {
    let size = fraction.grid().size();
    let data = fraction.data();
    let (mut n, mut f1, mut a1, mut ff, mut fa, mut aa) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (p, &a) in points.iter().zip(values) {
        let i = p + shift;
        // The nearest voxel by truncation: `round` is a call on machines without an instruction for it.
        let r = i.add_scalar(0.5);
        if (0..3).any(|d| r[d] < 0.0 || r[d] >= size[d] as f64) {
            continue;
        }
        let f = f64::from(data[r.x as usize + size[0] * (r.y as usize + size[1] * r.z as usize)]).max(LEAST_HU);
        let a = a.max(LEAST_HU);
        n += 1.0;
        f1 += f;
        a1 += a;
        ff += f * f;
        fa += f * a;
        aa += a * a;
    }
    let m = f64::max(n, 1.0);
    let (variance, contrast, covariance) = (ff - f1 * f1 / m, aa - a1 * a1 / m, fa - f1 * a1 / m);
    if n < 10.0 || variance <= 0.0 || contrast <= 0.0 || covariance <= 0.0 {
        return 0.0;
    }
    -n / values.len() as f64 * (1.0 - covariance * covariance / (variance * contrast)).max(1e-4).ln()
}

/// Points that score every shift; those shifts that do best are scored by all points.
const SCOUTS: usize = 250;
/// Shifts that are scored by all points, for each turn.
const FINALISTS: usize = 200;
/// Least overlap of the bones' box and the image, as a share of the smaller one.
const LEAST_OVERLAP: f64 = 0.1;

/// Turns (degrees about x, y, z) that the search begins from: a nodding, tilted or turned head does not correlate with an
/// upright one.
const TURNS: [[f64; 3]; 7] = [
    [0.0, 0.0, 0.0],
    [20.0, 0.0, 0.0],
    [-20.0, 0.0, 0.0],
    [0.0, 20.0, 0.0],
    [0.0, -20.0, 0.0],
    [0.0, 0.0, 20.0],
    [0.0, 0.0, -20.0],
];

/// A start of the fit: all bones turned about their centre, then shifted.
struct Candidate {
    evidence: f64,
    turn: UnitQuaternion<f64>,
    shift: Vector3<f64>,
}

/// A start after refinement.
struct Refined {
    cost: f64,
    /// Shares of the bones' contrast that it explains, and of the bones that it has in view.
    explained: f64,
    visible: f64,
    motion: Rigid,
}

/// Best starts of the exhaustive search over these turns, best first.
fn search(turns: &[[f64; 3]], samples: &Samples, centre: &Point3<f64>, fraction: &Volume<f32>) -> Vec<Candidate> {
    let turns = turns.iter().map(|t| UnitQuaternion::from_scaled_axis(Vector3::from(t.map(f64::to_radians))));
    let mut all: Vec<Candidate> = turns.flat_map(|turn| shifts(samples, centre, turn, fraction)).collect();
    // The sort is stable: of equal ones the smaller turn comes first.
    all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    let mut best: Vec<Candidate> = Vec::new();
    for c in all {
        if best.iter().all(|b| b.turn != c.turn || (b.shift - c.shift).norm() > APART_MM) {
            best.push(c);
            if best.len() == CANDIDATES {
                break;
            }
        }
    }
    best
}

/// Shifts of the turned bones with their evidence, best first.
fn shifts(
    samples: &Samples,
    centre: &Point3<f64>,
    turn: UnitQuaternion<f64>,
    fraction: &Volume<f32>,
) -> Vec<Candidate> {
    let grid = fraction.grid();
    let points: Vec<Point3<f64>> = samples.points.iter().map(|p| centre + turn * (p - centre)).collect();
    let indices: Vec<Vector3<f64>> = points.iter().map(|p| grid.index(p)).collect();
    let ratio = !samples.memberships.is_empty();
    let every = (indices.len() / SCOUTS).max(1);
    let thinned = |n: &usize| n.is_multiple_of(every);
    let scouts: Vec<Vector3<f64>> = (0..indices.len()).filter(thinned).map(|n| indices[n]).collect();
    let seen: Vec<f64> = (0..indices.len()).filter(thinned).map(|n| samples.values[n]).collect();
    let members: Vec<_> =
        (0..indices.len()).filter(|_| ratio).filter(thinned).map(|n| samples.memberships[n]).collect();
    let score = |points: &[Vector3<f64>], values: &[f64], members: &[[f32; RANGES]], shift: &Vector3<f64>| {
        let step = grid.inverse_step() * shift;
        if ratio {
            return relation::evidence(points, members, fraction, &step);
        }
        vectorised(
            #[inline(always)]
            || evidence(points, values, fraction, &step),
        )
    };
    let range = Range::new(&points, fraction);
    let mut scored: Vec<Candidate> = (0..range.count[0] * range.count[1] * range.count[2])
        .into_par_iter()
        .filter_map(|n| {
            let shift = range.shift(n);
            let evidence = if range.overlaps(&shift) { score(&scouts, &seen, &members, &shift) } else { 0.0 };
            (evidence > 0.0).then_some(Candidate { evidence, turn, shift })
        })
        .collect();
    scored.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    scored.truncate(FINALISTS);
    scored.par_iter_mut().for_each(|c| c.evidence = score(&indices, &samples.values, &samples.memberships, &c.shift));
    scored
}

/// Rigid motions of all bones together that best explain the fraction image, at most [`STARTS`] that differ, best first.
///
/// `samples` and `fraction` are blurred alike. Each comes with its explained share.
///
/// # Errors
/// [`Error::Registration`] when no shift explains the bones: images without common anatomy.
pub(super) fn common_motions(samples: &Samples, fraction: &Tissue, measure: Measure) -> Result<Starts> {
    let (upright, turned) = TURNS.split_at(1);
    motions(samples, fraction, measure, &[upright, turned])
}

/// As [`common_motions`], without a look at turned bones: a seventh of the time.
pub(super) fn upright_motions(samples: &Samples, fraction: &Tissue, measure: Measure) -> Result<Starts> {
    motions(samples, fraction, measure, &[&TURNS[..1]])
}

/// As [`common_motions`], with a motion that is known: its neighbourhood is searched. Unless that explains the bones clearly all
/// shifts are looked at too: they are tried where the known one leads nowhere, and a better one is told of. Where the known one
/// explains hardly anything only the search counts.
pub(super) fn near_motions(
    known: &Rigid,
    samples: &Samples,
    fraction: &Tissue,
    measure: Measure,
) -> Result<(Starts, Option<Warning>)> {
    let bones = Together::new(samples, fraction, measure);
    let steps = (0..3).flat_map(|a| [-STEP_MM, STEP_MM].map(|s| Vector3::ith(a, s)));
    let shift = known * bones.centre - bones.centre;
    let candidate = |step| Candidate { evidence: 0.0, turn: known.rotation, shift: shift + step };
    let candidates: Vec<Candidate> = std::iter::once(Vector3::zeros()).chain(steps).map(candidate).collect();
    let mut found = bones.refined(candidates)?;
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let best = found.first().filter(|f| f.explained >= WEAK_START).map(|f| (f.explained, f.visible));
    let Some((explained, visible)) = best else {
        return common_motions(samples, fraction, measure).map(|all| (all, None));
    };
    let mut starts = bones.starts(found)?;
    if explained >= CLEAR && visible >= IN_VIEW {
        return Ok((starts, None));
    }
    let mut doubt = None;
    for (motion, share) in upright_motions(samples, fraction, measure)? {
        if starts.iter().all(|(near, _)| bones.apart(near, &motion) > SAME_MM) {
            // A corner of the bones fits many places.
            let seen = bones.visible(&motion) >= visible.min(IN_VIEW);
            if seen && share > explained + BETTER && doubt.is_none() {
                let message = format!(
                    "the start that was given explains {:.0} % of the bones' contrast, and a place {:.0} mm from it {:.0} %: look at the \
                     fusion images",
                    100.0 * explained,
                    bones.apart(known, &motion),
                    100.0 * share
                );
                doubt = Some(Warning::new(findings::START_LEFT, message));
            }
            starts.push((motion, share));
        }
    }
    Ok((starts, doubt))
}

/// A word about a fit whose common motion lies elsewhere than the start that was given.
pub(super) fn left(
    known: &Rigid,
    found: &Rigid,
    samples: &Samples,
    fraction: &Tissue,
    measure: Measure,
) -> Option<Warning> {
    let bones = Together::new(samples, fraction, measure);
    let away = (known * bones.centre - found * bones.centre).norm();
    // A start without a turn is none that is wrong.
    (away > SAME_MM || bones.apart(known, found) > APART_MM).then(|| {
        let message = format!(
            "the bones were found {away:.0} mm from the start that was given: it belongs to other images, points the other way, or \
             the bones were found at a wrong place; look at the fusion images"
        );
        Warning::new(findings::START_LEFT, message)
    })
}

/// The best motions over these sets of turns, one set after the other until a start is clear.
fn motions(samples: &Samples, fraction: &Tissue, measure: Measure, sets: &[&[[f64; 3]]]) -> Result<Starts> {
    let bones = Together::new(samples, fraction, measure);
    let mut found: Vec<Refined> = Vec::new();
    for turns in sets {
        found.extend(bones.refined(search(turns, samples, &bones.centre, &fraction.value))?);
        // The sort is stable: of equal ones the first stays first.
        found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        if found.first().is_some_and(|best| best.explained >= CLEAR && best.visible >= IN_VIEW) {
            break;
        }
    }
    bones.starts(found)
}

/// All bones as one, and the image that they are sought in.
struct Together<'a> {
    samples: &'a Samples,
    fraction: &'a Tissue,
    measure: Measure,
    centre: Point3<f64>,
    radius: f64,
}

impl<'a> Together<'a> {
    fn new(samples: &'a Samples, fraction: &'a Tissue, measure: Measure) -> Self {
        let n = samples.points.len().max(1) as f64;
        let centre = Point3::from(samples.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
        let radius = (samples.points.iter().map(|p| (p - centre).norm_squared()).sum::<f64>() / n).sqrt().max(1.0);
        Self { samples, fraction, measure, centre, radius }
    }

    fn refined(&self, candidates: Vec<Candidate>) -> Result<Vec<Refined>> {
        let Self { samples, fraction, measure, centre, radius } = *self;
        let refine = |Candidate { turn, shift, .. }| {
            let base = Rigid::from_parts(Translation3::from(centre.coords + shift - turn * centre.coords), turn);
            let problem = || PoseProblem {
                bodies: vec![Body { samples, base, centre, radius, held: None, shape: None }],
                links: Vec::new(),
                fraction: Some(fraction),
                measure,
            };
            let solution = solve(problem(), 0.05, 40)?;
            let t = problem().transforms(&solution.x)[0];
            let seen = &problem().similarities(&[t], false)[0];
            Ok(Refined { cost: solution.cost, explained: seen.explained, visible: seen.visible, motion: t })
        };
        candidates.into_par_iter().map(refine).collect()
    }

    /// How far two motions take the bones apart, mm.
    fn apart(&self, s: &Rigid, t: &Rigid) -> f64 {
        (s * self.centre - t * self.centre).norm() + self.radius * s.rotation.angle_to(&t.rotation)
    }

    /// Those that explain enough and differ, of all in the order of their cost.
    /// Share of the bones that a motion has in view.
    fn visible(&self, t: &Rigid) -> f64 {
        evaluate(self.samples, self.fraction, t, &(t * self.centre), self.measure, None, false).visible
    }

    fn starts(&self, found: Vec<Refined>) -> Result<Starts> {
        let best = found.first().map_or(0.0, |best| best.explained.max(0.0));
        let mut starts = Starts::new();
        for Refined { explained, motion: t, .. } in found.into_iter().filter(|f| f.explained >= LEAST_EXPLAINED) {
            if starts.len() < STARTS && starts.iter().all(|s| self.apart(&s.0, &t) > SAME_MM) {
                starts.push((t, explained));
            }
        }
        if !starts.is_empty() {
            return Ok(starts);
        }
        Err(Error::failed(
            findings::BONES_NOT_FOUND,
            format!(
                "the bones of the planning CT explain only {:.0} % of the fraction's bone contrast at the best position found (at least {:.0} % are needed)",
                100.0 * best,
                100.0 * LEAST_EXPLAINED
            ),
            "check that both scans show the same patient and a common body region, in HU; a rigid motion (--start) or landmarks \
             on bones (--bone-landmarks) can place the bones",
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn air_where_a_limb_was_does_not_outweigh_what_is_there() {
        // Bone and tissue in turn along a row; where the last three tenths were there is air.
        let size = [100, 1, 1];
        let grid = Grid::axis_aligned(size, [1.0; 3], [0.0; 3]).unwrap();
        let planning = |i: usize| if i.is_multiple_of(2) { 700.0 } else { 50.0 };
        let fraction = Volume::from_fn(grid, |i| if i < 70 { planning(i) as f32 } else { -1000.0 });
        let points: Vec<Vector3<f64>> = (0..size[0]).map(|i| Vector3::new(i as f64, 0.0, 0.0)).collect();
        let values: Vec<f64> = (0..size[0]).map(planning).collect();
        // Correlation squared 0.43; with air as it is 0.11.
        let found = evidence(&points, &values, &fraction, &Vector3::zeros());
        assert!((found - 0.556).abs() < 2e-3, "{found}");
    }

    #[test]
    fn a_fraction_without_bone_is_refused_by_name() {
        let grid = Grid::axis_aligned([30, 30, 30], [4.0; 3], [0.0; 3]).unwrap();
        let points: Vec<Point3<f64>> =
            (0..500).map(|n| Point3::from([n % 10, n / 10 % 10, n / 100].map(f64::from))).collect();
        let values = (0..500).map(|n| if n % 2 == 0 { 700.0 } else { 50.0 }).collect();
        let samples = Samples { volume_mm3: 500.0, points, values, ..Samples::default() };
        let flat = Tissue::blurred(&Volume::filled(grid, 40.0), 8.0);
        let refused = common_motions(&samples, &flat, Measure::default()).map(|starts| starts.len()).unwrap_err();
        assert_eq!(refused.finding(), Some(findings::BONES_NOT_FOUND), "{}", refused.problem());
    }

    #[test]
    fn a_shift_is_tried_where_enough_of_the_bones_comes_into_the_image() {
        let grid = Grid::axis_aligned([101, 101, 101], [1.0; 3], [0.0; 3]).unwrap();
        let fraction = Volume::filled(grid, 0.0);
        // A box of 40 mm that lies 1 m aside.
        let points = [Point3::new(1000.0, 0.0, 0.0), Point3::new(1040.0, 40.0, 40.0)];
        let range = Range::new(&points, &fraction);
        let overlaps = |x: f64, y: f64| range.overlaps(&Vector3::new(x - 1000.0, y, 30.0));
        // Whole, half along one axis, half along two, beside it.
        assert!(overlaps(30.0, 30.0) && overlaps(-20.0, 30.0) && overlaps(80.0, -20.0));
        assert!(!overlaps(-39.0, 30.0) && !overlaps(-60.0, 30.0) && !overlaps(130.0, 30.0));
        assert!(!overlaps(-36.0, 80.0));
        let all: Vec<Vector3<f64>> = (0..range.count.iter().product()).map(|n| range.shift(n)).collect();
        assert!(all.iter().any(|s| (s - Vector3::new(-970.0, 30.0, 30.0)).norm() < STEP_MM));
    }
}
