#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod backend;
mod collation;
mod constraint;
mod histogram;
mod id;
mod latency;
mod local_slam;
mod local_track;
#[cfg(test)]
mod made_rooms;
mod map;
mod mapper;
mod node;
mod open_directions;
mod optimization;
mod place_finder_2d;
mod planar;
mod planar_scan;
mod plane_search;
mod pose_graph;
mod remembered;
mod sampling_density;
mod scan_matching_2d;
mod scan_matching_3d;
mod space;
mod spatial;
mod submap_2d;
mod submap_3d;

pub use backend::{BackendProgress, MapperError};
pub use collation::{Ready, SensorCollation};
pub use constraint::{Constraint, ConstraintTag};
pub use id::{IndexedId, NodeId, SubmapId, TrajectoryId, of_trajectory};
pub use latency::LatencyHistogram;
pub use local_slam::{ActiveSubmaps, GrowingSubmap, LocalSlam, Lost, MatchingResult};
pub use local_track::{LocalTrack, Placement, TrackedNode};
pub use map::{Map, ScanPose};
pub use mapper::{EndedTrajectory, Loss, Mapper, MapperSettings};
pub use node::{Node, NodeData};
pub use open_directions::OpenDirections;
pub use optimization::{
    ImuState, LandmarkNode, LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary,
    TrajectorySensors, optimize_2d, optimize_3d,
};
pub use planar::Planar;
pub use planar_scan::PlanarScan;
pub use portolan_lidar_odometry::{DegenerateInterval, DegenerateMotion, Substitute, SweepPoint};
pub use portolan_motion::{
    ExtrapolatorCounts, ExtrapolatorError, ImuMotion, MotionFilter, PoseExtrapolator, integrate_imu,
};
pub use pose_graph::{
    CellFate, Coverage, Extension, GraphState, InitialTrajectoryPose, InsertedNode, InsertionSubmap,
    LoopSearchPolicy, PoseGraph, PoseGraphPolicy, Replacement, SearchCounts, SelfConsistency, SubmapEntry,
    TrajectoryConnectivity, TrajectoryEntry, TrajectoryState, TrimmedNode, TrimmedTies, Trimmer,
};
pub use space::{MatchAcceptance, MatchedPose, Nearby, PlaceFinder, SearchRegion, SearchWindow, Space};
pub use spatial::{Spatial, SpatialMatcher};
pub use submap_2d::{Inserter2d, Submap2d};
pub use submap_3d::{Inserter3d, Scan3d, Submap3d};
