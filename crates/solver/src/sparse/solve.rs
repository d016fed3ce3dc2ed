//! Levenberg–Marquardt for sparse problems.

use std::ops::ControlFlow;

use super::block_system::BlockSystem;
use super::factor_view::CONSTANT;
use super::linearization::Linearization;
use super::problem::{FactorId, Problem, ProblemError};
use crate::trust_region::{Linearized, Progress, SolverOptions, Step, Summary, minimize};

impl Problem {
    /// Minimises the cost over all variables that are not constant, by Levenberg–Marquardt with the rules of
    /// [`SolverOptions`] and sparse Cholesky factorisation. The variables are set to the best values found.
    ///
    /// The result is the same for any number of threads of the rayon pool in which this runs. Degenerate
    /// directions, which no factor constrains, do not change. If the normal equations stay singular at any
    /// damping, the variables keep their initial values and the summary contains
    /// [`Termination::InvalidSteps`](crate::Termination::InvalidSteps).
    ///
    /// # Errors
    /// If the problem is too large, or a residual cannot be evaluated at the initial values.
    pub fn solve(&mut self, options: &SolverOptions) -> Result<Summary, ProblemError> {
        self.solve_observed(options, &mut |_| ControlFlow::Continue(()))
    }

    /// Like [`Problem::solve`]; `observer` is called before every iteration and at the end, and may stop
    /// the solver, which then keeps the best values so far.
    ///
    /// # Errors
    /// As [`Problem::solve`].
    pub fn solve_observed(
        &mut self,
        options: &SolverOptions,
        observer: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Summary, ProblemError> {
        let mut prepared = self.prepare()?;
        self.solve_with(&mut prepared, options, observer)
    }

    /// Analyses the structure of the problem once, for several solutions from different values. The analysis
    /// becomes invalid when variables or factors are added, or variables are made constant or free.
    pub(crate) fn prepare(&self) -> Result<Prepared, ProblemError> {
        let (linearization, system) = Linearization::new(self)?;
        Ok(Prepared { linearization, system })
    }

    /// [`Problem::solve`] with a prepared structure.
    pub(crate) fn solve_prepared(
        &mut self,
        prepared: &mut Prepared,
        options: &SolverOptions,
    ) -> Result<Summary, ProblemError> {
        self.solve_with(prepared, options, &mut |_| ControlFlow::Continue(()))
    }

    pub(crate) fn solve_with(
        &mut self,
        prepared: &mut Prepared,
        options: &SolverOptions,
        observer: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Summary, ProblemError> {
        let mut run = SparseRun::new(self, prepared, observer);
        let initial_cost = run.start().ok_or(ProblemError::NotEvaluable)?;
        let summary = minimize(&mut run, initial_cost, options);
        let best = run.best;
        self.values = best;
        Ok(summary)
    }

    /// The cost `½ Σ ρ(‖r‖²)` at the current values; `None` if some residual cannot be evaluated.
    pub fn cost(&self) -> Option<f64> {
        self.factor_costs().map(|(_, cost)| cost).sum()
    }

    /// The first factor that cannot be evaluated at the current values.
    pub fn first_bad_factor(&self) -> Option<FactorId> {
        self.factor_costs().find(|(_, cost)| cost.is_none()).map(|(id, _)| id)
    }
}

/// The structure of a problem and memory for its normal equations.
pub(crate) struct Prepared {
    pub linearization: Linearization,
    pub system: BlockSystem,
}

struct SparseRun<'a> {
    problem: &'a Problem,
    linearization: &'a mut Linearization,
    system: &'a mut BlockSystem,
    observer: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    current: Vec<f64>,
    candidate: Vec<f64>,
    best: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    product: Vec<f64>,
    damping: Vec<f64>,
    /// Squares of the column scales.
    squared_scale: Vec<f64>,
}

impl<'a> SparseRun<'a> {
    fn new(
        problem: &'a Problem,
        Prepared { linearization, system }: &'a mut Prepared,
        observer: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Self {
        let n = system.size();
        Self {
            current: problem.values.clone(),
            candidate: problem.values.clone(),
            best: problem.values.clone(),
            gradient: vec![0.0; n],
            step: vec![0.0; n],
            product: vec![0.0; n],
            damping: vec![0.0; n],
            squared_scale: Vec::new(),
            problem,
            linearization,
            system,
            observer,
        }
    }

    /// Linearises at the start and returns its cost. The column scales are fixed here, so that the radius has
    /// the same meaning during the whole run.
    fn start(&mut self) -> Option<f64> {
        let cost = self.linearization.cost(self.problem, &self.current)?;
        let Self { linearization, problem, current, system, gradient, .. } = self;
        if !linearization.linearize(problem, current, system, gradient) {
            return None;
        }
        let scale = |d: &f64| (1.0 + d.max(0.0).sqrt()).powi(-2);
        self.squared_scale = self.system.diagonal().iter().map(scale).collect();
        cost.is_finite().then_some(cost)
    }

    /// Sets the damping: the damped diagonal of the scaled matrix, converted to the unscaled one.
    fn set_damping(&mut self, radius: f64, (min, max): (f64, f64)) {
        let (damping, scale, values) = (&mut self.damping, &self.squared_scale, &self.system.values);
        BlockSystem::for_each_diagonal(&self.system.pattern, |i, at| {
            damping[i] = (values[at] * scale[i]).clamp(min, max) / (radius * scale[i]);
        });
    }

    fn form_candidate(&mut self) {
        let pattern = &self.system.pattern;
        for (variable, position) in self.problem.variables.iter().zip(&self.linearization.position) {
            if *position == CONSTANT {
                continue;
            }
            let range = variable.range();
            let start = pattern.starts[*position as usize] as usize;
            let delta = &self.step[start..start + pattern.dimensions[*position as usize] as usize];
            variable.manifold.plus(&self.current[range.clone()], delta, &mut self.candidate[range]);
        }
    }
}

impl Linearized for SparseRun<'_> {
    fn gradient_max_norm(&self) -> f64 {
        self.gradient.iter().fold(0.0, |max, g| g.abs().max(max))
    }

