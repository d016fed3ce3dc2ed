#![doc = include_str!("../README.md")]

mod absolute;
mod alignment;
mod association;
pub mod cloud;
mod error;
mod formats;
mod histogram;
mod relations;
mod relative;
mod statistics;
mod trajectory;

pub use absolute::{AbsoluteErrors, absolute_errors};
pub use alignment::{Alignment, align};
pub use association::{Association, PosePair, associate};
pub use error::EvaluationError;
pub use formats::{
    kitti_trajectory, read_csv, read_geojson, read_kitti_poses, read_kitti_times, read_tum, write_csv,
    write_csv_all, write_geojson, write_kitti, write_tum,
};
pub use histogram::Histogram;
pub use relations::{
    GenerateOptions, GeneratedRelations, IdInMap, MapConstraint, MapGraph, RIGHT_WITHIN, Relation,
    RelationError, RelationReport, TimeBaseNotice, at_times_of, generate_relations, in_time_base,
    loop_closure_relations, read_binary_relations, read_relations, read_text_relations, relation_errors,
    write_binary_relations, write_text_relations,
};
pub use relative::{
    Drift, KITTI_LENGTHS, KITTI_STRIDE, RelativeErrors, SegmentErrors, Step, drift, relative_errors,
};
pub use statistics::{ErrorStatistics, MeanDeviation};
pub use trajectory::{TimedPose, Trajectory, TrajectoryRepairs};

use portolan_geometry::Rigid3;

/// The rotation of a pose as x, y, z, w with w ≥ 0, so that equal rotations print equal.
fn quaternion_xyzw(pose: &Rigid3) -> [f64; 4] {
    let q = pose.rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [q.i, q.j, q.k, q.w].map(|v| sign * v)
}
