//! Limbs that lie elsewhere than their joint leaves them: arms up in planning and down in the fraction.

use super::level::Level;
use super::problem::{Body, End, Link, PoseProblem};
use super::schedule::Fitter;
use super::similarity::{Evaluation, Measure};
use super::solver::solve;
use super::{BoneFit, DeterminedBy};
use crate::error::Result;
use crate::geometry::Rigid;
use crate::skeleton::{Joint, JointPose};
use rayon::prelude::*;

/// Step of the turns that are tried, degrees.
const STEP_DEG: f64 = 15.0;
/// Turns that are looked at more closely, by these steps, at most so many of each: between two of the first step the far end of an
/// upper arm lies beside where it is seen.
const CLOSER: usize = 64;
const CLOSER_DEG: [f64; 3] = [7.5, 4.0, 2.0];
const CLOSER_ROUNDS: usize = 4;
/// Turns that are fitted, and those nearer to each other than this, degrees, of which one is.
const CANDIDATES: usize = 8;
const SAME_DEG: f64 = 4.0;
/// Samples of a bone that judge a turn.
const SAMPLES: usize = 300;
/// A bone may be where it explains this share of its contrast, with this share of it in view. Right places of upper arms beside an
/// armpit that folds explain 0.39 and more at this blur; the whole fit, which is finer, drops what it does not explain.
const LEAST_EXPLAINED: f64 = 0.3;
const LEAST_VISIBLE: f64 = 0.3;

/// A turn and what it shows, after steps that are ever smaller to turns that show more.
fn closer(
    from: (Evaluation, JointPose),
    at: &(impl Fn(JointPose) -> (Evaluation, JointPose) + Sync),
) -> (Evaluation, JointPose) {
    let mut best = from;
    for step in CLOSER_DEG.map(f64::to_radians) {
        for _ in 0..CLOSER_ROUNDS {
            let around = (0..6).map(|n| {
                let mut pose = best.1;
                pose.rotation[n / 2] += if n % 2 == 0 { step } else { -step };
                at(pose)
            });
            let Some(next) = around.min_by(|a, b| a.0.cost.total_cmp(&b.0.cost)) else { break };
            if next.0.cost >= best.0.cost {
                break;
            }
            best = next;
        }
    }
    best
}

/// All turns of a joint, at steps over its soft ranges.
fn turns(joint: &Joint) -> Vec<JointPose> {
    let steps = joint.rotation_range_deg.map(|[low, high]| {
        let n = ((high - low) / STEP_DEG).ceil().max(1.0) as usize;
        (0..=n).map(move |k| (low + (high - low) * k as f64 / n as f64).to_radians()).collect::<Vec<f64>>()
    });
    let [x, y, z] = &steps;
    let all = x.iter().flat_map(|&x| y.iter().flat_map(move |&y| z.iter().map(move |&z| [x, y, z])));
    all.map(|rotation| JointPose { rotation, translation: [0.0; 3] }).collect()
}

impl Fitter<'_> {
    /// Whether a bone may lie far from where its joint leaves it: its joint turns far, or that of a bone on it.
    fn free(&self, bone: usize) -> bool {
        let bones = &self.skeleton.bones;
        bones[bone].joint.turns_far() || bones.iter().any(|b| b.parent == Some(bone) && b.joint.turns_far())
    }

    /// Whether a limb is not found whose parent is.
    pub(super) fn lost_limb(&self, fits: &[BoneFit]) -> bool {
        let found = |b: usize| fits[b].determined_by == DeterminedBy::Image;
        let parents = self.skeleton.bones.iter().map(|bone| bone.parent);
        parents.enumerate().any(|(b, p)| p.is_some_and(|p| self.free(b) && found(p) && !found(b)))
    }

    /// Where the limbs are that a fit has lost, with the other bones where it has them; `None` where none of them is found.
    ///
    /// # Errors
    /// As the solver.
    pub(super) fn limbs(&self, fits: &[BoneFit], level: &Level<'_>, measure: Measure) -> Result<Option<Vec<Rigid>>> {
        let bones = &self.skeleton.bones;
        let mut transforms: Vec<Rigid> = fits.iter().map(|f| f.transform).collect();
        let mut placed: Vec<bool> = fits.iter().map(|f| f.determined_by == DeterminedBy::Image).collect();
        let mut any = false;
        for b in 0..bones.len() {
            let Some(parent) = bones[b].parent.filter(|_| !placed[b]) else { continue };
            transforms[b] = transforms[parent];
            if self.free(b)
                && placed[parent]
                && let Some(found) = self.turned(b, &transforms[parent], level, measure)?
            {
                (transforms[b], placed[b], any) = (found, true, true);
            }
        }
        Ok(any.then_some(transforms))
    }

    /// The best place of a bone about its joint to a parent that is held.
    fn turned(&self, bone: usize, parent: &Rigid, level: &Level<'_>, measure: Measure) -> Result<Option<Rigid>> {
        let joint = &self.skeleton.bones[bone].joint;
        let few = level.drawn.bones[bone].thinned(SAMPLES);
        let body = |samples, base| Body { samples, ..self.body(level, bone, base) };
        let problem = |samples, base, links| PoseProblem {
            bodies: vec![body(samples, base)],
            links,
            fraction: Some(&level.fraction),
            measure,
        };
        let seen = |t: &Rigid| problem(&few, *t, Vec::new()).similarities(&[*t], false).remove(0);
        let at = |pose: JointPose| (seen(&(parent * joint.motion(&pose))), pose);
        let mut all: Vec<(Evaluation, JointPose)> = turns(joint).into_par_iter().map(at).collect();
        all.sort_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
        all.truncate(CLOSER);
        let mut all: Vec<(Evaluation, JointPose)> = all.into_par_iter().map(|from| closer(from, &at)).collect();
        // The sort is stable: of equal ones the first stays first.
        all.sort_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
        let mut some: Vec<Rigid> = Vec::new();
        for (_, pose) in all {
            let t = parent * joint.motion(&pose);
            let new = |o: &Rigid| o.rotation.angle_to(&t.rotation).to_degrees() > SAME_DEG;
            if some.len() < CANDIDATES && some.iter().all(new) {
                some.push(t);
            }
        }
        let fit = |base: &Rigid| {
            let link = || vec![Link { joint, parent: End::Held(*parent), child: End::Moving(0) }];
            let solution = solve(problem(&few, *base, link()), level.tolerance_mm, 40)?;
            let t = problem(&few, *base, Vec::new()).transforms(&solution.x)[0];
            Ok((seen(&t), t))
        };
        let fitted = some.par_iter().map(fit).collect::<Result<Vec<(Evaluation, Rigid)>>>()?;
        let best = fitted.into_iter().reduce(|a, b| if b.0.cost < a.0.cost { b } else { a });
        Ok(best.filter(|(e, _)| e.explained >= LEAST_EXPLAINED && e.visible >= LEAST_VISIBLE).map(|(_, t)| t))
    }
}
