//! The order of the fit: common motion, then bone by bone from the best-determined one outwards, then all together.

use super::prior::{limit_excess, relative};
use super::problem::{Body, End, Link, PoseProblem};
use super::samples::{Samples, candidates, draw};
use super::similarity::Evaluation;
use super::solver::{Solution, solve};
use super::start::common_motion;
use super::tissue::Tissue;
use super::{BoneFit, FitOptions, FitResult};
use crate::error::{Error, Result};
use crate::geometry::Rigid;
use crate::progress::Progress;
use crate::skeleton::Skeleton;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use nalgebra::{DMatrix, Matrix3, Point3};

/// A bone with less than this share of its samples in view follows its joints until all bones are fitted together.
const LEAST_VISIBLE: f64 = 0.05;
/// A bone whose visible part explains less than this of its contrast after the fit is not where the image says:
/// it follows its joints.
const LEAST_EXPLAINED: f64 = 0.5;

/// Both images at one resolution, with each bone's samples.
struct Level {
    fraction: Tissue,
    bones: Vec<Samples>,
}

/// What stays the same over all levels.
struct Fitter<'a> {
    skeleton: &'a Skeleton,
    options: &'a FitOptions,
    centres: Vec<Point3<f64>>,
    radii: Vec<f64>,
}

/// Fits the pose of the skeleton to the fraction CT.
///
/// `planning` and `labels` share a grid; HU; the two images may have any offset. Bones outside the fraction's
/// field of view follow their joints.
///
/// # Errors
/// [`Error::Registration`] when the images show no common anatomy.
pub fn fit_pose(skeleton: &Skeleton, planning: &Volume<f32>, labels: &LabelMap, fraction: &Volume<f32>, options: &FitOptions, progress: &dyn Progress) -> Result<FitResult> {
    let lists = candidates(skeleton, labels);
    let make_level = |(sigma, most): (f64, usize)| {
        let blurred = Tissue::blurred(planning, sigma);
        Level { fraction: Tissue::blurred(fraction, sigma), bones: lists.iter().map(|l| draw(l, &blurred, most)).collect() }
    };
    let steps = 3 + options.levels.len();
    progress.step(0, steps, "couch shift");
    let coarse = make_level((options.start_blur_mm, 4000));
    let fitter = Fitter::new(skeleton, options, &coarse);
    let (common, share) = common_motion(&merged(&lists, &Tissue::blurred(planning, options.start_blur_mm)), &coarse.fraction, options.measure)?;
    let mut warnings = Vec::new();
    if share < 0.4 {
        warnings.push(Warning::new("weak-start", format!("the couch shift explains only {:.0} % of the bone contrast; look at the fusion images", 100.0 * share)));
    }
    let mut transforms = vec![common; skeleton.bones.len()];
    let mut stops = vec![String::from("follows its joint"); skeleton.bones.len()];
    for (n, &resolution) in options.outward.iter().enumerate() {
        progress.step(1 + n, steps, "bone by bone");
        let level = make_level(resolution);
        fitter.outwards(&level, &mut transforms, &mut stops, n == 0)?;
    }
    let mut last = None;
    for (n, &resolution) in options.levels.iter().enumerate() {
        progress.step(3 + n, steps, "all bones");
        let mut level = make_level(resolution);
        let mut solution = fitter.together(&level, &mut transforms)?;
        stops.iter_mut().for_each(|s| s.clone_from(&solution.stop));
        if fitter.drop_unexplained(&mut level, &mut transforms) {
            solution = fitter.together(&level, &mut transforms)?;
        }
        last = Some((level, solution));
    }
    let (level, solution) = last.ok_or_else(|| Error::usage("fit.levels is empty", "give at least one (blur mm, samples) pair"))?;
    let used: Vec<bool> = level.bones.iter().map(|s| !s.points.is_empty()).collect();
    let full = make_level(options.levels[options.levels.len() - 1]);
    let before = fitter.evaluate(&full, &vec![common; transforms.len()]);
    let after = fitter.evaluate(&full, &transforms);
    let bones = fitter.describe(&transforms, &stops, &before, &after, &used, &solution.curvature);
    Ok(FitResult { pose: skeleton.pose_of(&transforms), transforms, bones, common, common_share: share, warnings })
}

/// A sample of all bones as one.
fn merged(lists: &[Vec<u32>], image: &Tissue) -> Samples {
    let mut all: Vec<u32> = lists.iter().flatten().copied().collect();
    all.sort_unstable();
    draw(&all, image, 1500)
}

impl<'a> Fitter<'a> {
    fn new(skeleton: &'a Skeleton, options: &'a FitOptions, level: &Level) -> Self {
        let mut centres = Vec::new();
        let mut radii = Vec::new();
        for s in &level.bones {
            let n = s.points.len().max(1) as f64;
            let c = Point3::from(s.points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / n);
            radii.push((s.points.iter().map(|p| (p - c).norm_squared()).sum::<f64>() / n).sqrt().max(1.0));
            centres.push(c);
        }
        Self { skeleton, options, centres, radii }
    }

