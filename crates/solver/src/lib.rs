//! Least squares: small dense problems and block-sparse pose problems, with robust losses.
//!
//! Both kinds of problem are minimised by one trust-region loop ([`SolverOptions`], [`Summary`]) with the
//! Levenberg–Marquardt rules of Ceres, on which the results of lidar mapping configurations depend.
//! - [`solve_dense`]: one to eight parameters, fixed-size matrices, no allocation. For scan matching.
//! - [`Problem`]: many variables on manifolds, [`factors`] between a few of them each, sparse Cholesky
//!   factorisation. For pose graphs.
//! - [`g2o`]: pose graphs from files, with initial values, optimised and judged.

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
