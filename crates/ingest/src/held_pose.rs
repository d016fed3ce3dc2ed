//! Detects odometry that repeats a pose without a new measurement.

use portolan_geometry::{Rigid3, Time};

/// Distinguishes repeats of a pose from new ones.
#[derive(Clone, Debug)]
pub struct HeldPose {
    longest: f64,
    last: Option<(Time, Rigid3)>,
}

impl HeldPose {
    /// `longest_hold`: maximum time for which odometry repeats a pose although the robot moves, seconds. If
    /// it repeats for longer, the robot stands.
    pub fn new(longest_hold: f64) -> Self {
        Self { longest: longest_hold, last: None }
    }

    /// Whether a pose at this time holds no measurement, since it repeats the one before to the last digit.
    pub fn is_repeat(&mut self, time: Time, pose: &Rigid3) -> bool {
        let is_repeat = self.last.is_some_and(|(since, last)| {
            last == *pose && (0.0..self.longest).contains(&time.seconds_since(since))
        });
        if !is_repeat {
            self.last = Some((time, *pose));
        }
        is_repeat
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_repeated_for_longer_than_odometry_is_held_back_mean_standstill() {
        let mut held = HeldPose::new(1.0);
        let at = |tenths: i64| Time::from_ticks(tenths * 1_000_000);
        let (stands, moved) = (Rigid3::identity(), Rigid3::translation(0.1, 0.0, 0.0));
        let new: Vec<i64> = (0..25).filter(|t| !held.is_repeat(at(*t), &stands)).collect();
        assert_eq!(new, [0, 10, 20]);
        assert!(!held.is_repeat(at(25), &moved) && held.is_repeat(at(26), &moved));
    }
}
