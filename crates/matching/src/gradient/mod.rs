//! Matching by least squares: from a good guess down to fractions of a cell.

mod bicubic;
mod matcher2d;
mod occupied_space2d;
mod signed_distance2d;

pub use matcher2d::{GradientMatch2d, GradientMatcher2d, GradientMatcherOptions2d};