    fn parameter_norm(&self) -> f64 {
        let free = self.problem.variables.iter().zip(&self.linearization.position);
        let squares = free.filter(|(_, position)| **position != CONSTANT);
        squares.flat_map(|(v, _)| &self.current[v.range()]).map(|x| x * x).sum::<f64>().sqrt()
    }

    fn compute_step(&mut self, radius: f64, options: &SolverOptions) -> Option<Step> {
        self.set_damping(radius, options.lm_diagonal_bounds);
        if !self.system.factorize(&self.damping) {
            return None;
        }
        self.step.iter_mut().zip(&self.gradient).for_each(|(s, g)| *s = -g);
        self.system.solve(&mut self.step);
        self.system.multiply(&self.step, &mut self.product);
        let mut model_cost_change = 0.0;
        let mut squared_norm = 0.0;
        for ((s, g), p) in self.step.iter().zip(&self.gradient).zip(&self.product) {
            model_cost_change -= s * (g + 0.5 * p);
            squared_norm += s * s;
        }
        if !squared_norm.is_finite() {
            return None;
        }
        self.form_candidate();
        (model_cost_change > 0.0).then(|| Step { model_cost_change, norm: squared_norm.sqrt() })
    }

    fn evaluate_candidate(&mut self) -> Option<f64> {
        self.linearization.cost(self.problem, &self.candidate)
    }

    fn accept_candidate(&mut self) -> bool {
        std::mem::swap(&mut self.current, &mut self.candidate);
        let Self { linearization, problem, current, system, gradient, .. } = self;
        linearization.linearize(problem, current, system, gradient)
    }

    fn keep_as_best(&mut self) {
        self.best.copy_from_slice(&self.current);
    }

    fn report(&mut self, progress: &Progress) -> bool {
        (self.observer)(progress).is_continue()
    }
}
