//! Trust-region loop of the dense and the sparse solver.
//!
//! The rules are those of Ceres' Levenberg–Marquardt strategy (Agarwal et al.; Madsen, Nielsen and
//! Tingleff, "Methods for non-linear least squares problems", 2004, section 3.2), because the meaning of
//! `max_num_iterations` in existing configurations depends on them.

mod options;
mod step_quality;
mod summary;

pub use options::SolverOptions;
use step_quality::StepQuality;
pub use summary::{Progress, Summary, Termination};

/// One step of the linearised problem.
pub(crate) struct Step {
    /// Decrease of the cost predicted by the linear model; positive.
    pub model_cost_change: f64,
    /// Norm of the change of the parameters.
    pub norm: f64,
}

/// Interface of a problem to the loop. The current state is always linearised; a candidate is only evaluated.
pub(crate) trait Linearized {
    /// Largest absolute component of the gradient at the current state.
    fn gradient_max_norm(&self) -> f64;
    /// Norm of the current parameters.
    fn parameter_norm(&self) -> f64;
    /// Solves the normal equations damped for this radius and forms the candidate. `None` if they cannot be
    /// solved or the model predicts no decrease.
    fn compute_step(&mut self, radius: f64, options: &SolverOptions) -> Option<Step>;
    /// Cost of the candidate; `None` if it cannot be evaluated.
    fn evaluate_candidate(&mut self) -> Option<f64>;
    /// Makes the candidate the current state and linearises there; false if it cannot be evaluated.
    fn accept_candidate(&mut self) -> bool;
    /// Stores the current state as the best one.
    fn keep_as_best(&mut self);
    /// Called after every iteration with the progress so far; returns false to stop.
    fn report(&mut self, _progress: &Progress) -> bool {
        true
    }
}

/// Minimises from a linearised start with cost `initial_cost`. The problem stores the best state itself.
pub(crate) fn minimize(problem: &mut impl Linearized, initial_cost: f64, options: &SolverOptions) -> Summary {
    problem.keep_as_best();
    let mut run = TrustRegion {
        problem,
        options,
        radius: options.initial_trust_region_radius,
        decrease_factor: 2.0,
        invalid_steps: 0,
        step_is_successful: true,
        cost: initial_cost,
        quality: StepQuality::new(initial_cost, options.use_nonmonotonic_steps),
        summary: Summary {
            initial_cost,
            final_cost: initial_cost,
            iterations: 0,
            successful_steps: 0,
            termination: Termination::MaxIterations,
        },
    };
    loop {
        let end = run.check().or_else(|| run.iterate());
        if let Some(termination) = end {
            return Summary { termination, ..run.summary };
        }
    }
}

struct TrustRegion<'a, L> {
    problem: &'a mut L,
    options: &'a SolverOptions,
    radius: f64,
    decrease_factor: f64,
    invalid_steps: u32,
    step_is_successful: bool,
    cost: f64,
    quality: StepQuality,
    summary: Summary,
}

impl<L: Linearized> TrustRegion<'_, L> {
    /// Reports the progress, and returns the reason to stop before the next step, if any.
    fn check(&mut self) -> Option<Termination> {
        let gradient_max_norm = self.problem.gradient_max_norm();
        let progress = Progress {
            iteration: self.summary.iterations,
            cost: self.cost,
            gradient_max_norm,
            trust_region_radius: self.radius,
            step_is_successful: self.step_is_successful,
        };
        if !self.problem.report(&progress) {
            Some(Termination::Cancelled)
        } else if self.summary.iterations >= self.options.max_num_iterations {
            Some(Termination::MaxIterations)
        } else if self.step_is_successful && gradient_max_norm <= self.options.gradient_tolerance {
            Some(Termination::GradientTolerance)
        } else if self.radius <= self.options.min_trust_region_radius {
            Some(Termination::TrustRegionTooSmall)
        } else {
            None
        }
    }

    /// Tries one step. A step that changes almost nothing is not taken and ends the loop.
    fn iterate(&mut self) -> Option<Termination> {
        self.summary.iterations += 1;
        self.step_is_successful = false;
        let Some(step) = self.problem.compute_step(self.radius, self.options) else {
            self.invalid_steps += 1;
            self.shrink();
            let too_many = self.invalid_steps >= self.options.max_num_consecutive_invalid_steps;
            return too_many.then_some(Termination::InvalidSteps);
        };
        self.invalid_steps = 0;
        let candidate_cost = self.problem.evaluate_candidate().filter(|c| c.is_finite());
        let tolerance = self.options.parameter_tolerance;
        if step.norm <= tolerance * (self.problem.parameter_norm() + tolerance) {
            return Some(Termination::ParameterTolerance);
        }
        let Some(candidate_cost) = candidate_cost else {
            self.shrink();
            return None;
        };
        if (self.cost - candidate_cost).abs() <= self.options.function_tolerance * self.cost {
            return Some(Termination::FunctionTolerance);
        }
        let ratio = self.quality.of(candidate_cost, step.model_cost_change);
        if ratio <= self.options.min_relative_decrease {
            self.shrink();
            return None;
        }
        self.accept(candidate_cost, ratio, &step)
    }

    fn accept(&mut self, cost: f64, ratio: f64, step: &Step) -> Option<Termination> {
        if !self.problem.accept_candidate() {
            return Some(Termination::EvaluationFailed);
        }
        self.cost = cost;
        self.quality.accept(cost, step.model_cost_change);
        self.step_is_successful = true;
        self.summary.successful_steps += 1;
        if cost < self.summary.final_cost {
            self.summary.final_cost = cost;
            self.problem.keep_as_best();
        }
        let divisor = (1.0 - (2.0 * ratio - 1.0).powi(3)).max(1.0 / 3.0);
        self.radius = (self.radius / divisor).min(self.options.max_trust_region_radius);
        self.decrease_factor = 2.0;
        None
    }

    /// Successive failures shrink the region at an increasing rate.
    fn shrink(&mut self) {
        self.radius /= self.decrease_factor;
        self.decrease_factor *= 2.0;
    }
}
