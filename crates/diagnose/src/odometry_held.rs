//! Detects odometry that is held back: a driver repeats the last pose that it has, and later sends the
//! motion of that time at once.
//!
//! A pose that repeats to the last digit means that the robot is at rest, or that nothing new was measured.
//! It is the latter if scans moved meanwhile and the next different pose contains the motion of the whole
//! time.

use std::fmt;

use portolan_geometry::nalgebra::Vector3;
use portolan_geometry::{Rigid2, Rigid3, Time, project_2d};

use crate::scan_motion::TimedMotion;

/// Minimum motion of scans while the pose was repeated, metres; a radian counts as a metre.
const LEAST_MOTION: f64 = 0.1;
/// Minimum speed of that motion, m/s: scans of a robot at rest drift.
const LEAST_SPEED: f64 = 0.1;
/// Number of standard deviations above chance by which the reported motions have to be nearer to those of
/// the whole time.
const SURE: f64 = 2.5;
/// Maximum time between a pose, or its last repeat, and the scan at which the compared motion begins or
/// ends, seconds.
const NEAR: f64 = 0.5;

/// How odometry holds motions back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryHold {
    /// Longest time for which it repeats a pose, seconds.
    pub longest: f64,
}

impl OdometryHold {
    /// Compares `poses` of odometry and `motions` of the scanner, both in order of time, given the pose of
    /// the scanner in the frame of the odometry. None unless motions are certainly held back.
    pub(crate) fn find(
        poses: &[(Time, Rigid3)],
        motions: &[TimedMotion],
        odometry_from_scanner: &Rigid3,
    ) -> Option<Self> {
        let runs: Vec<_> = poses.chunk_by(|(_, one), (_, next)| one == next).collect();
        let (mut sum, mut squares, mut longest) = (0.0, 0.0, 0.0_f64);
        for run in runs.windows(2).filter_map(Run::of) {
            let Some(nearer) = run.nearer_if_later(motions, odometry_from_scanner) else { continue };
            sum += nearer;
            squares += nearer * nearer;
            if nearer > 0.0 {
                longest = longest.max(run.next.0.seconds_since(run.first.0));
            }
        }
        (sum > SURE * f64::sqrt(squares)).then_some(Self { longest })
    }
}

impl fmt::Display for OdometryHold {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let longest = self.longest;
        write!(
            f,
            "repeats its last pose for up to {longest:.1} s while scans move, and reports the motion afterwards"
        )
    }
}

/// A pose, its last repeat and the pose after it.
struct Run {
    first: (Time, Rigid3),
    last: Time,
    next: (Time, Rigid3),
}

impl Run {
    /// A run of equal poses and the pose after it; none if the pose does not repeat.
    fn of(two: &[&[(Time, Rigid3)]]) -> Option<Self> {
        let [[first, .., (last, _)], [next, ..]] = two else { return None };
        Some(Self { first: *first, last: *last, next: *next })
    }

    /// The motion to the next pose is compared with that of scans since the first repeated pose and since
    /// its last repeat: returns how much nearer it is to the former, metres. None if scans did not move
    /// while the pose was repeated, or their motion is unknown.
    fn nearer_if_later(&self, motions: &[TimedMotion], odometry_from_scanner: &Rigid3) -> Option<f64> {
        let (from, to) = (self.first.0, self.next.0);
        let least = LEAST_MOTION.max(LEAST_SPEED * self.last.seconds_since(from));
        let while_repeated = moved(motions, from, self.last).filter(|motion| size(motion) > least)?;
        let afterwards = moved(motions, self.last, to)?;
        let pose = |pose: Rigid3| project_2d(&(pose * odometry_from_scanner));
        let reported = pose(self.first.1).inverse() * pose(self.next.1);
        let off = |motion: Rigid2| size(&(motion.inverse() * reported));
        Some(off(afterwards) - off(while_repeated * afterwards))
    }
}

/// Size of a motion, metres; a radian counts as a metre.
fn size(motion: &Rigid2) -> f64 {
    Vector3::new(motion.translation.x, motion.translation.y, motion.normalized_angle()).norm()
}

/// Motion of the scanner from the first scan after one time to the last before another, if it is known
/// throughout.
fn moved(motions: &[TimedMotion], from: Time, to: Time) -> Option<Rigid2> {
    let begin = motions.partition_point(|(start, ..)| *start < from);
    let is_near = |a: Time, b: Time| a.seconds_since(b).abs() < NEAR;
    let (mut until, mut motion) = (None, Rigid2::identity());
    for (start, end, step) in motions.iter().skip(begin).take_while(|(_, end, _)| *end <= to) {
        if !until.map_or(is_near(*start, from), |until| until == *start) {
            return None;
        }
        (until, motion) = (Some(*end), motion * *step);
    }
    is_near(until.unwrap_or(from), to).then_some(motion)
}

#[cfg(test)]
mod tests {
    use portolan_geometry::embed_3d;

    use super::*;

    fn at(scan: u32) -> Time {
        Time::from_ticks(i64::from(scan) * 2_000_000)
    }

    /// A drive of 400 scans, five a second; odometry reports the pose of the scan with the index `of`.
    fn hold(of: impl Fn(u32) -> u32, odometry: impl Fn(Rigid2) -> Rigid2) -> Option<f64> {
        let step = |scan: u32| Rigid2::new(0.1, 0.0, 0.1 * (0.05 * f64::from(scan)).sin());
        let mut trajectory = vec![Rigid2::identity()];
        for scan in 0..400 {
            trajectory.push(trajectory[scan as usize] * step(scan));
        }
        let motions: Vec<_> = (0..400).map(|scan| (at(scan), at(scan + 1), step(scan))).collect();
        let reported = |scan: u32| odometry(trajectory[of(scan) as usize]);
        let poses: Vec<_> = (0..400).map(|scan| (at(scan), embed_3d(&reported(scan)))).collect();
        OdometryHold::find(&poses, &motions, &Rigid3::identity()).map(|hold| hold.longest)
    }

    #[test]
    fn odometry_that_repeats_poses_and_catches_up_is_held_back() {
        assert_eq!(hold(|scan| scan, |pose| pose), None);
        let seconds = hold(|scan| scan / 5 * 5, |pose| pose).unwrap();
        assert!((seconds - 1.0).abs() < 1e-9, "{seconds}");
    }

    #[test]
    fn stalled_wheels_are_not_held_back() {
        // Only the last of five steps is reported.
        let reported = |scan: u32| scan / 5 + u32::from(scan % 5 == 4);
        assert_eq!(hold(reported, |pose| pose), None);
    }
}
