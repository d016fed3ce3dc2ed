//! A trajectory: poses in order of time.

use portolan_geometry::{Duration, Rigid3, Time, Vector3, interpolate, is_on_earth, is_valid_pose, moved};
use portolan_numeric::counted;
use serde::Serialize;

/// A pose at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// Time of the pose.
    pub time: Time,
    /// Pose of the moving frame in the fixed frame.
    pub map_from_tracking: Rigid3,
}

/// Poses with strictly ascending times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    poses: Vec<TimedPose>,
}

/// Repairs that were made when a trajectory was constructed or read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TrajectoryRepairs {
    /// Poses that came after a later one; they were sorted.
    pub unsorted: usize,
    /// Poses at the time of another; the first was kept.
    pub duplicate_stamps: usize,
    /// Poses with NaN, infinity, a quaternion of length zero or a position that is not on the Earth
    /// ([`FARTHEST_COORDINATE`](portolan_geometry::FARTHEST_COORDINATE)); they were dropped.
    pub invalid_poses: usize,
    /// Quaternions whose length was off by more than 0.001; they were normalised.
    pub renormalized_quaternions: usize,
}

impl TrajectoryRepairs {
    /// The repairs in words.
    pub fn notes(&self) -> Vec<String> {
        let repaired = [
            (self.unsorted, "came after a later one: put in order"),
            (self.duplicate_stamps, "at the time of another: the first was kept"),
            (self.invalid_poses, "with values that are no pose on the Earth: left out"),
            (self.renormalized_quaternions, "with a quaternion of a length other than one: normalised"),
        ];
        let repaired = repaired.into_iter().filter(|(count, _)| *count > 0);
        repaired.map(|(count, what)| format!("{} {what}", counted(count as u64, "pose", "poses"))).collect()
    }
}

impl Trajectory {
    /// Sorts poses by time. Of several at one time the first is kept; invalid poses are dropped.
    pub fn new(poses: impl IntoIterator<Item = TimedPose>) -> (Self, TrajectoryRepairs) {
        let mut repairs = TrajectoryRepairs::default();
        let mut ordered: Vec<TimedPose> = Vec::new();
        for pose in poses {
            let place = &pose.map_from_tracking.translation.vector;
            if !is_valid_pose(&pose.map_from_tracking) || !is_on_earth(place) {
                repairs.invalid_poses += 1;
                continue;
            }
            repairs.unsorted += usize::from(ordered.last().is_some_and(|last| pose.time < last.time));
            ordered.push(pose);
        }
        ordered.sort_by_key(|p| p.time);
        let before = ordered.len();
        ordered.dedup_by_key(|p| p.time);
        repairs.duplicate_stamps = before - ordered.len();
        (Self { poses: ordered }, repairs)
    }

    /// All poses in order.
    pub fn poses(&self) -> &[TimedPose] {
        &self.poses
    }

