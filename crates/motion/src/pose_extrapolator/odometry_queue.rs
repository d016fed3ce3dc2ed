//! Keeps recent odometry and interpolates its motion at any time.

use std::collections::VecDeque;

use portolan_geometry::{Duration, Rigid3, Time, rotation_angle};
use portolan_sensor::OdometryData;

use super::screw_motion::ScrewMotion;

/// Silence of odometry after which it is no longer used, unless three of its usual intervals are longer.
const TIMEOUT: Duration = Duration::from_ticks(5_000_000);
/// Interval between readings up to which they always determine the motion between scans, however short the
/// time between scans is.
const DENSE: Duration = Duration::from_ticks(2_500_000);
/// Minimum time over which velocities are taken, where there is data, so that jitter of stamps and coarse
/// encoders have little effect.
const VELOCITY_BASELINE: Duration = Duration::from_ticks(500_000);
/// Speed above which odometry jumps, m/s: no ground robot, car or train is faster.
const MAX_SPEED: f64 = 100.0;
/// Angular velocity above which odometry jumps, rad/s.
const MAX_TURN_RATE: f64 = 20.0;
/// Acceleration above which odometry jumps, m/s².
const MAX_ACCELERATION: f64 = 30.0;
/// Angular acceleration above which odometry jumps, rad/s².
const MAX_TURN_ACCELERATION: f64 = 100.0;
/// Tolerance for uneven stamps and slipping wheels, m and rad.
const JUMP_SLACK: f64 = 0.3;
/// Maximum number of poses that are kept.
const CAPACITY: usize = 20_000;

/// Odometry in ascending order of time, starting shortly before the last pose.
#[derive(Clone, Debug, Default)]
pub(super) struct OdometryQueue {
    data: VecDeque<OdometryData>,
    /// Duration before the last pose that is kept.
    history: Duration,
    /// Cache of the last requested motion segment: the points of a scan request the same one repeatedly.
    last_piece: Option<Piece>,
}

/// A screw motion that is valid for a time span.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Time of the pose relative to which the motion is given.
    from: Time,
    /// Span for which the motion is valid.
    start: Time,
    end: Time,
    anchor: Time,
    from_from_anchor: Rigid3,
    motion: ScrewMotion,
    /// Duration of the whole motion, seconds; negative if it goes back in time.
    seconds: f64,
}

impl OdometryQueue {
    pub fn new(history: Duration) -> Self {
        Self { data: VecDeque::new(), history, last_piece: None }
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
        self.last_piece = None;
        self.data.push_back(data);
        thin_out(&mut self.data, CAPACITY);
    }

