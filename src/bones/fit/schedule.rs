//! The order of the fit: common motion, then bone by bone from the best-determined one outwards, then all together.

use super::accept::found_share;
use super::around::{AROUND_SAMPLES, around};
use super::evaluation::Normal;
use super::level::{Level, Levels};
use super::prior::{BeyondRange, relative};
use super::problem::{Body, End, Link, PoseProblem};
use super::samples::Samples;
use super::scale::{distances, joined, scale};
use super::search::MOST_MM3;
use super::shape::{Shape, Shapes};
use super::similarity::{Evaluation, Held, Measure};
use super::solver::{Solution, solve};
use super::tried::{Begun, Guess, Passed, Start, Tried, weak_start};
use super::{BoneFit, DeterminedBy, FitCurvature, FitOptions, FitResult};
use crate::error::{Error, Result};
use crate::geometry::Rigid;
use crate::progress::Progress;
use crate::skeleton::Skeleton;
use nalgebra::{DMatrix, Matrix3, Point3};

/// A bone with less than this share of its samples in view follows its joints until all bones are fitted together.
const LEAST_VISIBLE: f64 = 0.05;
/// A bone whose visible part explains less than this of its contrast after the fit is not where the image says:
/// it follows its joints.
/// Half of it changes no pair that was measured, twice as much refuses every true one.
pub(super) const LEAST_EXPLAINED: f64 = 0.5;
/// So does a cut bone that is doubtful ([`DOUBTFUL_CUT`]) and leaves this many times as much unexplained as the middle one of
/// the bones: not the noise is to blame.
const UNLIKE: f64 = 4.0;

/// A bone that explains less than this at the coarsest level is searched for around; a cut one (less in view than
/// [`WHOLE`]) below the second share, since an edge hides what would tell a wrong place.
const DOUBTFUL: f64 = 0.6;
const DOUBTFUL_RATIO: f64 = 0.75;
const DOUBTFUL_CUT: f64 = 0.85;
/// Were every bone a cut one, a cone-beam CT would err by 1.17 mm for 0.77.
const WHOLE: f64 = 0.9;
/// A bone whose position the image and its joints leave open by more than this (standard deviation, mm) follows its joints:
/// a sliver in view fits many places.
const MOST_SD_MM: f64 = 1.5;

/// Fits whose bones are nearer to each other than this before the last pass are one, mm on the mean.
const SAME_MM: f64 = 0.5;

/// What stays the same over all levels.
pub(super) struct Fitter<'a> {
    pub(super) skeleton: &'a Skeleton,
    options: &'a FitOptions,
    /// Centre and points of each bone's coarse samples.
    pub(super) centres: Vec<Point3<f64>>,
    pub(super) points: Vec<&'a [Point3<f64>]>,
    radii: Vec<f64>,
    nothing: Samples,
    /// Descriptors of both images, where these are compared too.
    pub(super) shapes: Option<Shapes<'a>>,
    /// Bones whose motion is given as a start; none elsewhere.
    pub(super) given: Vec<bool>,
}

fn no_levels() -> Error {
    Error::usage("fit.levels is empty", "give at least one (blur mm, samples) pair")
}

impl<'a> Fitter<'a> {
    pub(super) fn new(
        skeleton: &'a Skeleton,
        options: &'a FitOptions,
        level: &Level<'a>,
        shapes: Option<Shapes<'a>>,
    ) -> Self {
        let mut centres = Vec::new();
        let mut radii = Vec::new();
        for s in &level.drawn.bones {
            let n = s.points.len().max(1) as f64;
            let c = Point3::from(s.points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / n);
            radii.push((s.points.iter().map(|p| (p - c).norm_squared()).sum::<f64>() / n).sqrt().max(1.0));
            centres.push(c);
        }
        let nothing = Samples::default();
        let points = level.drawn.bones.iter().map(|s| s.points.as_slice()).collect();
        Self { skeleton, options, centres, points, radii, nothing, shapes, given: Vec::new() }
    }

    /// The fit from a start.
    pub(super) fn from(&self, start: Start, levels: &Levels<'a>, progress: &dyn Progress) -> Result<Tried> {
        self.finish(self.begin(start, levels, progress)?, levels, progress)
    }

