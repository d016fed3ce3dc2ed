#![doc = include_str!("../README.md")]

mod belief;
mod correlation;
mod degenerate_intervals;
mod deskew;
mod gap;
mod gravity_initialisation;
mod gyroscope;
mod hypotheses;
mod inertial;
mod initialise;
mod innovations;
mod issues;
mod keyframes;
mod later;
mod local_map;
mod motion_state;
mod occlusion;
mod odometry;
mod odometry_prior;
mod phase;
mod pieces;
mod plane_fit;
mod plane_map;
mod poles;
mod predict;
mod registration;
mod remembered;
mod segment;
pub mod settings;
mod shift_likelihood;
mod sight;
mod standstill;
mod start;
mod start_velocity;
mod sweep;
mod sweep_registration;
#[cfg(test)]
mod testing;
mod tracker;
mod two_threads;
mod vertical;
mod voxel_tree;
mod wide_search;
mod witness;

pub use degenerate_intervals::{
    DegenerateInterval, DegenerateIntervals, DegenerateMotion, DegenerateScan, Substitute,
};
pub use deskew::PiecewiseLinearTrajectory;
pub use gravity_initialisation::{Beginning, GravityInitialisation, WaitingSweeps};
pub use gyroscope::SaturationDetector;
pub use issues::{Issue, Issues};
pub use later::Later;
pub use local_map::GrowingMap;
pub use odometry::{LidarOdometry, SweepError};
pub use phase::Phase;
pub use pieces::PieceBegun;
pub use plane_map::{Plane, PlaneMap, Unreliable};
pub use poles::{PoleMap, PolePoint};
pub use registration::{
    DegenerateDirections, MotionPrior, PosePrior, Registration, RegistrationResult, Sigmas,
};
pub use segment::{MotionSource, SegmentCorrection, TrajectorySegment};
pub use settings::{OdometrySettings, RegistrationSettings};
pub use sweep::{Sweep, SweepPoint};
pub use tracker::{Fallback, Keyframe, Observability, RegisteredSweep};
pub use two_threads::{both, is_worth_a_thread};
