//! Collects points from packets into sweeps.

use portolan_geometry::Time;

/// Maximum number of points of a sweep; longer sweeps are cut.
const MAX_POINTS: usize = 1 << 21;

/// One point in the frame of its sensor, with its own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PacketPoint {
    /// Metres.
    pub position: [f64; 3],
    /// Intensity of the return, in the sensor's unit.
    pub intensity: f32,
    /// Number of its beam, counted from the lowest.
    pub ring: u16,
    /// Time of measurement.
    pub time: Time,
}

/// One point of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweepPoint {
    /// In the frame of the sensor, metres.
    pub position: [f32; 3],
    /// Intensity of the return, in the sensor's unit.
    pub intensity: f32,
    /// Number of its beam, counted from the lowest.
    pub ring: u16,
    /// Time since the stamp of the sweep, seconds.
    pub seconds: f32,
}

/// The points of one sweep of a lidar, in the order of measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Time of measurement of the first point.
    pub stamp: Time,
    /// At least one.
    pub points: Vec<SweepPoint>,
}

/// Collects the points of one sweep.
#[derive(Clone, Debug, Default)]
pub struct SweepBuilder {
    stamp: Option<Time>,
    points: Vec<SweepPoint>,
}

impl SweepBuilder {
    /// Adds a point; the first one's time becomes the stamp.
    pub fn push(&mut self, point: &PacketPoint) {
        let stamp = *self.stamp.get_or_insert(point.time);
        self.points.push(SweepPoint {
            position: point.position.map(|v| v as f32),
            intensity: point.intensity,
            ring: point.ring,
            seconds: (point.time - stamp).seconds() as f32,
        });
    }

    /// Whether the maximum number of points is reached.
    pub fn is_full(&self) -> bool {
        self.points.len() >= MAX_POINTS
    }

    /// Time since the first point, seconds.
    pub fn age(&self, now: Time) -> f64 {
        self.stamp.map_or(0.0, |stamp| (now - stamp).seconds())
    }

    /// The sweep, if it has points; the builder is empty afterwards.
    pub fn take(&mut self) -> Option<Sweep> {
        let stamp = self.stamp.take()?;
        let room = Vec::with_capacity(self.points.len());
        Some(Sweep { stamp, points: std::mem::replace(&mut self.points, room) })
    }
}
