//! Motion of the robot: a smooth walk whose pose, velocity and acceleration are known exactly.

mod builder;
mod gait;
mod graph;
mod itinerary;
mod smooth;
mod spline;
mod tour;
mod turn;
mod walk;

use portolan_geometry::{Rigid3, Vector3};

pub use builder::{MotionLimits, Waypoint};
pub use gait::Carrier;
pub(crate) use gait::motion_along;
pub(crate) use itinerary::{Itinerary, ItineraryRequest};
pub use spline::SplineMotion;
pub(crate) use spline::rotation;
pub(crate) use tour::{TourRequest, plan_people, plan_tour};
pub use walk::{MotionState2d, Walk};

/// Pose, velocities and accelerations: all that an inertial sensor could measure.
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
    /// Duration, seconds.
    fn duration(&self) -> f64;

    /// Pose and derivatives at `time` seconds.
    fn state(&self, time: f64) -> MotionState;
}

/// Motion as wheels measure it.
pub(crate) trait Rolling: Send + Sync {
    /// Distance travelled, metres, and heading, radians (unwrapped), at `time` seconds.
    fn rolled(&self, time: f64) -> (f64, f64);
}
