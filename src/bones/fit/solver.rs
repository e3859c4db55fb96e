//! A damped Gauss-Newton solver (Levenberg 1944, Marquardt 1963) that runs inside argmin's executor.
//!
//! argmin's own trust region has no stopping rule besides the iteration limit and can panic on degenerate
//! subproblems; docs/decisions/fit.md has the comparison.

use super::problem::{Local, PoseProblem};
use super::stop::Stop;
use crate::error::{Error, Result};
use argmin::core::{Executor, IterState, KV, Problem, Solver, State, TerminationReason, TerminationStatus};
use nalgebra::{DMatrix, DVector};

type PoseState = IterState<DVector<f64>, DVector<f64>, (), DMatrix<f64>, (), f64>;

/// What is minimised.
pub trait Cost {
    /// Number of parameters.
    fn parameters(&self) -> usize;
    /// Cost with derivatives.
    fn at(&self, x: &DVector<f64>) -> Local;
}

impl Cost for PoseProblem<'_> {
    fn parameters(&self) -> usize {
        6 * self.bodies.len()
    }

    fn at(&self, x: &DVector<f64>) -> Local {
        self.local(x)
    }
}

/// Levenberg-Marquardt on a cost with Gauss-Newton curvature.
struct DampedNewton {
    damping: f64,
    tolerance: f64,
    /// The greatest component of the last step.
    step: f64,
    /// What it would be without damping.
    asked: f64,
}

/// Damping at which no descent is left to find.
const MOST_DAMPING: f64 = 1e8;

/// Less damping changes a step too little to be worth a try after one that has failed.
const LEAST_HELP: f64 = 0.1;

/// `(H + damping * diag H)^-1 (-g)`; `None` when that is not positive definite.
fn damped_step(h: &DMatrix<f64>, g: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let mut a = h.clone();
    for i in 0..a.nrows() {
        a[(i, i)] += damping * h[(i, i)];
    }
    let step = a.cholesky()?.solve(&-g);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// The greatest component of the step that the curvature itself asks for, where a step damped by so much goes as far as `step`.
/// Little damping shortens none.
fn asked(h: &DMatrix<f64>, g: &DVector<f64>, damping: f64, step: f64) -> f64 {
    if damping < LEAST_HELP {
        return step;
    }
    damped_step(h, g, 0.0).map_or(f64::INFINITY, |whole| whole.amax())
}

/// A cost as argmin is given it.
struct Given<C>(C);

impl<C: Cost> Solver<Given<C>, PoseState> for DampedNewton {
    fn name(&self) -> &'static str {
        "damped Gauss-Newton"
    }

    fn init(
        &mut self,
        problem: &mut Problem<Given<C>>,
        mut state: PoseState,
    ) -> Result<(PoseState, Option<KV>), argmin::core::Error> {
        let x = state.take_param().ok_or_else(|| argmin::core::Error::msg("no start was given"))?;
        let local = problem.problem("gradient_count", |p| Ok(p.0.at(&x)))?;
        Ok((state.param(x).cost(local.cost).gradient(local.gradient).hessian(local.curvature), None))
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<Given<C>>,
        mut state: PoseState,
    ) -> Result<(PoseState, Option<KV>), argmin::core::Error> {
        let missing = || argmin::core::Error::msg("the solver's state is incomplete");
        let x = state.take_param().ok_or_else(missing)?;
        let g = state.take_gradient().ok_or_else(missing)?;
        let h = state.take_hessian().ok_or_else(missing)?;
        let cost = state.get_cost();
        let kv = Some(argmin::kv!("damping" => self.damping;));
        if let Some(step) = damped_step(&h, &g, self.damping) {
            self.step = step.amax();
            self.asked = asked(&h, &g, self.damping, self.step);
            if self.step >= self.tolerance {
                let trial = &x + &step;
                // Nearly every step is taken: its derivatives are found with its cost, which are most of the way to them.
                let local = problem.problem("gradient_count", |p| Ok(p.0.at(&trial)))?;
                let (fallen, expected) = (cost - local.cost, -(g.dot(&step) + 0.5 * step.dot(&(&h * &step))));
                if fallen >= 1e-3 * expected.max(0.0) {
                    self.damping = if fallen > 0.75 * expected { self.damping * 0.2 } else { self.damping }.max(1e-9);
                    let state = state.param(trial).cost(local.cost).gradient(local.gradient);
                    return Ok((state.hessian(local.curvature), kv));
                }
            }
        }
        self.damping = (self.damping * 5.0).max(LEAST_HELP);
        Ok((state.param(x).cost(cost).gradient(g).hessian(h), kv))
    }

    fn terminate(&mut self, _: &PoseState) -> TerminationStatus {
        let small = self.step < self.tolerance;
        if small && self.asked < self.tolerance {
            TerminationStatus::Terminated(TerminationReason::SolverConverged)
        } else if small || self.damping > MOST_DAMPING {
            TerminationStatus::Terminated(TerminationReason::SolverExit("no descent found".into()))
        } else {
            TerminationStatus::NotTerminated
        }
    }
}

