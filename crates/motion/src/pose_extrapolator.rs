//! Predicts the pose of the robot between two matched scans (`slam2d.md` §4.2).
//!
//! There are two kinds of prediction. Cartographer's assumes constant velocity from the last pose: a
//! straight line, with one velocity from the oldest and newest odometry pose, and rotation at the last known
//! rate. With few scans a second and no IMU, this loses the heading at every start and end of a turn. Ours
//! (`use_all_odometry`) follows the measurements of odometry and gyroscope since the last pose, and
//! continues along an arc where they end.

mod faults;
mod imu_based;
mod odometry_queue;
mod screw_motion;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use portolan_geometry::{
    Duration, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, interpolate, is_valid_pose,
    nalgebra as na, quaternion_from_angle_axis,
};
use portolan_sensor::{ImuData, OdometryData};

use crate::imu_tracker::ImuTracker;
pub use faults::{ExtrapolatorCounts, ExtrapolatorError};
pub use imu_based::ImuBasedSettings;
use imu_based::{ImuBasedExtrapolator, Prediction};
use odometry_queue::{OdometryQueue, thin_out};
use screw_motion::ScrewMotion;

/// Maximum number of IMU samples that are kept while no pose arrives.
const IMU_CAPACITY: usize = 20_000;
/// Silence of the gyroscope after which it is no longer used.
const IMU_TIMEOUT: Duration = Duration::from_ticks(5_000_000);
/// Duration of odometry before the last pose that is kept, to know the velocity there.
const ODOMETRY_HISTORY: Duration = Duration::from_ticks(1_000_000);

/// The three tracked orientations.
#[derive(Clone, Copy, Debug)]
struct Trackers {
    /// At the last pose.
    main: ImuTracker,
    /// At the newest odometry.
    odometry: ImuTracker,
    /// At the last predicted pose.
    extrapolation: ImuTracker,
}

/// Predicts poses from the last ones, odometry and IMU. Poses are the tracking frame in the local map.
#[derive(Clone, Debug)]
pub struct PoseExtrapolator {
    pose_queue_duration: Duration,
    gravity_time_constant: f64,
    use_all_odometry: bool,
    poses: VecDeque<(Time, Rigid3)>,
    imu: VecDeque<ImuData>,
    odometry: OdometryQueue,
    trackers: Option<Trackers>,
    /// In the local map, m/s; and in the tracking frame, rad/s.
    linear_velocity_from_poses: Vector3,
    angular_velocity_from_poses: Vector3,
    linear_velocity_from_odometry: Vector3,
    angular_velocity_from_odometry: Vector3,
    /// Motion over the pose queue and the seconds that it took.
    recent_motion: Option<(ScrewMotion, f64)>,
    last_extrapolated_time: Option<Time>,
    /// The last prediction, as long as there are no new measurements.
    cached: Option<(Time, Rigid3)>,
    counts: ExtrapolatorCounts,
    /// Makes the predictions instead, if there is one.
    imu_based: Option<Box<ImuBasedExtrapolator>>,
    /// Its prediction for the prepared time.
    prepared: Option<Prediction>,
}

impl PoseExtrapolator {
    /// An extrapolator without measurements.
    ///
    /// Velocity is taken over at least `pose_queue_duration` seconds of poses; gravity is averaged over
    /// `imu_gravity_time_constant` seconds. `use_all_odometry` chooses our prediction instead of
    /// Cartographer's (see the module).
    pub fn new(pose_queue_duration: f64, imu_gravity_time_constant: f64, use_all_odometry: bool) -> Self {
        Self {
            pose_queue_duration: Duration::from_seconds(pose_queue_duration),
            gravity_time_constant: imu_gravity_time_constant,
            use_all_odometry,
            poses: VecDeque::new(),
            imu: VecDeque::new(),
            odometry: OdometryQueue::new(if use_all_odometry { ODOMETRY_HISTORY } else { Duration::ZERO }),
            trackers: None,
            linear_velocity_from_poses: Vector3::zeros(),
            angular_velocity_from_poses: Vector3::zeros(),
            linear_velocity_from_odometry: Vector3::zeros(),
            angular_velocity_from_odometry: Vector3::zeros(),
            recent_motion: None,
            last_extrapolated_time: None,
            cached: None,
            counts: ExtrapolatorCounts::default(),
            imu_based: None,
            prepared: None,
        }
    }

