//! The trust-region loop shared by the dense and the sparse solver.
//!
//! The rules are those of Ceres' Levenberg–Marquardt strategy (Agarwal et al.; Madsen, Nielsen and
//! Tingleff, "Methods for non-linear least squares problems", 2004, section 3.2), because the meaning of
//! `max_num_iterations` in existing configurations depends on them.

mod step_quality;

pub(crate) use step_quality::StepQuality;

/// When to stop, and how bold the steps are. The defaults are those of Ceres.
#[derive(Clone, Debug, PartialEq)]
pub struct SolverOptions {
    /// Steps tried at most, whether they succeed or not. Default 50.
    pub max_num_iterations: u32,
    /// Lets the cost rise for up to five steps in a row as long as it falls in the long run; helps in
    /// curved valleys. The best state seen is returned. Default false.
    pub use_nonmonotonic_steps: bool,
    /// Stops when a step changes the cost by less than this fraction of it. Default 1e-6.
    pub function_tolerance: f64,
    /// Stops when no component of the gradient is larger. Default 1e-10.
    pub gradient_tolerance: f64,
    /// Stops when a step is shorter than this times the norm of the parameters. Default 1e-8.
    pub parameter_tolerance: f64,
    /// Radius of the first step; large is close to Gauss–Newton. Default 1e4.
    pub initial_trust_region_radius: f64,
    /// The radius never grows beyond this. Default 1e16.
    pub max_trust_region_radius: f64,
    /// Stops when the radius has shrunk to this. Default 1e-32.
    pub min_trust_region_radius: f64,
    /// A step is kept when the cost falls by more than this fraction of what the linear model promised.
    /// Default 1e-3.
    pub min_relative_decrease: f64,
    /// Stops after this many steps in a row that could not be computed. Default 5.
    pub max_num_consecutive_invalid_steps: u32,
    /// Bounds of the damped diagonal (of the column-scaled normal matrix). Defaults 1e-6 and 1e32.
    pub lm_diagonal_bounds: (f64, f64),
}

impl Default for SolverOptions {
    fn default() -> Self {
        Self {
            max_num_iterations: 50,
            use_nonmonotonic_steps: false,
            function_tolerance: 1e-6,
            gradient_tolerance: 1e-10,
            parameter_tolerance: 1e-8,
            initial_trust_region_radius: 1e4,
            max_trust_region_radius: 1e16,
            min_trust_region_radius: 1e-32,
            min_relative_decrease: 1e-3,
            max_num_consecutive_invalid_steps: 5,
            lm_diagonal_bounds: (1e-6, 1e32),
        }
    }
}

/// Why the solver stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The cost hardly changes any more.
    FunctionTolerance,
    /// The gradient vanishes.
    GradientTolerance,
    /// The parameters hardly change any more.
    ParameterTolerance,
    /// The trust region vanished: no direction lowers the cost.
    TrustRegionTooSmall,
    /// `max_num_iterations` steps were tried.
    MaxIterations,
    /// The caller asked to stop.
    Cancelled,
    /// Too many steps in a row could not be computed: the normal equations stay singular.
    InvalidSteps,
    /// The problem could not be evaluated where it had to be (cost or derivatives not finite).
    EvaluationFailed,
}

impl Termination {
    /// Whether a minimum was reached as far as the tolerances can tell.
    pub fn is_convergence(self) -> bool {
        use Termination::*;
        matches!(self, FunctionTolerance | GradientTolerance | ParameterTolerance | TrustRegionTooSmall)
    }

    /// Whether the result is at least usable: not worse than the start, and not for lack of evaluation.
    pub fn is_usable(self) -> bool {
        !matches!(self, Self::InvalidSteps | Self::EvaluationFailed)
    }
}

/// What the solver did. Costs are `½ Σ ρ(‖r‖²)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Cost of the state given; NaN if it could not be evaluated.
    pub initial_cost: f64,
    /// Cost of the state returned.
    pub final_cost: f64,
    /// Steps tried.
    pub iterations: u32,
    /// Steps that were kept.
    pub successful_steps: u32,
    /// Why it stopped.
    pub termination: Termination,
}

/// One step of the linearised problem.
pub(crate) struct Step {
    /// Decrease of the cost promised by the linear model; positive.
    pub model_cost_change: f64,
    /// Norm of the change of the parameters.
    pub norm: f64,
}

