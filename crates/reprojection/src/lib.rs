#![doc = include_str!("../README.md")]

mod kept;
mod motion;
#[cfg(test)]
mod tests;

use portolan_geometry::Duration;
use portolan_sensor::TimedPointCloudData;

pub use kept::KeptScans;
pub use motion::SmoothMotion;
use motion::{LONGEST_SWEEP, SweepMotion, place};

/// A point in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    /// Position in the map, metres.
    pub position: [f64; 3],
    /// Intensity as reported by the sensor; 0 if it reports none.
    pub intensity: f32,
    /// Seconds since 1970.
    pub time: f64,
}

/// Numbers of points that were placed and left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Reprojected {
    /// Placed in the map.
    pub points: u64,
    /// Before the first pose of the trajectory, after the last one, or in a gap.
    pub outside_trajectory: u64,
    /// Out of the range limits.
    pub outside_range: u64,
    /// Whether re-projection was stopped before the end.
    pub interrupted: bool,
}

/// Limits of the distance of points from the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeLimits {
    /// Points nearer than this are left out, metres.
    pub min_range: f32,
    /// Points farther than this are left out, metres.
    pub max_range: f32,
}

/// Transforms the points of sweeps into the map, each by the pose at its own time.
pub struct Reprojector<'a> {
    motion: &'a SmoothMotion,
    limits: RangeLimits,
    sweep_motion: SweepMotion,
    points: Vec<MapPoint>,
    reprojected: Reprojected,
}

impl<'a> Reprojector<'a> {
    /// Uses the motion of a finished trajectory.
    pub fn new(motion: &'a SmoothMotion, limits: RangeLimits) -> Self {
        let (points, sweep_motion) = (Vec::new(), SweepMotion::default());
        Self { motion, limits, sweep_motion, points, reprojected: Reprojected::default() }
    }

    /// Counts of all points so far.
    pub fn reprojected(&self) -> Reprojected {
        self.reprojected
    }

    /// Transforms the points of a sweep from the tracking frame into the map. Points without a pose or out of
    /// range are left out and counted.
    pub fn place(&mut self, sweep: &TimedPointCloudData) -> &[MapPoint] {
        self.points.clear();
        let first = f64::from(sweep.points_in_tracking.iter().map(|p| p.time).fold(0.0, f32::min));
        let start = sweep.time + Duration::from_seconds(first);
        let is_short = -first < LONGEST_SWEEP && self.motion.covers(start..=sweep.time);
        if is_short && self.sweep_motion.fill(self.motion, start, sweep.time) {
            let motion = &self.sweep_motion;
            let position = |time: f64, point| Some(motion.to_map(time - first, point));
            place_all(sweep, self.limits, position, &mut self.points, &mut self.reprojected);
        } else {
            let motion = self.motion;
            let position = |time: f64, point| {
                Some(place(&motion.pose(sweep.time + Duration::from_seconds(time))?, point))
            };
            place_all(sweep, self.limits, position, &mut self.points, &mut self.reprojected);
        }
        self.reprojected.points += self.points.len() as u64;
        &self.points
    }
}

fn place_all(
    sweep: &TimedPointCloudData,
    limits: RangeLimits,
    position: impl Fn(f64, [f32; 3]) -> Option<[f64; 3]>,
    points: &mut Vec<MapPoint>,
    reprojected: &mut Reprojected,
) {
    let end = sweep.time.unix_seconds();
    let (least, most) = (limits.min_range.powi(2), limits.max_range.powi(2));
    for (i, point) in sweep.points_in_tracking.iter().enumerate() {
        let range = (point.position - sweep.origin_in_tracking).norm_squared();
        if !(least..=most).contains(&range) {
            reprojected.outside_range += 1;
            continue;
        }
        let time = f64::from(point.time);
        let Some(position) = position(time, point.position.coords.into()) else {
            reprojected.outside_trajectory += 1;
            continue;
        };
        let intensity = sweep.intensities.get(i).copied().unwrap_or(0.0);
        points.push(MapPoint { position, intensity, time: end + time });
    }
}