    /// All passes but the last.
    pub(super) fn begin(&self, start: Start, levels: &Levels<'a>, progress: &dyn Progress) -> Result<Begun<'a>> {
        let options = self.options;
        let steps = 1 + options.outward.len() + options.levels.len();
        let Start { guess, .. } = start;
        let mut begun = Begun { start, level: None, passed: None };
        for (n, &resolution) in options.outward.iter().enumerate() {
            progress.step(1 + n, steps, "bone by bone");
            let now = begun.level.insert(levels.at(resolution)?);
            let now_known = if n == 0 || guess == Guess::Searched { guess } else { Guess::Each };
            self.outwards(now, &mut begun.start.transforms, now_known)?;
        }
        for n in 0..options.levels.len().saturating_sub(1) {
            let cost = self.pass(&mut begun, n, levels, progress)?.cost;
            begun.passed = Some(Passed { cost, transforms: begun.start.transforms.clone() });
        }
        Ok(begun)
    }

    /// The n-th pass of all bones together.
    fn pass(&self, begun: &mut Begun<'a>, n: usize, levels: &Levels<'a>, progress: &dyn Progress) -> Result<Solution> {
        let options = self.options;
        let resolution = *options.levels.get(n).ok_or_else(no_levels)?;
        let steps = 1 + options.outward.len() + options.levels.len();
        progress.step(1 + options.outward.len() + n, steps, "all bones");
        let mut now = match begun.level.take().filter(|l| l.drawn.resolution == resolution) {
            Some(level) => level,
            None => levels.at(resolution)?,
        };
        let transforms = &mut begun.start.transforms;
        // By then every bone is where it belongs but for a voxel: what comes into view no longer draws it.
        let hold = n > 0 || options.measure == Measure::CorrelationRatio;
        let mut solution = self.together(&now, transforms, hold)?;
        if self.drop_unexplained(&mut now, transforms, &solution.curvature) {
            solution = self.together(&now, transforms, hold)?;
        }
        begun.level = Some(now);
        Ok(solution)
    }

    /// The last pass, and what is known of each bone then.
    pub(super) fn finish(&self, mut begun: Begun<'a>, levels: &Levels<'a>, progress: &dyn Progress) -> Result<Tried> {
        let (skeleton, options) = (self.skeleton, self.options);
        let last = options.levels.len().checked_sub(1).ok_or_else(no_levels)?;
        let solution = self.pass(&mut begun, last, levels, progress)?;
        let Begun { start: Start { common, share, transforms, guess }, level: Some(level), passed } = begun else {
            return Err(Error::Internal("a pass without its images".into()));
        };
        let before = self.evaluate(&level, &vec![common; transforms.len()]);
        let after = self.evaluate(&level, &transforms);
        let bones = self.describe(&transforms, &before, &after, &level.dropped, &solution);
        let found = found_share(skeleton, &bones);
        let determined: Vec<bool> = bones.iter().map(|b| b.determined_by == DeterminedBy::Image).collect();
        let apart = distances(&joined(skeleton, &self.centres, &transforms, &determined));
        let drawn = &level.drawn.bones;
        let scale = scale(drawn, &transforms, &determined, apart, &level.fraction, options.measure);
        let warnings = weak_start(share).filter(|_| guess != Guess::Searched).into_iter().collect();
        let pose = skeleton.pose_of(&transforms);
        let open =
            FitCurvature { matrix: solution.curvature, centres: self.centres.clone(), radii: self.radii.clone() };
        let open = Some(open);
        let fit = FitResult { pose, transforms, bones, common, common_share: share, open, warnings };
        Ok(Tried { fit, passed, found, scale, cost: solution.cost, guess })
    }

    /// Whether a fit has the bones where this one had them before its last pass: it would end there too.
    pub(super) fn same(&self, begun: &Begun<'_>, tried: &Tried) -> bool {
        let (Some(here), Some(there)) = (&begun.passed, &tried.passed) else { return false };
        self.apart(&here.transforms, &there.transforms) < SAME_MM
    }

    /// How far two sets of motions take the bones apart, on the mean, mm.
    pub(super) fn apart(&self, here: &[Rigid], there: &[Rigid]) -> f64 {
        let pairs = here.iter().zip(there).zip(&self.centres);
        pairs.map(|((a, b), c)| (a * c - b * c).norm()).sum::<f64>() / self.centres.len().max(1) as f64
    }

    pub(super) fn body<'b>(&'b self, level: &'b Level<'_>, bone: usize, base: Rigid) -> Body<'b> {
        let samples = if level.dropped[bone] { &self.nothing } else { &level.drawn.bones[bone] };
        Body { samples, base, centre: self.centres[bone], radius: self.radii[bone], held: None, shape: None }
    }

    fn shape(&self, level: &Level<'_>, bone: usize, base: &Rigid) -> Option<Shape<'_>> {
        self.shapes.as_ref().filter(|_| !level.dropped[bone]).map(|shapes| shapes.of(bone, &base.rotation))
    }

    fn evaluate(&self, level: &Level<'_>, transforms: &[Rigid]) -> Vec<Evaluation> {
        // The samples of dropped bones too.
        let own = |b: usize| Body { samples: &level.drawn.bones[b], ..self.body(level, b, transforms[b]) };
        let bodies = (0..transforms.len()).map(own).collect();
        PoseProblem { bodies, links: Vec::new(), fraction: Some(&level.fraction), measure: self.options.measure }
            .similarities(transforms, false)
    }

    /// One bone after the other, each starting from a neighbour that is already placed and held to it by their joint.
    ///
    /// With a common guess bones take over their neighbour's motion, as do those that are not given; else each starts where it is.
    fn outwards(&self, level: &Level<'_>, transforms: &mut [Rigid], guess: Guess) -> Result<()> {
        let fresh = |bone: usize| match guess {
            Guess::Common => true,
            Guess::Given => !self.given.get(bone).is_some_and(|given| *given),
            Guess::Each | Guess::Searched => false,
        };
        let n = transforms.len();
        let now = self.evaluate(level, transforms);
        let shown = |b: usize, e: &Evaluation| match guess {
            Guess::Searched => level.drawn.bones[b].volume_mm3.min(MOST_MM3) * e.visible.powi(2),
            _ => level.drawn.bones[b].volume_mm3 * e.visible,
        };
        let weight = |b: usize, e: &Evaluation| shown(b, e) * e.explained.max(0.0);
        let root =
            (0..n).max_by(|&a, &b| weight(a, &now[a]).total_cmp(&weight(b, &now[b])).then(b.cmp(&a))).unwrap_or(0);
        let mut placed = vec![false; n];
        let neighbours = |b: usize| neighbours(self.skeleton, b);
        let mut next = Some((root, root));
        while let Some((bone, from)) = next {
            if fresh(bone) {
                transforms[bone] = transforms[from];
            }
            let links = || neighbours(bone).filter(|&o| placed[o]).map(|o| self.link(bone, o, transforms[o])).collect();
            if let Some(found) = self.place(level, bone, transforms[bone], links, fresh(bone))? {
                transforms[bone] = found;
            }
            placed[bone] = true;
            // Next: the unplaced neighbour of a placed bone that the image shows best, seen from that neighbour's motion.
            next = (0..n)
                .filter(|&b| !placed[b])
                .filter_map(|b| neighbours(b).find(|&o| placed[o]).map(|o| (b, o)))
                .map(|(b, o)| {
                    let t = if fresh(b) { transforms[o] } else { transforms[b] };
                    let p = PoseProblem {
                        bodies: vec![self.body(level, b, t)],
                        links: Vec::new(),
                        fraction: Some(&level.fraction),
                        measure: self.options.measure,
                    };
                    (shown(b, &p.similarities(&[t], false)[0]), b, o)
                })
                .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
                .map(|(_, b, o)| (b, o));
        }
        Ok(())
    }

    /// Takes the samples from bones that the image does not explain and puts them back to their parent's motion.
    fn drop_unexplained(&self, level: &mut Level<'_>, transforms: &mut [Rigid], curvature: &DMatrix<f64>) -> bool {
        let sd = deviations(curvature);
        let mut any = false;
        let now = self.evaluate(level, transforms);
        for (b, (e, unexplained)) in now.iter().zip(unexplained(&now, self.options.least_explained)).enumerate() {
            if e.visible > 0.0 && (unexplained || sd(6 * b + 3) > MOST_SD_MM) {
                any = true;
                level.dropped[b] = true;
                if let Some(parent) = self.skeleton.bones[b].parent {
                    transforms[b] = transforms[parent];
                }
            }
        }
        any
    }

    /// Fits one bone from `start`, held by its links; `None` when too little of it is in view.
    ///
    /// With `search`, a bone that ends up doubtful is started again from places around, and the least cost wins.
    fn place<'b>(
        &'b self,
        level: &'b Level<'_>,
        bone: usize,
        start: Rigid,
        links: impl Fn() -> Vec<Link<'b>>,
        search: bool,
    ) -> Result<Option<Rigid>> {
        let problem = |base, held| PoseProblem {
            bodies: vec![Body { held, shape: self.shape(level, bone, &base), ..self.body(level, bone, base) }],
            links: links(),
            fraction: Some(&level.fraction),
            measure: self.options.measure,
        };
        let now = problem(start, None).similarities(&[start], false).remove(0);
        if now.visible < LEAST_VISIBLE {
            return Ok(None);
        }
        // By another modality a bone matches less well, so that what comes into view would draw it. Yet a cut one may begin hidden,
        // and the joints would have it: the coarsest pass lets it come.
        let comes = now.visible < WHOLE && self.options.outward.first() == Some(&level.drawn.resolution);
        let hold = !search && !comes && self.options.measure == Measure::CorrelationRatio;
        let held = hold.then_some(Held { view: now.visible, gain: 0.0, grey: None });
        let fit = |base: Rigid, few: Option<&Samples>| {
            let mut problem = problem(base, held);
            if let Some(few) = few {
                problem.bodies[0].samples = few;
            }
            let solution = solve(problem, level.tolerance_mm, self.options.max_iterations)?;
            Ok::<_, Error>((solution.cost, self.body(level, bone, base).transform(solution.x.as_slice())))
        };
        let mut best = fit(start, None)?;
        if search && doubtful(&problem(best.1, None).similarities(&[best.1], false)[0]) {
            let few = self.options.measure == Measure::CorrelationRatio && !level.dropped[bone];
            let few = few.then(|| level.drawn.bones[bone].thinned(AROUND_SAMPLES));
            best = around(&(start * self.centres[bone]), &start, best, few.as_ref(), fit)?;
        }
        Ok(Some(best.1))
    }

    /// The joint between a moving bone (body 0) and a held neighbour.
    fn link(&self, bone: usize, other: usize, held: Rigid) -> Link<'a> {
        let bones = &self.skeleton.bones;
        if bones[bone].parent == Some(other) {
            Link { joint: &bones[bone].joint, parent: End::Held(held), child: End::Moving(0) }
        } else {
            Link { joint: &bones[other].joint, parent: End::Moving(0), child: End::Held(held) }
        }
    }

    /// What is in view of each bone now, and one gain for all.
    fn held(&self, level: &Level<'_>, transforms: &[Rigid]) -> Vec<Option<Held>> {
        held(&self.evaluate(level, transforms))
    }

    /// All bones and all joints at once; `hold`: what is in view of each bone counts as it does at the start, and one gain holds
    /// for all.
    fn together(&self, level: &Level<'_>, transforms: &mut Vec<Rigid>, hold: bool) -> Result<Solution> {
        let held = if hold { self.held(level, transforms) } else { vec![None; transforms.len()] };
        let make = || PoseProblem {
            bodies: (0..transforms.len())
                .map(|b| Body { held: held[b], ..self.body(level, b, transforms[b]) })
                .collect(),
            links: self
                .skeleton
                .bones
                .iter()
                .enumerate()
                .filter_map(|(b, bone)| {
                    Some(Link { joint: &bone.joint, parent: End::Moving(bone.parent?), child: End::Moving(b) })
                })
                .collect(),
            fraction: Some(&level.fraction),
            measure: self.options.measure,
        };
        let solution = solve(make(), level.tolerance_mm, self.options.max_iterations)?;
        let moved = make().transforms(&solution.x);
        *transforms = moved;
        Ok(solution)
    }

    fn describe(
        &self,
        transforms: &[Rigid],
        before: &[Evaluation],
        after: &[Evaluation],
        dropped: &[bool],
        solution: &Solution,
    ) -> Vec<BoneFit> {
        let sd = deviations(&solution.curvature);
        // Rotation and shift, both in mm at the bone's radius.
        let next = |b: usize| [0, 3].map(|part| solution.next.fixed_rows::<3>(6 * b + part).norm());
        self.skeleton
            .bones
            .iter()
            .enumerate()
            .map(|(b, bone)| {
                let visible = after[b].visible;
                let seen = visible > 0.0;
                let excess = |p: usize| bone.joint.excess(&relative(&bone.joint, &transforms[p], &transforms[b]));
                let beyond_range = bone.parent.map(|p| BeyondRange::of(&excess(p))).unwrap_or_default();
                BoneFit {
                    name: bone.name.clone(),
                    transform: transforms[b],
                    visible,
                    similarity_before: (before[b].visible > 0.0).then(|| before[b].explained.max(0.0)),
                    similarity_after: seen.then(|| after[b].explained.max(0.0)),
                    stop: solution.stop.clone(),
                    unsettled_mm: next(b).into_iter().fold(0.0, f64::max),
                    position_sd_mm: sd(6 * b + 3),
                    rotation_sd_deg: (sd(6 * b) / self.radii[b]).to_degrees(),
                    beyond_range,
                    motion_mm: (transforms[b] * self.centres[b] - self.centres[b]).norm(),
                    determined_by: if !dropped[b] && visible >= LEAST_VISIBLE {
                        DeterminedBy::Image
                    } else {
                        DeterminedBy::Joint
                    },
                }
            })
            .collect()
    }
}