    fn body<'b>(&self, level: &'b Level, bone: usize, base: Rigid) -> Body<'b> {
        Body { samples: &level.bones[bone], base, centre: self.centres[bone], radius: self.radii[bone] }
    }

    fn evaluate(&self, level: &Level, transforms: &[Rigid]) -> Vec<Evaluation> {
        let bodies = (0..transforms.len()).map(|b| self.body(level, b, transforms[b])).collect();
        PoseProblem { bodies, links: Vec::new(), fraction: &level.fraction, measure: self.options.measure }.similarities(transforms, false)
    }

    /// One bone after the other, each starting from a neighbour that is already placed and held to it by their joint.
    ///
    /// `fresh`: nothing is placed yet, bones take over their neighbour's motion; else each starts where it is.
    fn outwards(&self, level: &Level, transforms: &mut [Rigid], stops: &mut [String], fresh: bool) -> Result<()> {
        let n = transforms.len();
        let bones = &self.skeleton.bones;
        let now = self.evaluate(level, transforms);
        let weight = |b: usize, e: &Evaluation| level.bones[b].volume_mm3 * e.visible * e.explained.max(0.0);
        let root = (0..n).max_by(|&a, &b| weight(a, &now[a]).total_cmp(&weight(b, &now[b])).then(b.cmp(&a))).unwrap_or(0);
        let mut placed = vec![false; n];
        let neighbours = |b: usize| (0..n).filter(move |&o| bones[b].parent == Some(o) || bones[o].parent == Some(b));
        let mut next = Some((root, root));
        while let Some((bone, from)) = next {
            if fresh {
                transforms[bone] = transforms[from];
            }
            let body = self.body(level, bone, transforms[bone]);
            let links = neighbours(bone).filter(|&o| placed[o]).map(|o| self.link(bone, o, transforms[o])).collect();
            let problem = PoseProblem { bodies: vec![body], links, fraction: &level.fraction, measure: self.options.measure };
            let seen = problem.similarities(&[transforms[bone]], false)[0].visible;
            if seen >= LEAST_VISIBLE {
                let body = self.body(level, bone, transforms[bone]);
                let solution = solve(problem, self.options.tolerance_mm, self.options.max_iterations)?;
                transforms[bone] = body.transform(solution.x.as_slice());
                stops[bone] = solution.stop;
            }
            placed[bone] = true;
            // Next: the unplaced neighbour of a placed bone that the image shows best, seen from that neighbour's motion.
            next = (0..n)
                .filter(|&b| !placed[b])
                .filter_map(|b| neighbours(b).find(|&o| placed[o]).map(|o| (b, o)))
                .map(|(b, o)| {
                    let t = if fresh { transforms[o] } else { transforms[b] };
                    let p = PoseProblem { bodies: vec![self.body(level, b, t)], links: Vec::new(), fraction: &level.fraction, measure: self.options.measure };
                    (level.bones[b].volume_mm3 * p.similarities(&[t], false)[0].visible, b, o)
                })
                .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
                .map(|(_, b, o)| (b, o));
        }
        Ok(())
    }

    /// Takes the samples from bones that the image does not explain and puts them back to their parent's motion.
    fn drop_unexplained(&self, level: &mut Level, transforms: &mut [Rigid]) -> bool {
        let mut any = false;
        for (b, e) in self.evaluate(level, transforms).iter().enumerate() {
            if e.visible > 0.0 && (e.visible < LEAST_VISIBLE || e.explained < LEAST_EXPLAINED) {
                any = true;
                level.bones[b].points.clear();
                level.bones[b].values.clear();
                if let Some(parent) = self.skeleton.bones[b].parent {
                    transforms[b] = transforms[parent];
                }
            }
        }
        any
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

    /// All bones and all joints at once.
    fn together(&self, level: &Level, transforms: &mut Vec<Rigid>) -> Result<Solution> {
        let make = || PoseProblem {
            bodies: (0..transforms.len()).map(|b| self.body(level, b, transforms[b])).collect(),
            links: self.skeleton.bones.iter().enumerate().filter_map(|(b, bone)| {
                Some(Link { joint: &bone.joint, parent: End::Moving(bone.parent?), child: End::Moving(b) })
            }).collect(),
            fraction: &level.fraction,
            measure: self.options.measure,
        };
        let solution = solve(make(), self.options.tolerance_mm, self.options.max_iterations)?;
        let moved = make().transforms(&solution.x);
        *transforms = moved;
        Ok(solution)
    }

    fn describe(&self, transforms: &[Rigid], stops: &[String], before: &[Evaluation], after: &[Evaluation], used: &[bool], curvature: &DMatrix<f64>) -> Vec<BoneFit> {
        let covariance = curvature.clone().cholesky().map(|c| c.inverse());
        let sd = |at: usize| {
            let Some(c) = &covariance else { return f64::INFINITY };
            let block: Matrix3<f64> = c.fixed_view::<3, 3>(at, at).into_owned();
            block.symmetric_eigenvalues().max().max(0.0).sqrt()
        };
        self.skeleton.bones.iter().enumerate().map(|(b, bone)| {
            let visible = after[b].visible;
            let seen = visible > 0.0;
            let excess = bone.parent.map_or(0.0, |p| limit_excess(&bone.joint, &relative(&bone.joint, &transforms[p], &transforms[b])));
            BoneFit {
                name: bone.name.clone(),
                transform: transforms[b],
                visible,
                similarity_before: (before[b].visible > 0.0).then(|| before[b].explained.max(0.0)),
                similarity_after: seen.then(|| after[b].explained.max(0.0)),
                stop: stops[b].clone(),
                position_sd_mm: sd(6 * b + 3),
                rotation_sd_deg: (sd(6 * b) / self.radii[b]).to_degrees(),
                limit_excess: excess,
                motion_mm: (transforms[b] * self.centres[b] - self.centres[b]).norm(),
                determined_by: if used[b] && visible >= LEAST_VISIBLE { "image" } else { "joint" }.into(),
            }
        }).collect()
    }
}
