#![doc = include_str!("../README.md")]

pub mod assets;
pub mod automatic;
pub mod job;
mod known_places;
mod losses;
pub mod pipeline;
#[cfg(doctest)]
mod readmes;
mod requested;
mod silence;
mod soundness;
pub mod trajectory_file;
mod unusable_scans;

pub use automatic::{Lidar, Sensors, settings_for};
pub use known_places::KnownMapSpace;
pub use requested::{LIFELONG, RequestedOptions};
pub use unusable_scans::{ScanTally, UnusableScans};

pub use portolan_atomic_file as atomic_file;
pub use portolan_bunzip2 as bunzip2;
pub use portolan_clocks as clocks;
pub use portolan_config as config;
pub use portolan_diagnose as diagnose;
pub use portolan_evaluation as evaluation;
pub use portolan_export as export;
pub use portolan_geometry as geometry;
pub use portolan_grids as grids;
pub use portolan_ingest as ingest;
pub use portolan_issue as issue;
pub use portolan_lidar_odometry as lidar_odometry;
pub use portolan_lidar_packets as lidar_packets;
pub use portolan_local_slam as local_slam;
pub use portolan_localization as localization;
pub use portolan_mapfile as mapfile;
pub use portolan_mapping as mapping;
pub use portolan_matching as matching;
pub use portolan_motion as motion;
pub use portolan_numeric as numeric;
pub use portolan_optimization as optimization;
pub use portolan_pbstream as pbstream;
pub use portolan_pointcloud as pointcloud;
pub use portolan_recording as recording;
pub use portolan_refinement as refinement;
pub use portolan_registration as registration;
pub use portolan_reprojection as reprojection;
pub use portolan_ros_messages as ros_messages;
pub use portolan_sensor as sensor;
pub use portolan_simulator as simulator;
pub use portolan_solver as solver;
pub use portolan_submaps as submaps;
pub use portolan_worlds as worlds;
