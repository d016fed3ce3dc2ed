//! Factors for poses in 2D and in 3D, all with analytic Jacobians.
//!
//! Weighted pairs ([`Se2Between`], [`Se3Between`]) follow sparse pose adjustment (Konolige et al., 2010) as
//! Cartographer uses it; pairs with a full information matrix ([`Se2BetweenInformation`],
//! [`Se3BetweenInformation`]) follow the g2o file convention.

mod imu;
mod information;
mod interpolation;
mod landmark;
mod prior;
mod rotation;
mod se2_between;
mod se3_between;
mod se3_information;

pub use imu::{ImuAcceleration, ImuRotation};
pub use information::square_root_information;
pub use landmark::{Landmark2d, Landmark3d};
pub use prior::{EuclideanPrior, RotationPrior, Se2Prior, Se3Prior};
pub use se2_between::{Se2Between, Se2BetweenInformation};
pub use se3_between::Se3Between;
pub use se3_information::{Se3BetweenInformation, Se3ErrorConvention};