    /// Whether a new pose is so far from the newest one, given its velocity, that odometry must have been
    /// restarted.
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
        self.last_piece = None;
        self.data.clear();
    }

    /// Drops data before the last pose, except two poses and the history.
    pub fn trim(&mut self, last_pose_time: Time) {
        self.last_piece = None;
        let needed_from = last_pose_time - self.history;
        while self.data.len() > 2 && self.data.get(1).is_some_and(|d| d.time <= needed_from) {
            self.data.pop_front();
        }
    }

    /// Whether readings are dense enough to determine the motion from one time to a later one.
    ///
    /// If a robot accelerates by a, motion over a part t of the time T between two readings has an error of
    /// up to a·t·T/2 if it is interpolated, and of a·t² if the motion of the last t is continued. So the
    /// velocity of the last poses is the better prediction where t < T/2, and where there is no reading in
    /// t.
    pub fn is_dense(&self, from: Time, to: Time) -> bool {
        let enough = DENSE.max(to - from + (to - from));
        let is_dense_at = |time| {
            let after = self.data.partition_point(|d| d.time < time);
            let (before, after) = (after.checked_sub(1).and_then(|i| self.data.get(i)), self.data.get(after));
            before
                .zip(after)
                .is_none_or(|(before, after)| after.time == time || after.time - before.time <= enough)
        };
        self.newest().is_some_and(|newest| newest.time > from) && is_dense_at(from) && is_dense_at(to)
    }

    /// Motion of the robot from one time to a later one, relative to its pose at the first: interpolated
    /// between odometry poses, and extrapolated with the velocity at either end outside of them. None if
    /// odometry does not cover that time well enough.
    pub fn motion(&mut self, from: Time, to: Time) -> Option<Rigid3> {
        let (oldest, newest) = (self.oldest()?.time, self.newest()?.time);
        let usual = newest - self.data.get(self.data.len().checked_sub(2)?)?.time;
        let timeout = TIMEOUT.max(usual + usual + usual);
        if to - newest > timeout || oldest - from > timeout || !self.is_dense(from, to) {
            return None;
        }
        self.interpolated(from, to)
    }

    /// The same motion where readings are too far apart to determine the motion between them, but do
    /// determine the whole distance.
    pub fn motion_between_readings(&mut self, from: Time, to: Time) -> Option<Rigid3> {
        let is_covered = self.oldest()?.time <= from && self.newest()?.time >= to;
        if is_covered && !self.is_dense(from, to) { self.interpolated(from, to) } else { None }
    }

    fn interpolated(&mut self, from: Time, to: Time) -> Option<Rigid3> {
        let known = self.last_piece.filter(|p| p.from == from && p.start <= to && to <= p.end);
        let piece = known.or_else(|| self.piece(from, to))?;
        self.last_piece = Some(piece);
        Some(piece.from_from_anchor * piece.motion_at(to))
    }

    /// The motion segment around `to`, relative to the pose at `from`.
    fn piece(&self, from: Time, to: Time) -> Option<Piece> {
        let (anchor, piece) = self.piece_around(from)?;
        let odom_from_from = anchor.odom_from_tracking * piece.motion_at(from);
        let (anchor, piece) = self.piece_around(to)?;
        Some(Piece { from, from_from_anchor: odom_from_from.inverse() * anchor.odom_from_tracking, ..piece })
    }

    /// The motion segment around a time, and the odometry pose at which it starts. Needs two poses.
    fn piece_around(&self, time: Time) -> Option<(&OdometryData, Piece)> {
        let after = self.data.partition_point(|d| d.time < time);
        let (oldest, newest) = (self.oldest()?, self.newest()?);
        let (anchor, other, span) = if after == 0 {
            let other = self.data.partition_point(|d| d.time < oldest.time + VELOCITY_BASELINE);
            let other = other.clamp(1, self.data.len().checked_sub(1)?.max(1));
            (oldest, self.data.get(other)?, (Time::MIN, oldest.time))
        } else if after == self.data.len() {
            let other = self.data.partition_point(|d| d.time <= newest.time - VELOCITY_BASELINE);
            (newest, self.data.get(other.saturating_sub(1))?, (newest.time, Time::MAX))
        } else {
            let (anchor, other) = (self.data.get(after - 1)?, self.data.get(after)?);
            (anchor, other, (anchor.time, other.time))
        };
        let seconds = other.time.seconds_since(anchor.time);
        if seconds == 0.0 {
            return None;
        }
        let motion = anchor.odom_from_tracking.inverse() * other.odom_from_tracking;
        let piece = Piece {
            from: anchor.time,
            start: span.0,
            end: span.1,
            anchor: anchor.time,
            from_from_anchor: Rigid3::identity(),
            motion: ScrewMotion::to(&motion),
            seconds,
        };
        Some((anchor, piece))
    }
}

impl Piece {
    /// Motion from the anchor to a time.
    fn motion_at(&self, time: Time) -> Rigid3 {
        self.motion.fraction(time.seconds_since(self.anchor) / self.seconds)
    }
}

/// Distances between two poses, metres and radians.
fn distances(from: &OdometryData, to: &OdometryData) -> (f64, f64) {
    let motion = from.odom_from_tracking.inverse() * to.odom_from_tracking;
    (motion.translation.vector.norm(), rotation_angle(&motion))
}

/// Halves the density of the older half if there are too many: memory is bounded, and the newest data keeps
/// its detail.
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
