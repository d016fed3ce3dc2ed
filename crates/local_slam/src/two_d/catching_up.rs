//! Handles odometry that lags behind and reports the missing part of one motion with the next.
//!
//! A busy computer passes on the last known wheel pose; in a long gap it is one from the beginning of the
//! gap. The motion over the gap is then too short and the next one too long by the same amount; their sum
//! is correct. So after a scan was matched far from its pose by odometry, odometry may also continue from its
//! own pose.

use portolan_geometry::Rigid2;

/// Time after which odometry that was wrong no longer catches up, seconds.
const LONGEST: f64 = 2.0;

/// Pose by odometry alone since it lagged behind.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CatchingUp {
    /// Pose in the local map, and time since the lag, seconds.
    behind: Option<(Rigid2, f64)>,
}

impl CatchingUp {
    /// Pose of the scanner after one more motion by odometry over this time, seconds, if odometry has
    /// caught up.
    pub fn after(&self, motion: &Rigid2, seconds: f64) -> Option<Rigid2> {
        self.behind.filter(|(_, since)| since + seconds <= LONGEST).map(|(behind, _)| behind * *motion)
    }

    /// Takes the motion by odometry from one scan to the next, and its duration, seconds. `is_far`: the
    /// scan was matched far from its prediction. `has_caught_up`: it was matched where odometry had caught
    /// up.
    pub fn add(&mut self, motion: (Rigid2, f64), predicted: Rigid2, is_far: bool, has_caught_up: bool) {
        let (motion, seconds) = motion;
        self.behind = match self.behind {
            _ if has_caught_up => None,
            None => is_far.then_some((predicted, 0.0)),
            Some((behind, since)) if since + seconds <= LONGEST => Some((behind * motion, since + seconds)),
            Some(_) => is_far.then_some((predicted, 0.0)),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lagging_odometry_catches_up_to_the_sum_of_both_motions() {
        let mut catching_up = CatchingUp::default();
        let step = Rigid2::new(0.1, 0.0, 0.2);
        // Odometry stood while the scanner moved two steps, and reports three after that.
        assert_eq!(catching_up.after(&step, 0.2), None);
        catching_up.add((Rigid2::identity(), 0.4), Rigid2::identity(), true, false);
        let three = step * step * step;
        let caught_up = catching_up.after(&three, 0.2).unwrap();
        assert!((caught_up.inverse() * three).translation.norm() < 1e-12);
        assert_eq!(catching_up.after(&three, 2.5), None);
        catching_up.add((three, 0.2), step * step * three, false, true);
        assert_eq!(catching_up.after(&step, 0.2), None);
    }
}
