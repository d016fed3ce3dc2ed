//! Matches scans by search: finds the best of all placements of a scan within a window, without looking at
//! most of them.
//!
//! All searches share one idea. Scans rotated by neighbouring angles put each point into nearly the same
//! cell, and the best value in a window of cells bounds the value in each of them. So a bound of the score of
//! a whole box of placements (some angles × some shifts) costs as much as the score of one placement. Boxes
//! are split eightfold as long as their bound is not below the best score found.

mod best_first;
mod bucket_queue;
mod byte_score;
mod joint_search;
mod max_pyramid;
mod rotated_scans;
mod search_window;

mod fast_2d;
mod fast_3d;
mod joint_cloud;
mod place_grid;
mod place_index;
mod real_time_2d;
mod real_time_3d;
mod rotational;

pub use fast_2d::{FastCorrelativeMatcher2d, FastCorrelativeOptions2d, SeveralPlaces};
pub use fast_3d::{
    FastCorrelativeMatcher3d, FastCorrelativeOptions3d, FastMatch3d, NodeToFind, SearchReach3d,
    SubmapToSearch, judge_placement_3d,
};
pub use joint_cloud::joint_cloud_2d;
pub use place_index::{FoundPlaces2d, PlaceIndex2d, WantedPlaces};
pub use real_time_2d::{RealTimeCorrelativeMatcher2d, RealTimeCorrelativeOptions};
pub use real_time_3d::RealTimeCorrelativeMatcher3d;
pub use rotational::{histogram_similarity, rotate_histogram, rotational_histogram};

/// Result of a correlative matcher.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchResult<Pose> {
    /// Score of the match, between 0 and 1; its meaning depends on the matcher.
    pub score: f32,
    /// The pose of the scan in the frame of the grid.
    pub pose: Pose,
}
