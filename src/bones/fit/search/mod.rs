//! The start where one motion of all bones does not explain the fraction: each bone proposes where it may be, and the jointed
//! skeleton chooses (docs/decisions/fit.md).

mod correlate;
mod ratio;
mod template;
mod tie;
mod tree;

pub use template::Anatomy;

use super::coarse::Coarse;
use super::problem::{Body, PoseProblem};
use super::samples::Samples;
use super::shape::Shapes;
use super::similarity::{Evaluation, Measure};
use super::solver::solve;
use super::tissue::Tissue;
use crate::error::Result;
use crate::geometry::Rigid;
use crate::skeleton::Skeleton;
use crate::volume::Volume;
use correlate::{Proposal, Ready, Sums, Turns, proposals};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use ratio::RatioSums;
use rayon::prelude::*;
use template::Template;
use tie::tie;
use tree::{Tree, least};

/// Candidates of a bone.
const CANDIDATES: usize = 10;
/// Samples of a bone that refine and judge its candidates.
const SAMPLES: usize = 600;
/// A larger bone counts as one of this volume, mm^3: the rim of a skull fits the border of any view, and must not outweigh the
/// vertebrae that are there.
pub const MOST_MM3: f64 = 40_000.0;
/// Starts that the search gives at most.
const STARTS: usize = 4;
/// Starts whose bones in view are nearer than this on the mean are one, mm.
const APART_MM: f64 = 8.0;

/// Turns of a bone, degrees about x, y and z. The first [`EVERYWHERE`] are looked at everywhere.
const TURNS: [[f64; 3]; 17] = [
    [0.0, 0.0, 0.0],
    [-18.0, 0.0, 0.0],
    [18.0, 0.0, 0.0],
    [0.0, 0.0, -15.0],
    [0.0, 0.0, 15.0],
    [0.0, -15.0, 0.0],
    [0.0, 15.0, 0.0],
    [-12.0, 0.0, 0.0],
    [12.0, 0.0, 0.0],
    [-24.0, 0.0, 0.0],
    [24.0, 0.0, 0.0],
    [-12.0, 0.0, -15.0],
    [-12.0, 0.0, 15.0],
    [12.0, 0.0, -15.0],
    [12.0, 0.0, 15.0],
    [24.0, 0.0, -15.0],
    [24.0, 0.0, 15.0],
];
const EVERYWHERE: usize = 7;
/// In an image of another modality so few bones hardly show how they are turned, and no joint does: they are looked for in turns of
/// multiples of [`STEP_DEG`] about each axis up to [`MOST_DEG`], everywhere in those of twice the step.
const FEW: usize = 3;
const STEP_DEG: f64 = 15.0;
const MOST_DEG: f64 = 46.0;

/// Turns that are tried, those that are looked at everywhere first, and how many these are.
fn turns(wide: bool) -> (Vec<UnitQuaternion<f64>>, usize) {
    if !wide {
        let of = |t: [f64; 3]| t.map(f64::to_radians);
        let turn = |[x, y, z]: [f64; 3]| UnitQuaternion::from_euler_angles(x, y, z);
        return (TURNS.map(|t| turn(of(t))).to_vec(), EVERYWHERE);
    }
    let steps = -3i32..=3;
    let all = steps.clone().flat_map(|x| steps.clone().flat_map(move |y| (-3..=3).map(move |z| [x, y, z])));
    let angles = |v: &[i32; 3]| Vector3::from(v.map(f64::from)) * STEP_DEG;
    let all = all.filter(|v| angles(v).norm() <= MOST_DEG);
    let (first, rest): (Vec<[i32; 3]>, Vec<[i32; 3]>) = all.partition(|v| v.iter().all(|s| s % 2 == 0));
    let everywhere = first.len();
    let turn = |v: &[i32; 3]| UnitQuaternion::from_scaled_axis(angles(v).map(f64::to_radians));
    (first.iter().chain(&rest).map(turn).collect(), everywhere)
}

/// What is sought, and where.
pub struct Search<'a> {
    /// The bones and their joints.
    pub skeleton: &'a Skeleton,
    /// Planning, coarse.
    pub anatomy: &'a Anatomy,
    /// The fraction at the coarsest resolution of the fit.
    pub tissue: &'a Tissue,
    /// The bones' samples there.
    pub bones: &'a [Samples],
    /// How values are compared.
    pub measure: Measure,
    /// Descriptors of planning and fraction, where these are compared too.
    pub shapes: Option<&'a Shapes<'a>>,
}

/// Where the bones may be, all together.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// Motion of each bone, planning to fraction.
    pub transforms: Vec<Rigid>,
    /// Evidence for each bone.
    pub evidence: Vec<f64>,
    /// The bone with the most.
    pub root: usize,
    /// Cost of its bones and joints: the less, the better.
    pub cost: f64,
    /// How far it takes the bones of the best hypothesis from where that has them, mm.
    pub apart_mm: f64,
    /// Bones that proposed it, by their place in the skeleton.
    pub proposed_by: Vec<usize>,
}

/// A motion that a bone proposes.
struct State {
    bone: usize,
    motion: Rigid,
}