/// The bones that share a joint with a bone, in their order.
pub(super) fn neighbours(skeleton: &Skeleton, bone: usize) -> impl Iterator<Item = usize> + Clone {
    let bones = &skeleton.bones;
    (0..bones.len()).filter(move |&o| bones[bone].parent == Some(o) || bones[o].parent == Some(bone))
}

/// Whether a bone may be at a wrong place: it explains little, or an edge hides what would tell.
pub(super) fn doubtful(e: &Evaluation) -> bool {
    // By another modality a true place explains less, and a wrong one more: both are searched around.
    let least = if e.normal.is_some() { DOUBTFUL_RATIO } else { DOUBTFUL };
    e.explained < least || (e.visible < WHOLE && e.explained < DOUBTFUL_CUT)
}

/// Whether each bone is too little in view, or the image does not explain it as it does the others; of a whole one it has to explain
/// `least_of_whole` of its contrast.
pub(super) fn unexplained(bones: &[Evaluation], least_of_whole: f64) -> Vec<bool> {
    let mut left: Vec<f64> = bones.iter().filter(|e| e.visible >= LEAST_VISIBLE).map(|e| 1.0 - e.explained).collect();
    left.sort_by(f64::total_cmp);
    let usual = left.get(left.len() / 2).copied().unwrap_or(1.0);
    let unlike = |e: &Evaluation| e.visible < WHOLE && doubtful(e) && 1.0 - e.explained > UNLIKE * usual;
    let least = |e: &Evaluation| if e.visible < WHOLE { LEAST_EXPLAINED } else { least_of_whole };
    bones.iter().map(|e| e.visible < LEAST_VISIBLE || e.explained < least(e) || unlike(e)).collect()
}