    /// The trajectory translated along the axes of the map, metres.
    pub fn moved(mut self, by: &Vector3) -> Self {
        for pose in &mut self.poses {
            pose.map_from_tracking = moved(&pose.map_from_tracking, by);
        }
        self
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there are no poses.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Times of the first and the last pose.
    pub fn span(&self) -> Option<(Time, Time)> {
        Some((self.poses.first()?.time, self.poses.last()?.time))
    }

    /// The pose at a time within the span, by linear interpolation of translation and spherical interpolation
    /// of rotation between the neighbouring poses.
    pub fn lookup(&self, time: Time) -> Option<Rigid3> {
        let (before, after) = self.neighbours(time)?;
        Some(interpolate(before.time, &before.map_from_tracking, after.time, &after.map_from_tracking, time))
    }

    /// Like [`Trajectory::lookup`]; before the first and after the last pose that pose itself.
    pub fn lookup_clamped(&self, time: Time) -> Option<Rigid3> {
        let (start, end) = self.span()?;
        self.lookup(time.clamp(start, end))
    }

    /// The last pose at or before a time within the span and the first at or after it (twice the same pose if
    /// there is one at exactly this time).
    pub fn neighbours(&self, time: Time) -> Option<(&TimedPose, &TimedPose)> {
        let after = self.poses.partition_point(|p| p.time < time);
        let next = self.poses.get(after)?;
        if next.time == time {
            return Some((next, next));
        }
        Some((self.poses.get(after.checked_sub(1)?)?, next))
    }

    /// The pose nearest in time, if it is within the tolerance; of two equally near the later one.
    pub fn nearest(&self, time: Time, tolerance: Duration) -> Option<&TimedPose> {
        let after = self.poses.partition_point(|p| p.time < time);
        let next = self.poses.get(after).map(|p| (p.time - time, p));
        let previous = after.checked_sub(1).and_then(|i| self.poses.get(i)).map(|p| (time - p.time, p));
        let (distance, pose) = match (previous, next) {
            (Some(previous), Some(next)) if previous.0 < next.0 => previous,
            (previous, next) => next.or(previous)?,
        };
        (distance <= tolerance).then_some(pose)
    }

    /// Metres from the first pose to each pose, along the trajectory.
    pub fn covered_distances(&self) -> Vec<f64> {
        covered_distances(self.poses.iter().map(|p| &p.map_from_tracking))
    }

    /// Metres from the first to the last pose, along the trajectory.
    pub fn path_length(&self) -> f64 {
        self.covered_distances().last().copied().unwrap_or(0.0)
    }

    /// The same trajectory with every time later by `offset`.
    pub fn shifted(&self, offset: Duration) -> Self {
        Self::new(self.poses.iter().map(|p| TimedPose { time: p.time + offset, ..*p })).0
    }
}

/// Cumulative length of the motions between consecutive poses, beginning with zero.
pub(crate) fn covered_distances<'a>(poses: impl Iterator<Item = &'a Rigid3>) -> Vec<f64> {
    let mut sum = 0.0;
    let mut last: Option<&Rigid3> = None;
    poses
        .map(|pose| {
            sum += last.map_or(0.0, |last| (last.inverse() * pose).translation.vector.norm());
            last = Some(pose);
            sum
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(tick: i64, x: f64) -> TimedPose {
        TimedPose {
            time: Time::from_ticks(tick),
            map_from_tracking: Rigid3::new(Vector3::new(x, 0.0, 0.0), Vector3::z() * x),
        }
    }

    #[test]
    fn disorder_is_repaired_and_counted() {
        let (trajectory, repairs) =
            Trajectory::new([pose(30, 3.0), pose(10, 1.0), pose(20, f64::NAN), pose(30, 9.0), pose(20, 2.0)]);
        let expected =
            TrajectoryRepairs { unsorted: 2, duplicate_stamps: 1, invalid_poses: 1, ..Default::default() };
        assert_eq!(repairs, expected);
        assert_eq!(trajectory.poses(), [pose(10, 1.0), pose(20, 2.0), pose(30, 3.0)]);
        assert!((trajectory.path_length() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn poses_are_found_by_time() {
        let (trajectory, _) = Trajectory::new([pose(10, 1.0), pose(20, 2.0)]);
        let at = |tick| trajectory.lookup(Time::from_ticks(tick)).map(|p| p.translation.x);
        assert_eq!((at(9), at(10), at(15), at(20), at(21)), (None, Some(1.0), Some(1.5), Some(2.0), None));
        let clamped = |tick| trajectory.lookup_clamped(Time::from_ticks(tick)).unwrap().translation.x;
        assert_eq!((clamped(0), clamped(15), clamped(99)), (1.0, 1.5, 2.0));
        let nearest = |tick, tolerance| {
            let found = trajectory.nearest(Time::from_ticks(tick), Duration::from_ticks(tolerance));
            found.map(|p| p.time.ticks())
        };
        assert_eq!(
            (nearest(14, 4), nearest(15, 5), nearest(5, 4), nearest(25, 5)),
            (Some(10), Some(20), None, Some(20))
        );
        assert!(Trajectory::default().lookup_clamped(Time::from_ticks(0)).is_none());
    }
}
