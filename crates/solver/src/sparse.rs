//! Block-sparse nonlinear least squares.

mod block_pattern;
mod block_system;
mod factor;
mod jacobian_check;
mod linearization;
mod manifold;
mod problem;
mod products;
mod solve;

pub use factor::{Factor, MAX_FACTOR_VARIABLES};
pub use jacobian_check::jacobian_error;
pub use manifold::{Manifold, RotationFreedom, TranslationFreedom};
pub use problem::{FactorId, Problem, ProblemError, VariableId};
