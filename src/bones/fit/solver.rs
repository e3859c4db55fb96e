//! A damped Gauss-Newton solver (Levenberg 1944, Marquardt 1963) that runs inside argmin's executor.
//!
//! argmin's own trust region has no stopping rule besides the iteration limit and can panic on degenerate
//! subproblems; docs/decisions/fit.md has the comparison.

use super::problem::PoseProblem;
use super::stop::Stop;
use crate::error::{Error, Result};
use argmin::core::{Executor, IterState, KV, Problem, Solver, State, TerminationReason, TerminationStatus};
use nalgebra::{DMatrix, DVector};

type PoseState = IterState<DVector<f64>, DVector<f64>, (), DMatrix<f64>, (), f64>;

/// Levenberg-Marquardt on a cost with Gauss-Newton curvature.
struct DampedNewton {
    damping: f64,
    tolerance: f64,
    step: f64,
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

impl Solver<PoseProblem<'_>, PoseState> for DampedNewton {
    fn name(&self) -> &'static str {
        "damped Gauss-Newton"
    }

    fn init(
        &mut self,
        problem: &mut Problem<PoseProblem<'_>>,
        mut state: PoseState,
    ) -> Result<(PoseState, Option<KV>), argmin::core::Error> {
        let x = state.take_param().ok_or_else(|| argmin::core::Error::msg("no start was given"))?;
        let local = problem.problem("gradient_count", |p| Ok(p.local(&x)))?;
        Ok((state.param(x).cost(local.cost).gradient(local.gradient).hessian(local.curvature), None))
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<PoseProblem<'_>>,
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
            if self.step >= self.tolerance {
                let trial = &x + &step;
                // Nearly every step is taken: its derivatives are found with its cost, which are most of the way to them.
                let local = problem.problem("gradient_count", |p| Ok(p.local(&trial)))?;
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
        if self.step < self.tolerance {
            TerminationStatus::Terminated(TerminationReason::SolverConverged)
        } else if self.damping > MOST_DAMPING {
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
    /// The step that it would have taken next.
    pub next: DVector<f64>,
}

/// Minimises a pose problem from its base transforms; stops when a step moves nothing by `tolerance` mm.
///
/// # Errors
/// [`Error::Internal`] when argmin reports a failure.
pub fn solve(problem: PoseProblem<'_>, tolerance: f64, max_iterations: u64) -> Result<Solution> {
    let n = 6 * problem.bodies.len();
    let solver = DampedNewton { damping: 1e-3, tolerance, step: f64::INFINITY };
    let failed = |e: argmin::core::Error| Error::Internal(format!("the pose optimiser failed: {e}"));
    let result = Executor::new(problem, solver)
        .configure(|s| s.param(DVector::zeros(n)).max_iters(max_iterations))
        .ctrlc(false)
        .run()
        .map_err(failed)?;
    let (damping, state) = (result.solver.damping, result.state);
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
            TerminationStatus::Terminated(other) => Stop::Other(other.text().into()),
            TerminationStatus::NotTerminated => Stop::Other("not terminated".into()),
        },
    })
}
