//! Matching by least squares: from a good guess down to fractions of a cell.

mod bicubic;
mod matcher2d;
mod matcher3d;
mod occupied_space2d;
mod scan_residuals3d;
mod signed_distance2d;
mod smooth_grid3d;

pub use matcher2d::{GradientMatch2d, GradientMatcher2d, GradientMatcherOptions2d};
pub use matcher3d::{
    CloudInGrid, GradientMatch3d, GradientMatcher3d, GradientMatcherOptions3d, IntensityCostOptions,
};