/// Where an optimisation ended.
pub struct Solution {
    /// Parameters of the least cost.
    pub x: DVector<f64>,
    /// Least cost.
    pub cost: f64,
    /// Curvature there.
    pub curvature: DMatrix<f64>,
    /// Why it stopped.
    pub stop: Stop,
    /// The step that it would have taken next; after a stall what the curvature asks for.
    pub next: DVector<f64>,
}

/// Minimises a cost from zero; stops when a step moves nothing by `tolerance` (mm, of a pose). It has converged if the curvature
/// asks for no longer step; where only damping makes it so short, the cost does not fall as its derivatives say.
///
/// # Errors
/// [`Error::Internal`] when argmin reports a failure.
pub fn solve<C: Cost>(cost: C, tolerance: f64, max_iterations: u64) -> Result<Solution> {
    let n = cost.parameters();
    let solver = DampedNewton { damping: 1e-3, tolerance, step: f64::INFINITY, asked: f64::INFINITY };
    let failed = |e: argmin::core::Error| Error::Internal(format!("the pose optimiser failed: {e}"));
    let result = Executor::new(Given(cost), solver)
        .configure(|s| s.param(DVector::zeros(n)).max_iters(max_iterations))
        .ctrlc(false)
        .run()
        .map_err(failed)?;
    let (damping, state) = (result.solver.damping.min(LEAST_HELP), result.state);
    let missing = || Error::Internal("the pose optimiser returned no result".into());
    let next = state.get_hessian().zip(state.get_gradient()).and_then(|(h, g)| damped_step(h, g, damping));
    Ok(Solution {
        next: next.unwrap_or_else(|| DVector::zeros(n)),
        x: state.param.clone().ok_or_else(missing)?,
        cost: state.cost,
        curvature: state.hessian.clone().ok_or_else(missing)?,
        stop: match state.get_termination_status() {
            TerminationStatus::Terminated(TerminationReason::SolverConverged) => Stop::Converged,
            TerminationStatus::Terminated(TerminationReason::MaxItersReached) => Stop::IterationLimit(max_iterations),
            TerminationStatus::Terminated(TerminationReason::SolverExit(_)) => Stop::NoDescent,
            TerminationStatus::Terminated(other) => Stop::Other(other.text().into()),
            TerminationStatus::NotTerminated => Stop::Other("not terminated".into()),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `1/2 |x - 3|^2` that is told wrongly from a place on: no step falls as its slope promises.
    struct Stalling {
        from: f64,
    }

    impl Cost for Stalling {
        fn parameters(&self) -> usize {
            1
        }

        fn at(&self, x: &DVector<f64>) -> Local {
            let off = x[0] - 3.0;
            let wall = if x[0] > self.from { 10.0 * (x[0] - self.from) } else { 0.0 };
            Local {
                cost: 0.5 * off * off + wall,
                gradient: DVector::from_element(1, off),
                curvature: DMatrix::from_element(1, 1, 1.0),
            }
        }
    }

    #[test]
    fn a_bowl_is_descended_to_its_bottom() {
        let found = solve(Stalling { from: f64::MAX }, 1e-6, 100).unwrap();
        assert_eq!(found.stop, Stop::Converged);
        assert!((found.x[0] - 3.0).abs() < 1e-6 && found.next.amax() < 1e-6, "{} {}", found.x[0], found.next[0]);
    }

    #[test]
    fn a_stall_is_not_taken_for_the_bottom() {
        // Damping makes steps as small as one likes: at the wall the slope still asks for 2 mm.
        let found = solve(Stalling { from: 1.0 }, 1e-3, 1000).unwrap();
        assert_eq!(found.stop, Stop::NoDescent);
        assert!((found.x[0] - 1.0).abs() < 0.02, "{}", found.x[0]);
        assert!(found.next.amax() > 1.5, "it says that it would move on by {}", found.next[0]);
    }
}
