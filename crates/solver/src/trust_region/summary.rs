//! Summary of a run of the solver.

/// Why the solver stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The relative change of the cost is below its tolerance.
    FunctionTolerance,
    /// The gradient is below its tolerance.
    GradientTolerance,
    /// The relative change of the parameters is below its tolerance.
    ParameterTolerance,
    /// The trust region vanished: no direction lowers the cost.
    TrustRegionTooSmall,
    /// `max_num_iterations` steps were tried.
    MaxIterations,
    /// The caller stopped the solver.
    Cancelled,
    /// Too many steps in a row could not be computed: the normal equations stay singular.
    InvalidSteps,
    /// The problem could not be evaluated where this was required (cost or derivatives not finite).
    EvaluationFailed,
}

impl std::fmt::Display for Termination {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::FunctionTolerance => "the cost hardly changes any more",
            Self::GradientTolerance => "the gradient vanishes",
            Self::ParameterTolerance => "the poses hardly change any more",
            Self::TrustRegionTooSmall => "no direction lowers the cost",
            Self::MaxIterations => "stopped at the limit: not converged",
            Self::Cancelled => "interrupted",
            Self::InvalidSteps => "failed: the normal equations stay singular",
            Self::EvaluationFailed => "failed: the cost is not finite",
        })
    }
}

impl Termination {
    /// Whether a minimum was reached within the tolerances.
    pub fn is_convergence(self) -> bool {
        use Termination::*;
        matches!(self, FunctionTolerance | GradientTolerance | ParameterTolerance | TrustRegionTooSmall)
    }

    /// Whether the result is usable: not worse than the start, and no failure to evaluate or to compute
    /// steps.
    pub fn is_usable(self) -> bool {
        !matches!(self, Self::InvalidSteps | Self::EvaluationFailed)
    }
}

/// Summary of a run. Costs are `½ Σ ρ(‖r‖²)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Cost of the initial state; NaN if it could not be evaluated.
    pub initial_cost: f64,
    /// Cost of the returned state.
    pub final_cost: f64,
    /// Number of steps tried.
    pub iterations: u32,
    /// Number of steps accepted.
    pub successful_steps: u32,
    /// Why the solver stopped.
    pub termination: Termination,
}

/// The state of the loop after one iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Number of steps tried so far.
    pub iteration: u32,
    /// Cost of the current state.
    pub cost: f64,
    /// Largest absolute component of the gradient.
    pub gradient_max_norm: f64,
    /// Radius of the next step.
    pub trust_region_radius: f64,
    /// Whether the last step was accepted.
    pub step_is_successful: bool,
}