    /// Predicts by fitting poses, IMU and odometry of the last seconds (`slam3d.md` §2). To be set before
    /// anything is added.
    #[must_use]
    pub fn with_imu_based(mut self, settings: &ImuBasedSettings) -> Self {
        self.imu_based = Some(Box::new(ImuBasedExtrapolator::new(settings)));
        self
    }

    /// A copy without odometry; an IMU-based fit keeps its data.
    #[must_use]
    pub fn without_odometry(&self) -> Self {
        let mut without = self.clone();
        without.odometry.clear();
        without.linear_velocity_from_odometry = Vector3::zeros();
        without.angular_velocity_from_odometry = Vector3::zeros();
        (without.cached, without.prepared) = (None, None);
        without
    }

    /// Announces that poses until `time` will be requested next. The IMU-based extrapolator makes its fit
    /// here, once for all of them.
    pub fn prepare(&mut self, time: Time) {
        self.prepared = self.imu_based.as_mut().and_then(|fit| fit.extrapolate(time));
    }

    /// An extrapolator that starts at rest at an IMU sample, upright according to its acceleration.
    pub fn from_imu(
        pose_queue_duration: f64,
        imu_gravity_time_constant: f64,
        use_all_odometry: bool,
        imu_data: &ImuData,
    ) -> Result<Self, ExtrapolatorError> {
        let extrapolator = Self::new(pose_queue_duration, imu_gravity_time_constant, use_all_odometry);
        extrapolator.started_at_rest(imu_data)
    }

    /// The extrapolator, still empty, started at rest at an IMU sample, upright according to its
    /// acceleration.
    pub fn started_at_rest(mut self, imu_data: &ImuData) -> Result<Self, ExtrapolatorError> {
        let (imu_gravity_time_constant, mut extrapolator) = (self.gravity_time_constant, {
            self.add_imu(imu_data)?;
            self
        });
        let mut tracker = ImuTracker::new(imu_gravity_time_constant, imu_data.time);
        tracker.add_acceleration(&imu_data.linear_acceleration);
        tracker.set_angular_velocity(&imu_data.angular_velocity);
        extrapolator.trackers = Some(Trackers { main: tracker, odometry: tracker, extrapolation: tracker });
        let pose = Rigid3::from_parts(na::Translation3::identity(), tracker.orientation());
        extrapolator.add_pose(imu_data.time, pose);
        Ok(extrapolator)
    }

    /// Restarts from a pose that is unrelated to those before, with this motion in this time, seconds. IMU
    /// samples are kept; odometry and earlier poses are dropped.
    pub fn restart(&mut self, time: Time, local_from_tracking: Rigid3, motion: &Rigid3, seconds: f64) {
        self.poses.clear();
        self.odometry.clear();
        self.linear_velocity_from_poses =
            local_from_tracking.rotation * (motion.translation.vector / seconds);
        self.angular_velocity_from_poses = angle_axis_from_quaternion(&motion.rotation) / seconds;
        self.linear_velocity_from_odometry = Vector3::zeros();
        self.angular_velocity_from_odometry = Vector3::zeros();
        self.recent_motion = Some((ScrewMotion::to(motion), seconds));
        self.add_pose(time, local_from_tracking);
    }

    /// Takes the pose of a matched scan. One that is older than the last is counted and dropped; one at the
    /// same time replaces the last.
    pub fn add_pose(&mut self, time: Time, local_from_tracking: Rigid3) {
        let last_time = self.last_pose_time();
        if !is_valid_pose(&local_from_tracking) || last_time.is_some_and(|last| time < last) {
            self.counts.rejected_poses += 1;
            return;
        }
        if last_time == Some(time) {
            self.poses.pop_back();
        }
        self.prepared = None;
        if let Some(fit) = &mut self.imu_based {
            fit.add_pose(time, local_from_tracking);
        }
        self.poses.push_back((time, local_from_tracking));
        while self.poses.len() > 2
            && self.poses.get(1).is_some_and(|(second, _)| *second <= time - self.pose_queue_duration)
        {
            self.poses.pop_front();
        }
        self.update_velocities_from_poses();
        let start = self.imu.front().map_or(time, |first| first.time.min(time));
        let fresh = || ImuTracker::new(self.gravity_time_constant, start);
        let main = self.advanced(self.trackers.map_or_else(fresh, |t| t.main), time);
        self.trackers = Some(Trackers { main, odometry: main, extrapolation: main });
        self.trim_imu();
        self.odometry.trim(time);
        self.last_extrapolated_time = Some(time);
        self.cached = Some((time, local_from_tracking));
    }