/// What is in view of each bone, and the gain of all together; nothing where no bone shows a contrast.
pub(super) fn held(bones: &[Evaluation]) -> Vec<Option<Held>> {
    let [covariance, variance] = bones.iter().fold([0.0; 2], |[c, v], e| [c + e.contrast[0], v + e.contrast[1]]);
    let sums =
        bones.iter().filter_map(|e| e.normal).reduce(|a, b| Normal { own: a.own + b.own, both: a.both + b.both });
    let grey = sums.and_then(|s| s.own.try_inverse().map(|inverse| inverse * s.both));
    let held = |e: &Evaluation| Held { view: e.visible, gain: covariance / variance, grey };
    bones.iter().map(|e| (variance > 0.0).then(|| held(e))).collect()
}

/// Standard deviation in the worst direction of the three parameters that begin at a position, from the curvature at
/// the optimum; the largest number where the curvature is singular.
fn deviations(curvature: &DMatrix<f64>) -> impl Fn(usize) -> f64 {
    let covariance = curvature.clone().cholesky().map(|c| c.inverse());
    move |at| {
        let Some(c) = &covariance else { return f64::MAX };
        let block: Matrix3<f64> = c.fixed_view::<3, 3>(at, at).into_owned();
        block.symmetric_eigenvalues().max().max(0.0).sqrt()
    }
}
