#![doc = include_str!("../README.md")]

mod dense;
pub mod factors;
pub mod g2o;
mod loss;
mod sparse;
mod trust_region;

pub use dense::{DenseProblem, NormalEquations, solve_dense};
pub use loss::{Loss, LossValue};
pub use sparse::{
    Covariance, Factor, FactorId, MAX_FACTOR_VARIABLES, Manifold, NormalBlocks, Problem, ProblemError,
    RotationFreedom, TranslationFreedom, VariableId, jacobian_error,
};
pub use trust_region::{Progress, SolverOptions, Summary, Termination};
