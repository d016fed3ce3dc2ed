//! How the robot moves: a smooth walk whose pose, velocity and acceleration are known exactly.

mod builder;
mod graph;
mod smooth;
mod tour;
mod turn;
mod walk;

use portolan_geometry::{Rigid3, Vector3};

pub use builder::{MotionLimits, Waypoint};
pub(crate) use tour::{TourRequest, plan_people, plan_tour};
pub use walk::{PlanarState, Walk};

/// Everything an inertial sensor could feel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionState {
    /// Pose of `base_link` in the map.
    pub map_from_base: Rigid3,
    /// m/s.
    pub velocity_in_map: Vector3,
    /// m/s², without gravity.
    pub acceleration_in_map: Vector3,
    /// rad/s.
    pub angular_velocity_in_base: Vector3,
    /// rad/s².
    pub angular_acceleration_in_base: Vector3,
}

/// A motion with exact derivatives, from time 0 to its duration; at rest outside.
pub trait Motion: Send + Sync {
    /// Seconds.
    fn duration(&self) -> f64;

    /// Pose and derivatives at `time` seconds.
    fn state(&self, time: f64) -> MotionState;
}
