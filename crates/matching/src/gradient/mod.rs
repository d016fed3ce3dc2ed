//! Matches scans by least squares: refines a good guess to fractions of a cell.

mod bicubic;
mod matcher_2d;
mod matcher_3d;
mod occupied_space_2d;
mod scan_residuals_3d;
mod signed_distance_2d;
mod smooth_grid_3d;

pub use matcher_2d::{GradientMatch2d, GradientMatcher2d, GradientMatcherOptions2d};
pub use matcher_3d::{
    CloudInGrid, GradientMatch3d, GradientMatcher3d, GradientMatcherOptions3d, IntensityCostOptions,
};
