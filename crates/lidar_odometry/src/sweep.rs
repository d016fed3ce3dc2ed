//! A sweep: one revolution of a spinning lidar, or as many points as are registered together.

use portolan_geometry::{Point3f, Time};
use portolan_sensor::TimedPoint;

/// A point of a sweep as it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweepPoint {
    /// Seconds from the end of the sweep, not positive.
    pub time: f32,
    /// In the tracking frame at its own time, metres.
    pub position: Point3f,
    /// As the sensor gave it; 0 without.
    pub intensity: f32,
}

impl SweepPoint {
    /// The point without its intensity.
    pub fn timed(&self) -> TimedPoint {
        TimedPoint { position: self.position, time: self.time }
    }
}

/// Points that are registered together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sweep {
    /// Time of the last point.
    pub end: Time,
    /// Raw points.
    pub points: Vec<SweepPoint>,
}

impl Sweep {
    /// Time of the earliest point.
    pub fn begin(&self) -> Time {
        let longest = self.points.iter().map(|p| -p.time).fold(0.0, f32::max);
        self.end - portolan_geometry::Duration::from_seconds(f64::from(longest))
    }
}
