#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod backend;
mod collation;
mod from_above;
mod histogram;
mod local_track;
mod made_planes;
#[cfg(test)]
mod made_rooms;
mod map;
mod mapper;
mod node;
mod place_finder_2d;
mod place_finder_3d;
mod plane_search;
mod pose_graph;
mod remembered;
mod space;
mod space_2d;
mod space_3d;
mod stop;

pub use backend::{BackendProgress, MapperError};
pub use collation::{Ready, SensorCollation};
pub use from_above::{FromAboveError, SeenFromAbove, columns_of_scans};
pub use local_track::{LocalTrack, Placement, TrackedNode};
pub use map::{Map, ScanPose};
pub use mapper::{EndedTrajectory, Loss, Mapper, MapperSettings, MapperWork};
pub use node::Node;
pub use portolan_lidar_odometry::SweepPoint;
/// Types that local SLAM passes to the pose graph.
pub use portolan_local_slam::{
    ActiveSubmaps, GatheredVariance, InsertedNode, InsertionSubmap, LocalSlam, LocalSlamSpace, Lost,
    MatchAcceptance, MatchingResult, NodeData, OdometryBridge, Space2d, Space3d,
};
pub use portolan_motion::{
    DegenerateInterval, DegenerateMotion, ExtrapolatorCounts, ExtrapolatorError, ImuMotion, MotionFilter,
    PoseExtrapolator, Substitute, integrate_imu,
};
/// Types of a map: ids and constraints.
pub use portolan_optimization::{
    Constraint, ConstraintTag, IndexedId, NodeId, OpenShift, SubmapId, TrajectoryId, of_trajectory,
};
pub use pose_graph::{
    CellFate, Consistency, Coverage, Drift, Extension, FoundPlace, GraphState, InitialTrajectoryPose,
    LoopSearchPolicy, PoseGraph, PoseGraphPolicy, Replacement, SearchCounts, SubmapEntry, TrajectoryEntry,
    TrajectoryState, TrimmedNode, TrimmedNodes, TrimmedTies, Trimmer, VoxelFate,
};
pub use space::{MatchedPose, Nearby, PlaceFinder, ProposedPlaces, SearchRegion, Space, SubmapInMap};
pub use space_3d::SubmapMatcher3d;