    fn update_velocities_from_poses(&mut self) {
        let (Some((old_time, old)), Some((new_time, new))) = (self.poses.front(), self.poses.back()) else {
            return;
        };
        let span = *new_time - *old_time;
        if span <= Duration::ZERO || span < self.pose_queue_duration {
            return; // too short: the old velocities hold
        }
        let seconds = span.seconds();
        let motion = old.inverse() * new;
        self.linear_velocity_from_poses = (new.translation.vector - old.translation.vector) / seconds;
        self.angular_velocity_from_poses = angle_axis_from_quaternion(&motion.rotation) / seconds;
        self.recent_motion = Some((ScrewMotion::to(&motion), seconds));
    }

    /// Takes an IMU sample, in order of time and not older than the last pose.
    pub fn add_imu(&mut self, data: &ImuData) -> Result<(), ExtrapolatorError> {
        let values = data.linear_acceleration.iter().chain(data.angular_velocity.iter());
        let result = if !values.into_iter().all(|v| v.is_finite()) {
            Err(ExtrapolatorError::NotFinite)
        } else if self.last_pose_time().is_some_and(|last| data.time < last) {
            Err(ExtrapolatorError::OlderThanLastPose)
        } else if self.imu.back().is_some_and(|last| data.time < last.time) {
            Err(ExtrapolatorError::OutOfOrder)
        } else {
            self.cached = None;
            self.prepared = None;
            if let Some(fit) = &mut self.imu_based {
                fit.add_imu(*data);
            }
            self.imu.push_back(*data);
            thin_out(&mut self.imu, IMU_CAPACITY);
            self.trim_imu();
            Ok(())
        };
        self.counts.rejected_imu += u64::from(result.is_err());
        result
    }

    /// One sample at or before the last pose is kept, to know the rates there.
    fn trim_imu(&mut self) {
        let Some(last_pose_time) = self.last_pose_time() else { return };
        while self.imu.get(1).is_some_and(|second| second.time <= last_pose_time) {
            self.imu.pop_front();
        }
    }

    /// Takes an odometry pose, in order of time. Cartographer's prediction does not use one that is older
    /// than the last pose.
    pub fn add_odometry(&mut self, data: &OdometryData) -> Result<(), ExtrapolatorError> {
        let last_pose_time = self.last_pose_time();
        let result = if !is_valid_pose(&data.odom_from_tracking) {
            Err(ExtrapolatorError::NotFinite)
        } else if !self.use_all_odometry && last_pose_time.is_some_and(|last| data.time < last) {
            Err(ExtrapolatorError::OlderThanLastPose)
        } else if self.odometry.newest().is_some_and(|newest| data.time <= newest.time) {
            Err(ExtrapolatorError::OutOfOrder)
        } else {
            if self.use_all_odometry && self.odometry.is_jump(data) {
                self.counts.odometry_jumps += 1;
                self.odometry.clear();
            }
            self.cached = None;
            self.prepared = None;
            if let Some(fit) = &mut self.imu_based {
                fit.add_odometry(*data);
            }
            self.odometry.push(*data);
            if let Some(last) = last_pose_time {
                self.odometry.trim(last);
            }
            self.update_velocities_from_odometry();
            Ok(())
        };
        self.counts.rejected_odometry += u64::from(result.is_err());
        result
    }