/// What the loop needs from a problem. A current state is always linearised; a candidate is only
/// evaluated.
pub(crate) trait Linearized {
    /// Largest absolute component of the gradient at the current state.
    fn gradient_max_norm(&self) -> f64;
    /// Norm of the current parameters.
    fn parameter_norm(&self) -> f64;
    /// Solves the normal equations damped for this radius and forms the candidate; `None` when they
    /// cannot be solved or the model promises no decrease.
    fn compute_step(&mut self, radius: f64, options: &SolverOptions) -> Option<Step>;
    /// Cost of the candidate; `None` when it cannot be evaluated.
    fn evaluate_candidate(&mut self) -> Option<f64>;
    /// Makes the candidate current and linearises there; false when it cannot be evaluated.
    fn accept_candidate(&mut self) -> bool;
    /// Remembers the current state as the best one.
    fn keep_as_best(&mut self);
    /// Called after every iteration with what is known so far; false asks to stop.
    fn report(&mut self, _progress: &Progress) -> bool {
        true
    }
}

/// The state of the loop after one iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Steps tried so far.
    pub iteration: u32,
    /// Cost of the current state.
    pub cost: f64,
    /// Largest absolute component of the gradient.
    pub gradient_max_norm: f64,
    /// Radius of the next step.
    pub trust_region_radius: f64,
    /// Whether the step just tried was kept.
    pub step_is_successful: bool,
}

/// Minimises from a linearised start with cost `initial_cost`. The best state is in the problem's own
/// keeping.
pub(crate) fn minimize(problem: &mut impl Linearized, initial_cost: f64, options: &SolverOptions) -> Summary {
    let mut radius = options.initial_trust_region_radius;
    let mut decrease_factor = 2.0;
    let mut invalid_steps = 0;
    let mut quality = StepQuality::new(initial_cost, options.use_nonmonotonic_steps);
    let mut summary = Summary {
        initial_cost,
        final_cost: initial_cost,
        iterations: 0,
        successful_steps: 0,
        termination: Termination::MaxIterations,
    };
    let mut cost = initial_cost;
    let mut step_is_successful = true;
    problem.keep_as_best();
    loop {
        let gradient_max_norm = problem.gradient_max_norm();
        let progress = Progress {
            iteration: summary.iterations,
            cost,
            gradient_max_norm,
            trust_region_radius: radius,
            step_is_successful,
        };
        summary.termination = if !problem.report(&progress) {
            Termination::Cancelled
        } else if summary.iterations >= options.max_num_iterations {
            Termination::MaxIterations
        } else if step_is_successful && gradient_max_norm <= options.gradient_tolerance {
            Termination::GradientTolerance
        } else if radius <= options.min_trust_region_radius {
            Termination::TrustRegionTooSmall
        } else {
            summary.iterations += 1;
            step_is_successful = false;
            let Some(step) = problem.compute_step(radius, options) else {
                invalid_steps += 1;
                if invalid_steps >= options.max_num_consecutive_invalid_steps {
                    summary.termination = Termination::InvalidSteps;
                    return summary;
                }
                radius /= decrease_factor;
                decrease_factor *= 2.0;
                continue;
            };
            invalid_steps = 0;
            let candidate_cost = problem.evaluate_candidate().filter(|c| c.is_finite());
            let tolerance = options.parameter_tolerance;
            if step.norm <= tolerance * (problem.parameter_norm() + tolerance) {
                summary.termination = Termination::ParameterTolerance;
                return summary;
            }
            if candidate_cost.is_some_and(|c| (cost - c).abs() <= options.function_tolerance * cost) {
                summary.termination = Termination::FunctionTolerance;
                return summary;
            }
            let ratio = candidate_cost.map(|c| (c, quality.of(c, step.model_cost_change)));
            match ratio {
                Some((candidate_cost, ratio)) if ratio > options.min_relative_decrease => {
                    if !problem.accept_candidate() {
                        summary.termination = Termination::EvaluationFailed;
                        return summary;
                    }
                    cost = candidate_cost;
                    quality.accept(cost, step.model_cost_change);
                    step_is_successful = true;
                    summary.successful_steps += 1;
                    if cost < summary.final_cost {
                        summary.final_cost = cost;
                        problem.keep_as_best();
                    }
                    let shrink = (1.0 - (2.0 * ratio - 1.0).powi(3)).max(1.0 / 3.0);
                    radius = (radius / shrink).min(options.max_trust_region_radius);
                    decrease_factor = 2.0;
                }
                _ => {
                    radius /= decrease_factor;
                    decrease_factor *= 2.0;
                }
            }
            continue;
        };
        return summary;
    }
}
