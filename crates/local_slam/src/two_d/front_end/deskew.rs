//! De-skews scans whose motion was not measured, or was measured by odometry that fails.
//!
//! The constant-velocity prediction is off by the acceleration since the previous scan, and distorts a
//! scan that is de-skewed by it. Matching the scan gives the error at its end. The scan is then de-skewed
//! once more with the constant acceleration that explains this error, before the final match. After a gap
//! so long that the velocity is no longer known the scan is taken as it is.

use portolan_geometry::{Quaternion, Rigid2, Rigid3, Time, embed_3d, project_2d, yaw};
use portolan_sensor::{PointCloud, SynchronizedRanges};

use super::super::gather::{Accumulation, GatheredScan, deskew_into, gravity_aligned};
use super::super::motion::{LONGEST_UNMEASURED, Measured, Motion};
use super::super::scan::{Scan, with_share};
use super::FrontEnd;
use crate::filtered;

impl FrontEnd {
    /// De-skews the scan by the motion that matching finds for it, where that moves its points and the
    /// motion was not measured, or where the motion measured by odometry is impossible.
    pub(super) fn deskewed(
        &mut self,
        ranges: &SynchronizedRanges,
        gathered: &GatheredScan,
        gravity: Quaternion,
    ) -> Option<GatheredScan> {
        let begin = ranges.points.first().map(|p| f64::from(p.point.time)).filter(|time| *time < 0.0)?;
        let extrapolator = self.extrapolator.as_mut()?;
        let (last_time, last) = extrapolator.last_pose()?;
        let seconds = ranges.time.seconds_since(last_time);
        let measured = Measured::since_last_pose(extrapolator, ranges.time);
        if !self.tracker.is_adaptive() || measured == Measured::Rotation {
            return None;
        }
        let options = &self.options;
        let by = |moving: &mut dyn FnMut(Time) -> Rigid3| {
            let mut accumulated = Accumulation::default();
            let last_pose = deskew_into(ranges, moving, options, &mut accumulated);
            Some(gravity_aligned(accumulated, &last_pose, &gravity, options))
        };
        if measured == Measured::Nothing && seconds > LONGEST_UNMEASURED {
            return by(&mut |_| last);
        }
        let pose_2d = |pose| project_2d(&(pose * gravity.inverse()));
        let extrapolated = pose_2d(extrapolator.extrapolate_pose(ranges.time));
        let tracking_yaw = yaw(&gravity);
        let motion = Motion { last: pose_2d(last), seconds, measured, between_readings: None, tracking_yaw };
        if measured == Measured::Whole {
            let step = motion.to(&self.tracker.suspected(extrapolated, motion)?);
            return by(&mut |time| {
                let part = part_of(&step, time.seconds_since(last_time) / seconds);
                embed_3d(&(motion.last * part)) * gravity
            });
        }
        let returns = &gathered.range_data.returns;
        let cloud = filtered(returns, &options.adaptive_voxel_filter);
        self.tracker.note(ranges.time, &extrapolated, [&cloud, returns]);
        let scan = Scan::new(&cloud, returns, self.active_submaps.matching_submap()?);
        let error = extrapolated.inverse() * self.tracker.search_ahead(extrapolated, motion, scan)?;
        let half_a_cell = 0.5 * f64::from(options.submaps.grid_options_2d.resolution);
        let in_scan = 1.0 - error_share(1.0 + begin / seconds);
        if in_scan * displacement(&error, returns) < half_a_cell {
            return None;
        }
        self.tracker.discard_cached_search();
        by(&mut |time| {
            let predicted = pose_2d(extrapolator.extrapolate_pose(time));
            let share = error_share(time.seconds_since(last_time) / seconds);
            embed_3d(&with_share(&predicted, &(predicted * error), share)) * gravity
        })
    }
}

/// Fraction of a motion at constant velocity.
fn part_of(motion: &Rigid2, share: f64) -> Rigid2 {
    Rigid2 { translation: motion.translation * share, angle: motion.angle * share }
}

/// Fraction of its final error that a prediction has at this fraction of the interval, under constant
/// acceleration. The prediction continues the mean velocity of the previous interval, which is equally
/// long.
fn error_share(fraction: f64) -> f64 {
    0.5 * fraction * (1.0 + fraction)
}

/// Displacement of the points of a scan by a motion, metres: translation plus root mean square of the
/// displacement by rotation.
fn displacement(motion: &Rigid2, points: &PointCloud) -> f64 {
    let squares = points.points.iter().map(|p| f64::from(p.x * p.x + p.y * p.y));
    let radius = (squares.sum::<f64>() / points.points.len().max(1) as f64).sqrt();
    motion.translation.norm() + motion.normalized_angle().abs() * radius
}