    fn update_velocities_from_odometry(&mut self) {
        let (Some(oldest), Some(newest)) = (self.odometry.oldest(), self.odometry.newest()) else { return };
        let seconds = oldest.time.seconds_since(newest.time);
        if seconds == 0.0 {
            return;
        }
        // Both are negative: time and motion, so that the velocity belongs to the newest pose.
        let back = newest.odom_from_tracking.inverse() * oldest.odom_from_tracking;
        self.angular_velocity_from_odometry = angle_axis_from_quaternion(&back.rotation) / seconds;
        let (Some(mut trackers), Some((_, last_pose))) = (self.trackers, self.poses.back()) else { return };
        trackers.odometry = self.advanced(trackers.odometry, newest.time);
        let turned = trackers.main.orientation().inverse() * trackers.odometry.orientation();
        let local_from_tracking = last_pose.rotation * turned;
        self.linear_velocity_from_odometry = local_from_tracking * (back.translation.vector / seconds);
        self.trackers = Some(trackers);
    }

    /// A tracker advanced to `time` with the measurements of the IMU, or else with a level IMU that rotates
    /// like odometry or poses.
    fn advanced(&self, mut tracker: ImuTracker, time: Time) -> ImuTracker {
        let Some(first) = self.imu.front().filter(|first| first.time <= time) else {
            tracker.advance(time);
            tracker.add_acceleration(&Vector3::z());
            tracker.set_angular_velocity(if self.odometry.len() < 2 {
                &self.angular_velocity_from_poses
            } else {
                &self.angular_velocity_from_odometry
            });
            return tracker;
        };
        tracker.advance(first.time);
        let start = self.imu.partition_point(|d| d.time < tracker.time());
        for data in self.imu.iter().skip(start).take_while(|d| d.time < time) {
            tracker.advance(data.time);
            tracker.add_acceleration(&data.linear_acceleration);
            tracker.set_angular_velocity(&data.angular_velocity);
        }
        tracker.advance(time);
        tracker
    }

    /// The predicted pose at a time not before the last pose. For earlier times: interpolated between the
    /// last poses with `use_all_odometry`, else the last pose. The identity while there is no pose at all.
    pub fn extrapolate_pose(&mut self, time: Time) -> Rigid3 {
        let (Some((last_time, last)), Some(trackers)) = (self.poses.back().copied(), self.trackers) else {
            self.counts.queries_too_early += 1;
            return Rigid3::identity();
        };
        if time < last_time {
            self.counts.queries_too_early += 1;
            return if self.use_all_odometry { self.earlier_pose(time) } else { last };
        }
        if let Some((cached_time, pose)) = self.cached
            && cached_time == time
        {
            self.last_extrapolated_time = Some(time);
            return pose;
        }
        let pose = if let (Some(fit), Some(prediction)) = (&self.imu_based, &self.prepared) {
            fit.between(prediction, time)
        } else if self.use_all_odometry {
            self.follow_measurements(last_time, &last, trackers, time)
        } else {
            self.go_straight_on(last_time, &last, trackers, time)
        };
        self.last_extrapolated_time = Some(time);
        self.cached = Some((time, pose));
        pose
    }

    /// Pose of the tracking frame from odometry whose readings are too far apart to be used for the
    /// prediction. Along degenerate directions of scans, it is still the better measurement.
    pub fn between_readings(&mut self, time: Time) -> Option<Rigid3> {
        let (last_time, last) = self.last_pose()?;
        Some(last * self.odometry.motion_between_readings(last_time, time)?)
    }

    /// Rotation of the tracking frame since the last pose, from the trackers.
    fn turned(&mut self, trackers: Trackers, time: Time) -> Quaternion {
        // A tracker cannot go back: for an earlier time than the last one, it starts again from the last
        // pose.
        let can_go_on = trackers.extrapolation.time() <= time;
        let start = if can_go_on { trackers.extrapolation } else { trackers.main };
        let extrapolation = self.advanced(start, time);
        self.trackers = Some(Trackers { extrapolation, ..trackers });
        trackers.main.orientation().inverse() * extrapolation.orientation()
    }

    /// Cartographer's prediction: constant velocity in the local map.
    fn go_straight_on(&mut self, last_time: Time, last: &Rigid3, trackers: Trackers, time: Time) -> Rigid3 {
        let velocity = if self.odometry.len() < 2 {
            self.linear_velocity_from_poses
        } else {
            self.linear_velocity_from_odometry
        };
        let translation = last.translation.vector + velocity * time.seconds_since(last_time);
        Rigid3::from_parts(na::Translation3::from(translation), last.rotation * self.turned(trackers, time))
    }