impl Search<'_> {
    /// The best hypotheses that differ, best first. `known`: further motions to choose from.
    ///
    /// # Errors
    /// As the solver.
    pub fn hypotheses(&self, fraction: &Volume<f32>, known: &[Rigid]) -> Result<Vec<Hypothesis>> {
        let ready = match self.shapes {
            Some(shapes) => Ready::new(shapes.coarse(), Some(shapes)),
            None => Ready::new(&Coarse::new(fraction), None),
        };
        let templates = self.anatomy.templates(self.skeleton);
        let (all, everywhere) = turns(self.shapes.is_some() && templates.len() <= FEW);
        let turns = Turns { all: &all, everywhere };
        let found: Vec<Vec<Proposal>> = templates.iter().map(|bone| self.proposals(bone, &ready, &turns)).collect();
        let samples: Vec<Samples> = self.bones.iter().map(|bone| bone.thinned(SAMPLES)).collect();
        let each: Vec<(&Template<'_>, &Proposal)> =
            templates.iter().zip(&found).flat_map(|(t, list)| list.iter().map(move |p| (t, p))).collect();
        let refined: Vec<Result<State>> = each.par_iter().map(|(t, p)| self.refined(t, p, &samples[t.bone])).collect();
        let mut states = refined.into_iter().collect::<Result<Vec<State>>>()?;
        states.extend(known.iter().map(|&motion| State { bone: usize::MAX, motion }));
        if states.is_empty() {
            return Ok(Vec::new());
        }
        let evaluations = |(b, s): (usize, &Samples)| -> Vec<(f64, f64)> {
            let bodies = states.iter().map(|state| self.body(b, s, state.motion)).collect();
            let problem = PoseProblem { bodies, links: Vec::new(), fraction: Some(self.tissue), measure: self.measure };
            let all: Vec<Rigid> = states.iter().map(|s| s.motion).collect();
            let weight = (MOST_MM3 / s.volume_mm3.max(1.0)).min(1.0);
            let weighed = |e: &Evaluation| (e.cost.min(0.0) * weight * e.visible, e.visible);
            problem.similarities(&all, false).iter().map(weighed).collect()
        };
        let own: Vec<Vec<(f64, f64)>> = samples.iter().enumerate().map(evaluations).collect();
        let joint = |b: usize, s: usize, t: usize| {
            if s == t { 0.0 } else { tie(&self.skeleton.bones[b].joint, &states[s].motion, &states[t].motion) }
        };
        let costs = own.iter().map(|o| o.iter().map(|e| e.0).collect()).collect();
        let tree = Tree { skeleton: self.skeleton, own: costs, joint: &joint };
        let marginals = tree.solve();
        let mut order: Vec<(f64, usize, usize)> = (marginals.costs.iter().enumerate())
            .flat_map(|(b, costs)| costs.iter().enumerate().map(move |(s, c)| (*c, b, s)))
            .filter(|&(_, b, s)| own[b][s].1 > 0.3)
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut out: Vec<Hypothesis> = Vec::new();
        for (cost, b, s) in order {
            let chosen = marginals.states(self.skeleton, b, s);
            let transforms: Vec<Rigid> = chosen.iter().map(|&s| states[s].motion).collect();
            if out.iter().any(|h| self.apart(h, &transforms) < APART_MM) {
                continue;
            }
            let evidence: Vec<f64> = chosen.iter().enumerate().map(|(b, &s)| -own[b][s].0).collect();
            let mut proposed_by: Vec<usize> =
                chosen.iter().map(|&s| states[s].bone).filter(|&b| b != usize::MAX).collect();
            proposed_by.sort_unstable();
            proposed_by.dedup();
            let (root, _) = least(chosen.iter().enumerate().map(|(b, &s)| own[b][s].0));
            let apart_mm = out.first().map_or(0.0, |best| self.apart(best, &transforms));
            out.push(Hypothesis { apart_mm, transforms, evidence, root, cost, proposed_by });
            if out.len() == STARTS {
                break;
            }
        }
        Ok(out)
    }

    fn proposals(&self, bone: &Template<'_>, ready: &Ready, turns: &Turns<'_>) -> Vec<Proposal> {
        match self.measure {
            Measure::CorrelationRatio => proposals::<RatioSums>(bone, ready, turns, CANDIDATES, self.shapes),
            _ => proposals::<Sums>(bone, ready, turns, CANDIDATES, None),
        }
    }

    /// How far other motions take the bones of a hypothesis from where it has them, on the mean over its evidence, mm.
    fn apart(&self, found: &Hypothesis, other: &[Rigid]) -> f64 {
        let bones = self.skeleton.bones.iter().enumerate();
        let (sum, all) = bones.fold((0.0, 1e-9), |(sum, all), (b, bone)| {
            let (w, c) = (found.evidence[b], bone.centroid);
            (sum + w * (found.transforms[b] * c - other[b] * c).norm(), all + w)
        });
        sum / all
    }

    fn body<'b>(&'b self, bone: usize, samples: &'b Samples, base: Rigid) -> Body<'b> {
        let n = samples.points.len().max(1) as f64;
        let centre = Point3::from(samples.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / n);
        let square = samples.points.iter().map(|p| (p - centre).norm_squared()).sum::<f64>() / n;
        let shape = self.shapes.map(|shapes| shapes.of(bone, &base.rotation));
        Body { samples, base, centre, radius: square.sqrt().max(1.0), held: None, shape }
    }

    /// A proposal after a fit of that bone alone.
    fn refined(&self, bone: &Template<'_>, proposal: &Proposal, samples: &Samples) -> Result<State> {
        let shift = proposal.middle.coords - proposal.turn * bone.centre.coords;
        let base = Rigid::from_parts(Translation3::from(shift), proposal.turn);
        let problem = || PoseProblem {
            bodies: vec![self.body(bone.bone, samples, base)],
            links: Vec::new(),
            fraction: Some(self.tissue),
            measure: self.measure,
        };
        let solution = solve(problem(), 0.2, 15)?;
        Ok(State { bone: bone.bone, motion: problem().transforms(&solution.x)[0] })
    }
}
