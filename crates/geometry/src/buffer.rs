//! Interpolation of poses in time, and a buffer of timed poses.

use std::collections::VecDeque;

use nalgebra as na;

use crate::{Quaternion, Rigid3, Time};

/// The pose at `time` between two timed poses: linear interpolation of translation, spherical interpolation
/// of rotation along the shorter arc. Outside the span the same motion is extrapolated. Equal times give
/// `start`.
pub fn interpolate(start_time: Time, start: &Rigid3, end_time: Time, end: &Rigid3, time: Time) -> Rigid3 {
    let span = end_time.seconds_since(start_time);
    if span == 0.0 {
        return *start;
    }
    let factor = time.seconds_since(start_time) / span;
    let translation = start.translation.vector + (end.translation.vector - start.translation.vector) * factor;
    let rotation = slerp(&start.rotation, &end.rotation, factor);
    Rigid3::from_parts(na::Translation3::from(translation), rotation)
}

/// Spherical interpolation along the shorter arc. At half a revolution, where the arc is undefined, the start
/// is returned.
fn slerp(start: &Quaternion, end: &Quaternion, factor: f64) -> Quaternion {
    start.try_slerp(end, factor, 1e-12).unwrap_or(*start)
}

/// Timed poses in ascending order of time, looked up by interpolation.
#[derive(Clone, Debug, Default)]
pub struct TransformBuffer {
    poses: VecDeque<(Time, Rigid3)>,
    size_limit: Option<usize>,
}

impl TransformBuffer {
    /// An empty buffer without a limit.
    pub fn new() -> Self {
        Self::default()
    }

    /// Keeps at most `size_limit` poses, dropping the oldest.
    pub fn with_size_limit(size_limit: usize) -> Self {
        Self { poses: VecDeque::new(), size_limit: Some(size_limit.max(1)) }
    }

    /// Adds a pose. It replaces a pose of the same time; a pose earlier than others is inserted in order.
    pub fn push(&mut self, time: Time, pose: Rigid3) {
        let index = self.poses.partition_point(|(t, _)| *t < time);
        match self.poses.get_mut(index) {
            Some(entry) if entry.0 == time => entry.1 = pose,
            _ => self.poses.insert(index, (time, pose)),
        }
        if let Some(limit) = self.size_limit {
            while self.poses.len() > limit {
                self.poses.pop_front();
            }
        }
    }

    /// Removes everything before `time` except the last pose before it, which interpolation needs.
    pub fn forget_before(&mut self, time: Time) {
        while self.poses.len() > 1 && self.poses[1].0 <= time {
            self.poses.pop_front();
        }
    }

    /// Whether `time` is within the buffered span (ends included).
    pub fn has(&self, time: Time) -> bool {
        matches!((self.poses.front(), self.poses.back()), (Some(a), Some(b)) if a.0 <= time && time <= b.0)
    }

    /// The interpolated pose, if `time` is within the buffered span.
    pub fn lookup(&self, time: Time) -> Option<Rigid3> {
        if !self.has(time) {
            return None;
        }
        let index = self.poses.partition_point(|(t, _)| *t < time);
        let (end_time, end) = self.poses.get(index)?;
        if *end_time == time || index == 0 {
            return Some(*end);
        }
        let (start_time, start) = &self.poses[index - 1];
        Some(interpolate(*start_time, start, *end_time, end, time))
    }

    /// The interpolated pose; before the first or after the last pose that pose itself.
    pub fn lookup_clamped(&self, time: Time) -> Option<Rigid3> {
        let (first, last) = (self.poses.front()?, self.poses.back()?);
        self.lookup(time.clamp(first.0, last.0))
    }

    /// Time of the oldest pose.
    pub fn earliest_time(&self) -> Option<Time> {
        self.poses.front().map(|p| p.0)
    }

    /// Time of the newest pose.
    pub fn latest_time(&self) -> Option<Time> {
        self.poses.back().map(|p| p.0)
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there are no poses.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// All timed poses in order.
    pub fn iter(&self) -> impl Iterator<Item = &(Time, Rigid3)> {
        self.poses.iter()
    }
}

impl FromIterator<(Time, Rigid3)> for TransformBuffer {
    fn from_iter<I: IntoIterator<Item = (Time, Rigid3)>>(poses: I) -> Self {
        let mut buffer = Self::new();
        for (time, pose) in poses {
            buffer.push(time, pose);
        }
        buffer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vector3;

    fn pose(x: f64, yaw: f64) -> Rigid3 {
        Rigid3::from_parts(
            na::Translation3::new(x, x, x),
            Quaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        )
    }

    #[test]
    fn looks_up_between_poses() {
        let mut buffer = TransformBuffer::new();
        buffer.push(Time::from_ticks(50), pose(0.0, 0.0));
        assert!(buffer.has(Time::from_ticks(50)) && !buffer.has(Time::from_ticks(51)));
        assert_eq!(buffer.lookup(Time::from_ticks(50)), Some(pose(0.0, 0.0)));
        buffer.push(Time::from_ticks(100), pose(10.0, 2.0));
        assert!(!buffer.has(Time::from_ticks(25)) && !buffer.has(Time::from_ticks(125)));
        let middle = buffer.lookup(Time::from_ticks(75)).unwrap();
        assert!((middle.to_homogeneous() - pose(5.0, 1.0).to_homogeneous()).norm() < 1e-6);
        assert_eq!(buffer.lookup_clamped(Time::from_ticks(500)), Some(pose(10.0, 2.0)));
    }

    #[test]
    fn a_limit_drops_the_oldest() {
        let mut buffer = TransformBuffer::with_size_limit(2);
        for tick in [50, 100, 150] {
            buffer.push(Time::from_ticks(tick), pose(0.0, 0.0));
        }
        assert_eq!((buffer.len(), buffer.earliest_time()), (2, Some(Time::from_ticks(100))));
    }

    #[test]
    fn late_arrivals_find_their_place() {
        let mut buffer = TransformBuffer::new();
        for tick in [100, 50, 100, 75] {
            buffer.push(Time::from_ticks(tick), pose(tick as f64, 0.0));
        }
        let ticks: Vec<i64> = buffer.iter().map(|p| p.0.ticks()).collect();
        assert_eq!(ticks, [50, 75, 100]);
    }
}
