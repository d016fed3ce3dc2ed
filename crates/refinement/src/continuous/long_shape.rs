//! Keeps the long-range shape of a trajectory where no pass returns.
//!
//! Consecutive scans overlap, so a refinement makes their common surfaces sharp. But a systematic error of
//! the lidar (the angle of a beam, ranges at grazing incidence) rotates each scan a little against the one
//! before, always in the same direction: surfaces stay sharp and a straight street bends. Sharpness does not
//! show this error. Where the scanner returns to a place, the surfaces of both passes constrain it. Elsewhere
//! nothing does, and slow changes of the correction are left out there: the motion of the input over more
//! than a few seconds is kept.

use portolan_geometry::{
    Rigid3, Vector3, angle_axis_from_quaternion, nalgebra as na, quaternion_from_angle_axis,
};

use super::DenseTrajectory;

/// Time scale above which changes of the correction are slow, seconds (standard deviation of the window).
const SLOW: f64 = 2.0;
/// Sampling interval of corrections, seconds.
const STEP: f64 = 0.1;
/// Distance within which the scanner counts as back at a place, metres.
const RETURN: f64 = 15.0;
/// Minimum ratio of the path length to that distance.
const DETOUR: f64 = 3.0;
/// Minimum path length of a return, metres.
const LEAST_PATH_LENGTH: f64 = 5.0;
/// Path length that a rotation counts as, metres for each radian: it shows the same surfaces to other beams.
const METRES_PER_RADIAN: f64 = 2.0;
/// Maximum number of places that are compared with each other.
const MOST_PLACES: usize = 3000;

/// Intervals from and to, seconds, in order, on path segments that return.
pub(super) fn returning(trajectory: &DenseTrajectory) -> Vec<[f64; 2]> {
    let duration = trajectory.duration();
    let count = ((duration / STEP).ceil() as usize + 1).min(MOST_PLACES);
    let seconds = |i: usize| duration * i as f64 / (count - 1).max(1) as f64;
    let poses: Vec<Rigid3> = (0..count).map(|i| trajectory.joined_pose(seconds(i))).collect();
    let mut lengths = vec![0.0; count];
    for i in 1..count {
        let motion = poses[i - 1].inverse() * poses[i];
        let step = motion.translation.vector.norm() + METRES_PER_RADIAN * motion.rotation.angle();
        lengths[i] = lengths[i - 1] + step;
    }
    // For each place the last time at which the scanner was back.
    let mut spans: Vec<[f64; 2]> = Vec::new();
    for i in 0..count {
        let is_back = |j: &usize| {
            let distance = (poses[*j].translation.vector - poses[i].translation.vector).norm();
            let length = lengths[*j] - lengths[i];
            distance <= RETURN && length >= LEAST_PATH_LENGTH && length >= DETOUR * distance
        };
        let Some(last) = (i + 1..count).rev().find(is_back) else { continue };
        match spans.last_mut() {
            Some(span) if seconds(i) <= span[1] => span[1] = span[1].max(seconds(last)),
            _ => spans.push([seconds(i), seconds(last)]),
        }
    }
    spans
}

/// A correction as numbers that can be averaged: translation in world axes and a rotation vector.
type Numbers = na::Vector6<f64>;

