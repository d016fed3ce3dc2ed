//! Odometry of the recent past: where it says the robot was at any moment.

use std::collections::VecDeque;

use portolan_geometry::{Duration, Rigid3, Time, rotation_angle};
use portolan_sensor::OdometryData;

use super::screw_motion::fraction_of_motion;

/// Odometry is given up when it has been silent for this long, or for three of its usual intervals.
const TIMEOUT: Duration = Duration::from_ticks(5_000_000);
/// Velocities are taken over at least this time, where there are data, so that jitter of stamps and
/// coarse encoders do not show.
const VELOCITY_BASELINE: Duration = Duration::from_ticks(500_000);
/// No ground robot, car or train is faster than this: m/s and rad/s.
const MAX_SPEED: f64 = 100.0;
const MAX_TURN_RATE: f64 = 20.0;
/// Nor does one speed up faster than this: m/s² and rad/s².
const MAX_ACCELERATION: f64 = 30.0;
const MAX_TURN_ACCELERATION: f64 = 100.0;
/// What uneven stamps and slipping wheels may add: m and rad.
const JUMP_SLACK: f64 = 0.3;
/// Most poses that are kept.
const CAPACITY: usize = 20_000;

/// Odometry in ascending order of time, from shortly before the last pose on.
#[derive(Clone, Debug, Default)]
pub(super) struct OdometryQueue {
    data: VecDeque<OdometryData>,
    /// How much is kept from before the last pose.
    history: Duration,
}

impl OdometryQueue {
    pub fn new(history: Duration) -> Self {
        Self { data: VecDeque::new(), history }
    }

    pub fn len(&self) -> usize {
        self.data.len()
    }

    pub fn oldest(&self) -> Option<&OdometryData> {
        self.data.front()
    }

    pub fn newest(&self) -> Option<&OdometryData> {
        self.data.back()
    }

    /// Appends a pose, which must be newer than all others.
    pub fn push(&mut self, data: OdometryData) {
        self.data.push_back(data);
        thin_out(&mut self.data, CAPACITY);
    }

    /// Whether a new pose is so far from where the newest and its velocity lead that odometry must have
    /// started anew.
    pub fn is_jump(&self, data: &OdometryData) -> bool {
        let mut backward = self.data.iter().rev();
        let Some(newest) = backward.next() else { return false };
        let seconds = data.time.seconds_since(newest.time);
        let (distance, angle) = distances(newest, data);
        let (mut max_distance, mut max_angle) = (MAX_SPEED * seconds, MAX_TURN_RATE * seconds);
        if let Some(before) = backward.next() {
            let (last_distance, last_angle) = distances(before, newest);
            let ratio = (seconds / newest.time.seconds_since(before.time)).max(1.0);
            let gain = seconds * seconds;
            max_distance = max_distance.min(2.0 * ratio * last_distance + MAX_ACCELERATION * gain);
            max_angle = max_angle.min(2.0 * ratio * last_angle + MAX_TURN_ACCELERATION * gain);
        }
        distance > max_distance + JUMP_SLACK || angle > max_angle + JUMP_SLACK
    }

    pub fn clear(&mut self) {
        self.data.clear();
    }

    /// Forgets what lies before the last pose, except two poses and the history.
    pub fn trim(&mut self, last_pose_time: Time) {
        let needed_from = last_pose_time - self.history;
        while self.data.len() > 2 && self.data.get(1).is_some_and(|d| d.time <= needed_from) {
            self.data.pop_front();
        }
    }

    /// How the robot moved from one time to a later one, seen from its pose at the first: between
    /// odometry poses interpolated, outside with the velocity at that end. None if odometry does not
    /// cover that time well enough.
    pub fn motion(&self, from: Time, to: Time) -> Option<Rigid3> {
        let (oldest, newest) = (self.oldest()?.time, self.newest()?.time);
        let usual = newest - self.data.get(self.data.len().checked_sub(2)?)?.time;
        let timeout = TIMEOUT.max(usual + usual + usual);
        if to - newest > timeout || oldest - from > timeout {
            return None;
        }
        Some(self.pose_at(from)?.inverse() * self.pose_at(to)?)
    }

    /// Where odometry says the robot was. Needs two poses.
    fn pose_at(&self, time: Time) -> Option<Rigid3> {
        let after = self.data.partition_point(|d| d.time < time);
        let (start, end) = if after == 0 {
            let baseline_end = self.oldest()?.time + VELOCITY_BASELINE;
            let end = self.data.partition_point(|d| d.time < baseline_end).clamp(1, self.data.len() - 1);
            (self.data.front()?, self.data.get(end)?)
        } else if after == self.data.len() {
            let newest = self.newest()?;
            let baseline = VELOCITY_BASELINE.max(time - newest.time);
            let start = self.data.partition_point(|d| d.time <= newest.time - baseline).saturating_sub(1);
            (newest, self.data.get(start)?)
        } else {
            (self.data.get(after - 1)?, self.data.get(after)?)
        };
        let span = end.time.seconds_since(start.time);
        if span == 0.0 {
            return None;
        }
        let motion = start.odom_from_tracking.inverse() * end.odom_from_tracking;
        let fraction = time.seconds_since(start.time) / span;
        Some(start.odom_from_tracking * fraction_of_motion(&motion, fraction))
    }
}

/// Metres and radians from one pose to another.
fn distances(from: &OdometryData, to: &OdometryData) -> (f64, f64) {
    let motion = from.odom_from_tracking.inverse() * to.odom_from_tracking;
    (motion.translation.vector.norm(), rotation_angle(&motion))
}

/// Halves the density of the older half when there are too many: memory is bounded, and what is
/// newest keeps its detail.
pub(super) fn thin_out<T>(data: &mut VecDeque<T>, capacity: usize) {
    if data.len() <= capacity {
        return;
    }
    let older = data.len() / 2;
    let mut index = 0;
    data.retain(|_| {
        index += 1;
        index > older || index % 2 == 1
    });
}
