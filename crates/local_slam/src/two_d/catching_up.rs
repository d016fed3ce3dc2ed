//! Odometry that is behind: what it has not told of one motion it tells with the next.
//!
//! A busy computer hands on the last pose of the wheels that it knows, in a long gap one from its beginning. The motion over the gap
//! is too short then and the one after it too long, by as much; together they are right. So after a scan was found far from where
//! odometry had it, odometry may go on from where it was itself.

use portolan_geometry::Rigid2;

/// After so many seconds odometry that was wrong does not catch up any more.
const LONGEST: f64 = 2.0;

/// Where odometry would have gone by itself since it was behind.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CatchingUp {
    /// Pose in the local map, and seconds since.
    behind: Option<(Rigid2, f64)>,
}

impl CatchingUp {
    /// Where the scanner is after one more motion, as odometry tells it, in so many seconds, if it has caught up.
    pub fn after(&self, motion: &Rigid2, seconds: f64) -> Option<Rigid2> {
        self.behind.filter(|(_, since)| since + seconds <= LONGEST).map(|(behind, _)| behind * *motion)
    }

    /// Takes the motion, as odometry tells it, in so many seconds from one scan to where the next one is; and whether the scan was
    /// found far from there, or where odometry had caught up.
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
    fn what_was_behind_is_where_both_motions_lead() {
        let mut catching_up = CatchingUp::default();
        let step = Rigid2::new(0.1, 0.0, 0.2);
        // Odometry stood while the scanner went two steps, and tells three after that.
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
