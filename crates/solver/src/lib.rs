//! Least squares: small dense problems and block-sparse pose problems, with robust losses.
//!
//! Both kinds of problem are minimised by one trust-region loop ([`SolverOptions`], [`Summary`]) with the
//! Levenberg–Marquardt rules of Ceres, on which the results of lidar mapping configurations depend.
//! - [`solve_dense`]: one to eight parameters, fixed-size matrices, no allocation. For scan matching.

mod dense;
mod trust_region;

pub use dense::{DenseProblem, NormalEquations, solve_dense};
pub use trust_region::{SolverOptions, Summary, Termination};
