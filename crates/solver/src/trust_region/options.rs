//! When the solver stops, and how bold its steps are.

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
    /// Radius of the first step. Default 1e4. Large values are close to Gauss–Newton: pose graphs with a fair
    /// start need about half the iterations with 1e8 (measured with the example `optimize_submaps`).
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