    /// Our prediction: the motion measured by odometry, or else the continued motion of the last poses; with
    /// the rotation measured by the gyroscope, if there is one.
    fn follow_measurements(
        &mut self,
        last_time: Time,
        last: &Rigid3,
        trackers: Trackers,
        time: Time,
    ) -> Rigid3 {
        let motion = self.odometry.motion(last_time, time).unwrap_or_else(|| match &self.recent_motion {
            Some((motion, seconds)) => motion.fraction(time.seconds_since(last_time) / seconds),
            None => Rigid3::identity(),
        });
        if !self.has_gyroscope(time) {
            return last * motion;
        }
        let turned = self.turned(trackers, time);
        // The chord of an arc has half the rotation of the arc.
        let difference = angle_axis_from_quaternion(&(turned * motion.rotation.inverse()));
        let chord = quaternion_from_angle_axis(&(difference / 2.0)) * motion.translation.vector;
        last * Rigid3::from_parts(na::Translation3::from(chord), turned)
    }

    /// A pose before the last one, limited to the poses in the queue.
    fn earlier_pose(&self, time: Time) -> Rigid3 {
        let after = self.poses.partition_point(|(t, _)| *t < time).max(1);
        match (self.poses.get(after - 1), self.poses.get(after)) {
            (Some((start_time, start)), Some((end_time, end))) => {
                interpolate(*start_time, start, *end_time, end, time.max(*start_time))
            }
            (Some((_, only)), None) => *only,
            _ => Rigid3::identity(),
        }
    }

    /// Rotation from the tracking frame to a level one, at a time not before the last pose; identity while
    /// there is no pose. Heading is arbitrary but follows that of the robot.
    pub fn estimate_gravity_orientation(&self, time: Time) -> Quaternion {
        if let Some(prediction) = self.prepared.as_ref().filter(|p| p.time == time) {
            return prediction.gravity_from_tracking;
        }
        self.trackers.map_or_else(Quaternion::identity, |t| self.advanced(t.main, time).orientation())
    }

    /// Time of the last pose.
    pub fn last_pose_time(&self) -> Option<Time> {
        self.poses.back().map(|(time, _)| *time)
    }

    /// The last pose, with its time.
    pub fn last_pose(&self) -> Option<(Time, Rigid3)> {
        self.poses.back().copied()
    }

    /// Angular velocity of the tracking frame between the last poses, rad/s in that frame.
    pub fn angular_velocity_from_poses(&self) -> Vector3 {
        self.angular_velocity_from_poses
    }

    /// Whether a gyroscope measures the rotation of the tracking frame until `time`.
    pub fn has_gyroscope(&self, time: Time) -> bool {
        self.imu.back().is_some_and(|newest| time - newest.time <= IMU_TIMEOUT)
    }

    /// Whether odometry measures the motion of the tracking frame until `time`.
    pub fn has_odometry(&self, time: Time) -> bool {
        let reaches = |newest: &OdometryData| time - newest.time <= IMU_TIMEOUT;
        self.odometry.len() > 1 && self.odometry.newest().is_some_and(reaches)
    }

    /// Whether odometry or a gyroscope measured any of the motion from the last pose to a time.
    pub fn measured_since_last_pose(&self, until: Time) -> bool {
        let Some(last) = self.last_pose_time() else { return false };
        self.imu.back().is_some_and(|newest| newest.time > last) || self.odometry_since_last_pose(until)
    }

    /// Whether odometry measured the motion from the last pose to a time.
    pub fn odometry_since_last_pose(&self, until: Time) -> bool {
        self.last_pose_time().is_some_and(|last| self.odometry.is_dense(last, until))
    }

    /// Time of the last predicted or added pose.
    pub fn last_extrapolated_time(&self) -> Option<Time> {
        self.last_extrapolated_time
    }

    /// Numbers of measurements that were rejected or repaired so far.
    pub fn counts(&self) -> ExtrapolatorCounts {
        self.counts
    }
}
