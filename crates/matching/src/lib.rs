#![doc = include_str!("../README.md")]

pub mod correlative;
mod error;
pub mod gradient;
mod surface;
mod transform_2d;

#[cfg(test)]
extern crate self as portolan_matching;
#[cfg(test)]
#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod testing;

pub use correlative::{
    FastCorrelativeMatcher2d, FastCorrelativeMatcher3d, FastCorrelativeOptions2d, FastCorrelativeOptions3d,
    FastMatch3d, FoundPlaces2d, MatchResult, NodeToFind, PlaceIndex2d, RealTimeCorrelativeMatcher2d,
    RealTimeCorrelativeMatcher3d, RealTimeCorrelativeOptions, SearchReach3d, SeveralPlaces, SubmapToSearch,
    WantedPlaces, histogram_similarity, joint_cloud_2d, judge_placement_3d, rotate_histogram,
    rotational_histogram,
};
pub use error::MatcherOptionError;
pub use gradient::{
    CloudInGrid, GradientMatch2d, GradientMatch3d, GradientMatcher2d, GradientMatcher3d,
    GradientMatcherOptions2d, GradientMatcherOptions3d, IntensityCostOptions,
};
pub use surface::surface_tangents;
pub use transform_2d::Transform2d;
