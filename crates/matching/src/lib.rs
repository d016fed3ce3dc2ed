//! Grids and scan matching: probability grids, TSDF, correlative and gradient matchers.
//!
//! - [`grid`]: what a submap is drawn on, how range data are drawn into it and how it looks.
//! - [`correlative`]: matching by search, near a guess or over a whole submap.
//! - [`gradient`]: matching by least squares, down to fractions of a cell.
//!
//! Everything here is a plain function of its arguments: no clocks, no randomness, no threads of its
//! own, no interior mutability. Matchers are `Send + Sync` and may be shared by any number of threads.

pub mod correlative;
mod error;
pub mod gradient;
pub mod grid;
mod planar_transform;
mod surface;
mod voxel_order;

#[cfg(test)]
extern crate self as portolan_matching;
#[cfg(test)]
#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod testing;

pub use correlative::{
    FastCorrelativeMatcher2d, FastCorrelativeMatcher3d, FastCorrelativeOptions2d, FastCorrelativeOptions3d,
    FastMatch3d, MatchResult, NodeToFind, RealTimeCorrelativeMatcher2d, RealTimeCorrelativeMatcher3d,
    RealTimeCorrelativeOptions, SearchReach3d, SeveralPlaces, SubmapToSearch, histogram_similarity,
    judge_placement_3d, rotate_histogram, rotational_histogram,
};
pub use error::MatcherOptionError;
pub use gradient::{
    CloudInGrid, GradientMatch2d, GradientMatch3d, GradientMatcher2d, GradientMatcher3d,
    GradientMatcherOptions2d, GradientMatcherOptions3d, IntensityCostOptions,
};
pub use grid::{
    CellBox, CellIndex, Grid2d, GridError, GridParts, GridRepairs, HybridGrid, HybridGridParts,
    HybridGridRepairs, HybridInserter, HybridInserterOptions, InsertReport, IntensityGrid, MapLimits,
    NormalEstimationOptions, ProbabilityGrid, ProbabilityInserter, ProbabilityInserterOptions, ScanAgreement,
    Texture, Tsdf2d, TsdfInserter, TsdfInserterOptions, TsdfParts, mean_of_solid_cells, scan_agreement,
    score_difference,
};
pub use planar_transform::PlanarTransform;
pub use surface::surface_tangents;
