//! Removes jumps of an input: between two poses it continues at another pose, as after a loop closure during
//! recording. No platform moves like that, and the seconds around a jump would not fit together. So the
//! pieces are joined according to the motion before and after. Drift that the jump had corrected returns;
//! removing it is the task of the refinement.

use portolan_geometry::{Rigid3, Time, angle_axis_from_quaternion, quaternion_from_angle_axis};
use serde::Serialize;

/// Minimum size of a jump, as a multiple of the usual deviation of motions from those before and after.
const TIMES: f64 = 12.0;
/// Minimum size of a jump, metres and radians.
const LEAST: (f64, f64) = (0.05, 0.02);
/// Length of a step, in usual steps, above which poses are missing and it is not a jump.
const BRIDGED: f64 = 4.0;
/// Fraction of jumps above which the input is rough and has no jumps.
const MOST_SHARE: f64 = 0.01;

/// A jump of the input that was removed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Jump {
    /// Seconds since the first pose.
    pub seconds: f64,
    /// Metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// The transforms that join the pieces of an input.
#[derive(Clone, Debug, Default)]
pub(crate) struct Joints {
    /// Times, and the transforms of poses from these times on.
    from: Vec<(Time, Rigid3)>,
    pub jumps: Vec<Jump>,
}

impl Joints {
    /// Finds jumps.
    pub fn of(poses: &[(Time, Rigid3)]) -> Self {
        let expected = |i: usize| -> Option<Rigid3> {
            let [a, b, c, d] = [i.checked_sub(1)?, i, i + 1, i + 2];
            let (_, last) = (poses.get(a)?, poses.get(d)?);
            let rate = |from: usize, to: usize| {
                let motion = poses[from].1.inverse() * poses[to].1;
                let seconds = poses[to].0.seconds_since(poses[from].0);
                let turn = angle_axis_from_quaternion(&motion.rotation);
                (motion.translation.vector / seconds, turn / seconds)
            };
            let ((v0, w0), (v1, w1)) = (rate(a, b), rate(c, d));
            let seconds = poses[c].0.seconds_since(poses[b].0);
            debug_assert!(last.0 > poses[a].0);
            let turn = quaternion_from_angle_axis(&((w0 + w1) * 0.5 * seconds));
            Some(Rigid3::from_parts(((v0 + v1) * 0.5 * seconds).into(), turn))
        };
        let mut steps: Vec<f64> = poses.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0)).collect();
        steps.sort_by(f64::total_cmp);
        let longest = BRIDGED * steps.get(steps.len() / 2).copied().unwrap_or(0.0);
        // The motion during missing poses is unknown.
        let is_near = |i: usize| poses[i + 1].0.seconds_since(poses[i].0) <= longest;
        let departures: Vec<(f64, f64)> = (0..poses.len().saturating_sub(1))
            .map(|i| {
                let Some(expected) = expected(i).filter(|_| (i - 1..=i + 1).all(is_near)) else {
                    return (0.0, 0.0);
                };
                let departure = expected.inverse() * (poses[i].1.inverse() * poses[i + 1].1);
                (departure.translation.vector.norm(), departure.rotation.angle())
            })
            .collect();
        let usual = |of: fn(&(f64, f64)) -> f64| {
            let mut all: Vec<f64> = departures.iter().map(of).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or(0.0)
        };
        let limits = (LEAST.0.max(TIMES * usual(|d| d.0)), LEAST.1.max(TIMES * usual(|d| d.1)));
        let is_large = |i: usize| departures.get(i).is_some_and(|d| d.0 > limits.0 || d.1 > limits.1);
        // The motions beside a jump deviate too, by half of it.
        let size = |i: usize| departures.get(i).map_or(0.0, |d| d.0 / limits.0 + d.1 / limits.1);
        let is_jump =
            |i: &usize| is_large(*i) && size(*i) >= size(i.wrapping_sub(1)) && size(*i) > size(i + 1);
        let found: Vec<usize> = (0..departures.len()).filter(is_jump).collect();
        let mut joints = Self::default();
        if found.len() as f64 > (MOST_SHARE * poses.len() as f64).max(1.0) {
            return joints;
        }
        let mut moved = Rigid3::identity();
        for i in found {
            let Some(expected) = expected(i) else { continue };
            // Pose i, as moved, continues as expected.
            moved = moved * poses[i].1 * expected * poses[i + 1].1.inverse();
            joints.from.push((poses[i + 1].0, moved));
            let seconds = poses[i + 1].0.seconds_since(poses[0].0);
            joints.jumps.push(Jump { seconds, translation: departures[i].0, rotation: departures[i].1 });
        }
        joints
    }

    /// The transform of poses at a time.
    pub fn at(&self, time: Time) -> Rigid3 {
        let next = self.from.partition_point(|(from, _)| *from <= time);
        next.checked_sub(1).map_or(Rigid3::identity(), |i| self.from[i].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Duration, Vector3};

    #[test]
    fn a_jump_is_taken_out_and_turns_are_not() {
        let start = Time::from_unix_seconds(5.0);
        let smooth = |i: i32| {
            let s = f64::from(i) * 0.1;
            let turn = Vector3::new(0.0, 0.0, 0.8 * (1.5 * s).sin());
            Rigid3::new(Vector3::new(1.2 * s, (0.9 * s).sin(), 0.03 * (9.0 * s).sin()), turn)
        };
        let jump = Rigid3::new(Vector3::new(0.5, -0.3, 0.0), Vector3::new(0.0, 0.0, 0.1));
        let pose = |i: i32| (start + Duration::from_seconds(f64::from(i) * 0.1), smooth(i));
        let truth: Vec<_> = (0..200).map(pose).collect();
        assert!(Joints::of(&truth).jumps.is_empty());
        let input: Vec<_> =
            truth.iter().enumerate().map(|(i, (t, p))| (*t, if i < 90 { *p } else { jump * p })).collect();
        let joints = Joints::of(&input);
        assert_eq!(joints.jumps.len(), 1);
        assert!((joints.jumps[0].seconds - 9.0).abs() < 1e-6);
        for ((time, joined), (_, wanted)) in input.iter().map(|(t, p)| (t, joints.at(*t) * p)).zip(&truth) {
            let error = (joined.inverse() * wanted).translation.vector.norm();
            assert!(error < 0.2, "{error} at {}", time.unix_seconds());
        }
        assert!(Joints::of(&truth[..2]).jumps.is_empty());
        // The motion during missing poses is arbitrary.
        let mut with_gap = truth.clone();
        with_gap.drain(60..70);
        assert!(Joints::of(&with_gap).jumps.is_empty());
    }
}