fn numbers(trajectory: &DenseTrajectory, seconds: f64) -> Numbers {
    let correction = trajectory.correction(seconds);
    let turn = angle_axis_from_quaternion(&correction.turn);
    let shift = correction.shift;
    Numbers::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// The slowly changing part of a correction in a span: at each sample the line that fits its surroundings
/// best (local linear regression with Gaussian weights).
fn slow_part(samples: &[(f64, Numbers)]) -> Vec<Numbers> {
    let at = |t: f64| {
        let (mut w0, mut w1, mut w2) = (0.0, 0.0, 0.0);
        let (mut c0, mut c1) = (Numbers::zeros(), Numbers::zeros());
        let near = samples.partition_point(|s| s.0 < t - 4.0 * SLOW);
        for (time, value) in samples[near..].iter().take_while(|s| s.0 <= t + 4.0 * SLOW) {
            let d = time - t;
            let weight = (-0.5 * (d / SLOW).powi(2)).exp();
            (w0, w1, w2) = (w0 + weight, w1 + weight * d, w2 + weight * d * d);
            c0 += weight * value;
            c1 += weight * d * value;
        }
        let determinant = w0 * w2 - w1 * w1;
        if determinant > 1e-9 * w0 * w2 { (w2 * c0 - w1 * c1) / determinant } else { c0 / w0.max(1e-12) }
    };
    samples.iter().map(|(time, _)| at(*time)).collect()
}

/// Removes slow changes of the correction wherever the path does not return. Returns the seconds for which
/// that was done.
pub(super) fn keep(trajectory: &mut DenseTrajectory) -> f64 {
    let duration = trajectory.duration();
    let mut held = 0.0;
    // Later parts move along with earlier ones.
    let mut whole = Rigid3::identity();
    let mut moved: Vec<(f64, Rigid3)> = Vec::new();
    let mut from = 0.0;
    let spans = returning(trajectory);
    for [start, end] in spans.iter().copied().chain([[duration, duration]]) {
        if start > from {
            held += start - from;
            let steps = ((start - from) / STEP).ceil().max(1.0) as usize;
            let times = (0..=steps).map(|i| from + (start - from) * i as f64 / steps as f64);
            let samples: Vec<(f64, Numbers)> = times.map(|t| (t, numbers(trajectory, t))).collect();
            let slow = slow_part(&samples);
            let first = samples[0].1 - slow[0];
            let begin = whole * trajectory.pose(from) * trajectory.joined_pose(from).inverse();
            for ((time, value), slow) in samples.iter().zip(&slow) {
                let fast = value - slow - first;
                let input = trajectory.joined_pose(*time);
                let shift = Vector3::new(fast[0], fast[1], fast[2]);
                let turn = quaternion_from_angle_axis(&Vector3::new(fast[3], fast[4], fast[5]));
                let refined = Rigid3::from_parts(
                    na::Translation3::from(input.translation.vector + shift),
                    turn * input.rotation,
                );
                let wanted = begin * refined;
                moved.push((*time, wanted * trajectory.pose(*time).inverse()));
            }
            whole = moved.last().map_or(whole, |(_, last)| *last);
        }
        moved.push((start, whole));
        moved.push((end, whole));
        from = end;
    }
    if held > 0.0 {
        trajectory.move_each(&moved);
    }
    held
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Duration, Quaternion, Time};

    fn trajectory_along(seconds: i32, place: impl Fn(f64) -> Vector3) -> DenseTrajectory {
        let poses: Vec<(Time, Rigid3)> = (0..=10 * seconds)
            .map(|i| {
                let t = 0.1 * f64::from(i);
                let time = Time::from_unix_seconds(1e9) + Duration::from_seconds(t);
                (time, Rigid3::from_parts(place(t).into(), Quaternion::identity()))
            })
            .collect();
        DenseTrajectory::new(&poses).unwrap()
    }

    #[test]
    fn a_straight_trajectory_is_not_bent_and_a_loop_is() {
        let street = |t: f64| Vector3::new(10.0 * t, 0.0, 0.0);
        let round = |t: f64| Vector3::new(10.0 * (t / 5.0).cos(), 10.0 * (t / 5.0).sin(), 0.0);
        for (mut trajectory, is_held) in
            [(trajectory_along(20, street), true), (trajectory_along(40, round), false)]
        {
            let duration = trajectory.duration();
            // Bends by the square of time, and shakes.
            let bend = |t: f64| Vector3::new(0.0, 0.0, 0.01 * t * t + 0.02 * (20.0 * t).sin());
            let samples = (0..=200).map(|i| duration * f64::from(i) / 200.0);
            let moves: Vec<(f64, Rigid3)> =
                samples.map(|t| (t, Rigid3::from_parts(bend(t).into(), Quaternion::identity()))).collect();
            trajectory.move_each(&moves);
            let held = keep(&mut trajectory);
            let end = trajectory.correction(duration).shift.z;
            assert_eq!(held > 0.9 * duration, is_held, "{held}");
            assert_eq!(end.abs() < 0.15, is_held, "{end}");
            assert!(trajectory.correction(0.0).shift.norm() < 0.03);
        }
    }
}
