//! Block-sparse nonlinear least squares.

mod block_pattern;
mod block_system;
mod cholesky;
mod condition;
mod covariance;
mod elimination_order;
mod factor;
mod factor_view;
mod fill;
mod jacobian_check;
mod linearization;
mod manifold;
mod minimum_degree;
mod normal_blocks;
mod panel;
mod problem;
mod products;
mod solve;
mod supernodes;

pub(crate) use block_system::BlockSystem;
pub use covariance::Covariance;
pub use factor::{Factor, MAX_FACTOR_VARIABLES};
pub use jacobian_check::jacobian_error;
pub use manifold::{Manifold, RotationFreedom, TranslationFreedom};
pub use normal_blocks::NormalBlocks;
pub(crate) use problem::se3_values;
pub use problem::{FactorId, Problem, ProblemError, VariableId};
pub(crate) use solve::Prepared;
