//! The public API of Portolan in one crate: every room by its name, and the whole job as one function
//! ([`pipeline::map_recording`]); the map as a cloud ([`unwind`]).

pub mod automatic;
pub mod clocks;
pub mod pipeline;
mod requested;
mod silence;
pub mod unwind;

pub use requested::RequestedOptions;

pub use portolan_config as config;
pub use portolan_evaluation as evaluation;
pub use portolan_export as export;
pub use portolan_geometry as geometry;
pub use portolan_lidar_odometry as lidar_odometry;
pub use portolan_mapfile as mapfile;
pub use portolan_mapping as mapping;
pub use portolan_matching as matching;
pub use portolan_motion as motion;
pub use portolan_pointcloud as pointcloud;
pub use portolan_recording as recording;
pub use portolan_refinement as refinement;
pub use portolan_sensor as sensor;
pub use portolan_simulator as simulator;
pub use portolan_solver as solver;
