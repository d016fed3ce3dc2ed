#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod growing;
mod kept_scan_2d;
mod sampling_density;
mod scan_matching_2d;
mod scan_matching_3d;
mod search_window;
mod submap_2d;
mod submap_3d;

pub use growing::GrowingSubmap;
pub use kept_scan_2d::KeptScan2d;
pub use scan_matching_2d::{
    ScanMatch2d, ScanMatcher2d, Searched, fast_matcher_options, gradient_matcher, search_after_gap,
};
pub use scan_matching_3d::{ScanMatcher3d, clouds_in_grids, fast_matcher_options_3d, gradient_matcher_3d};
pub use search_window::SearchWindow;
pub use submap_2d::{Inserter2d, Submap2d};
pub use submap_3d::{ExplainedByPlanes, Inserter3d, MadePlanes, Scan3d, Submap3d};
