//! Options of the solver: stopping criteria and step size.

/// Stopping criteria and step size. The defaults are those of Ceres.
#[derive(Clone, Debug, PartialEq)]
pub struct SolverOptions {
    /// Maximum number of steps tried, whether accepted or not. Default 50.
    pub max_num_iterations: u32,
    /// Whether the cost may rise for up to five steps in a row if it falls in the long run; helps in curved
    /// valleys. The best state is returned. Default false.
    pub use_nonmonotonic_steps: bool,
    /// Relative change of the cost at which the solver stops. Default 1e-6.
    pub function_tolerance: f64,
    /// Largest absolute component of the gradient at which the solver stops. Default 1e-10.
    pub gradient_tolerance: f64,
    /// Norm of a step, relative to the norm of the parameters, at which the solver stops. Default 1e-8.
    pub parameter_tolerance: f64,
    /// Radius of the first step. Default 1e4. Large values are close to Gauss–Newton: pose graphs with fairly
    /// good initial poses need about half the iterations with 1e8 (measured with the example
    /// `optimize_submaps`).
    pub initial_trust_region_radius: f64,
    /// Maximum radius. Default 1e16.
    pub max_trust_region_radius: f64,
    /// Radius at which the solver stops. Default 1e-32.
    pub min_trust_region_radius: f64,
    /// Minimum decrease of the cost for a step to be accepted, as a fraction of the decrease predicted by the
    /// linear model. Default 1e-3.
    pub min_relative_decrease: f64,
    /// Number of successive steps that could not be computed at which the solver stops. Default 5.
    pub max_num_consecutive_invalid_steps: u32,
    /// Bounds of the damping diagonal (of the column-scaled normal matrix). Defaults 1e-6 and 1e32.
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
