//! The start of a trajectory in space: when enough is known of the IMU, or that there is none.

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::{Duration, Rigid3, Time};
use portolan_sensor::ImuData;

use super::LocalSlam3d;
use super::upright::mean_acceleration;
use crate::local_slam::two_d::first_point_time;
use crate::scan_matching_3d::ScanMatcher3d;

/// Range data wait this long for the first IMU sample before it is decided that there is no IMU.
const IMU_WAIT: Duration = Duration::from_ticks(10_000_000);

/// Accelerations are averaged over this before matching to surfaces starts: about two steps of who carries it.
const LEVELING_TIME: Duration = Duration::from_ticks(10_000_000);
/// So many samples are averaged at most.
const MOST_LEVELING_SAMPLES: usize = 4000;

impl LocalSlam3d {
    /// Starts predicting, at the first IMU sample that waits, upright as all of them together say, or
    /// without one, level at the first scan.
    pub(super) fn start(&mut self) {
        let waiting = std::mem::take(&mut self.waiting_imu);
        let mut extrapolator = match (waiting.first(), mean_acceleration(&waiting)) {
            (Some(first), Some(linear_acceleration)) => {
                let first = ImuData { linear_acceleration, ..*first };
                let Ok(started) = self.new_extrapolator().started_at_rest(&first) else { return };
                started
            }
            _ => {
                let Some(first) = self.waiting_ranges.front() else { return };
                let mut level = self.new_extrapolator();
                level.add_pose(first_point_time(first), Rigid3::identity());
                level
            }
        };
        for odometry in self.waiting_odometry.drain(..) {
            let _ = extrapolator.add_odometry(&odometry);
        }
        self.has_imu = !waiting.is_empty();
        if !self.has_imu
            && let Ok(matcher) = ScanMatcher3d::new(&without_imu(&self.options))
        {
            self.matcher = matcher;
        }
        self.extrapolator = Some(extrapolator);
        if let Some(first) = waiting.first() {
            self.upright.add_imu(first);
            self.inertial.add_imu(first);
        }
        waiting.iter().skip(1).for_each(|data| self.follow_imu(data));
    }

    /// Starts if enough is known, or if too little comes to wait for more.
    pub(super) fn start_if_ready(&mut self) {
        let span = |first: Option<Time>, last: Option<Time>| match (first, last) {
            (Some(first), Some(last)) => last - first,
            _ => Duration::ZERO,
        };
        let ranges = &self.waiting_ranges;
        let waited = span(ranges.front().map(|r| r.time), ranges.back().map(|r| r.time));
        let imu = &self.waiting_imu;
        let averaged = span(imu.first().map(|d| d.time), imu.last().map(|d| d.time));
        let leveling = if self.by_surfaces.is_some() { LEVELING_TIME } else { Duration::ZERO };
        let is_ready = match imu.len() {
            0 => waited >= IMU_WAIT,
            count => averaged >= leveling || count >= MOST_LEVELING_SAMPLES || waited >= IMU_WAIT + leveling,
        };
        if is_ready {
            self.start();
        }
    }
}

/// The options for matching when no gyroscope makes predictions that are worth much: the weights of staying
/// at the predicted pose are a tenth for translation and a hundredth for rotation. On a walk of 87 m round a
/// corridor (`corridor_imu` without its IMU, grids of 10 cm) the error of the map is 13 m with the weights as
/// they are, 0.36 m with these, and 0.11 m when scans are straightened, too.
fn without_imu(options: &TrajectoryBuilder3dOptions) -> TrajectoryBuilder3dOptions {
    let mut options = options.clone();
    options.ceres_scan_matcher.translation_weight *= 0.1;
    options.ceres_scan_matcher.rotation_weight *= 0.01;
    options
}
