//! Least squares with one to eight parameters, without allocation.

mod normal_equations;

pub use normal_equations::NormalEquations;

use nalgebra::SVector;

use crate::trust_region::{Linearized, SolverOptions, Step, Summary, Termination, minimize};

/// A least-squares problem with `N` degrees of freedom; see [`solve_dense`].
pub trait DenseProblem<const N: usize> {
    /// The unknown, for example a pose. It is passed by value: keep it small.
    type State: Clone;

    /// The cost `½ Σ ρ(r²)` at `state`, or `None` if it cannot be evaluated. If `normal` is given, it is
    /// initialised to zero; add `JᵀJ` and `Jᵀr` with respect to the local coordinates of
    /// [`DenseProblem::plus`] at `state`, with robust losses already applied.
    fn evaluate(&mut self, state: &Self::State, normal: Option<&mut NormalEquations<N>>) -> Option<f64>;

    /// The state updated by the local coordinates `delta`; zero changes nothing.
    fn plus(&self, state: &Self::State, delta: &SVector<f64, N>) -> Self::State;

    /// Norm of the parameters, to which [`SolverOptions::parameter_tolerance`] is relative. One unless
    /// overridden.
    fn norm(&self, _state: &Self::State) -> f64 {
        1.0
    }
}

/// Minimises `problem` from `initial` and returns the best state found. Levenberg–Marquardt with the rules
/// of [`SolverOptions`]; normal equations with column scaling, solved by Cholesky factorisation.
///
/// It terminates whatever the problem returns: with the initial state if that cannot be evaluated
/// ([`Termination::EvaluationFailed`]) or no step can be computed ([`Termination::InvalidSteps`]).
pub fn solve_dense<P: DenseProblem<N>, const N: usize>(
    problem: &mut P,
    initial: P::State,
    options: &SolverOptions,
) -> (P::State, Summary) {
    let mut normal = NormalEquations::new();
    let cost = problem.evaluate(&initial, Some(&mut normal));
    let Some(cost) = cost.filter(|c| c.is_finite() && normal.is_finite()) else {
        let failed = Summary {
            initial_cost: f64::NAN,
            final_cost: f64::NAN,
            iterations: 0,
            successful_steps: 0,
            termination: Termination::EvaluationFailed,
        };
        return (initial, failed);
    };
    let mut run = DenseRun {
        problem,
        // Scaling once, at the start, keeps the meaning of the radius during the whole run.
        column_scale: normal.hessian.diagonal().map(|d| 1.0 / (1.0 + d.max(0.0).sqrt())),
        normal,
        candidate_normal: NormalEquations::new(),
        candidate: initial.clone(),
        best: initial.clone(),
        current: initial,
    };
    let summary = minimize(&mut run, cost, options);
    (run.best, summary)
}

struct DenseRun<'a, P: DenseProblem<N>, const N: usize> {
    problem: &'a mut P,
    column_scale: SVector<f64, N>,
    current: P::State,
    candidate: P::State,
    best: P::State,
    normal: NormalEquations<N>,
    candidate_normal: NormalEquations<N>,
}

impl<P: DenseProblem<N>, const N: usize> Linearized for DenseRun<'_, P, N> {
    fn gradient_max_norm(&self) -> f64 {
        self.normal.gradient.amax()
    }

    fn parameter_norm(&self) -> f64 {
        self.problem.norm(&self.current)
    }

    fn compute_step(&mut self, radius: f64, options: &SolverOptions) -> Option<Step> {
        let scaled = self.normal.scaled(&self.column_scale);
        let scaled_step = scaled.solve_damped(radius, options.lm_diagonal_bounds)?;
        let model_cost_change = scaled.model_cost_change(&scaled_step);
        let step = scaled_step.component_mul(&self.column_scale);
        self.candidate = self.problem.plus(&self.current, &step);
        (model_cost_change > 0.0).then(|| Step { model_cost_change, norm: step.norm() })
    }

    /// Derivatives are evaluated together with the cost: nearly every step is accepted, so evaluating them
    /// later would mean evaluating everything twice.
    fn evaluate_candidate(&mut self) -> Option<f64> {
        self.candidate_normal = NormalEquations::new();
        let cost = self.problem.evaluate(&self.candidate, Some(&mut self.candidate_normal))?;
        self.candidate_normal.is_finite().then_some(cost)
    }

    fn accept_candidate(&mut self) -> bool {
        std::mem::swap(&mut self.current, &mut self.candidate);
        std::mem::swap(&mut self.normal, &mut self.candidate_normal);
        true
    }

    fn keep_as_best(&mut self) {
        self.best = self.current.clone();
    }
}

#[cfg(test)]
mod tests;
