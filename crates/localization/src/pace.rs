//! Measures the speed of the scanner and detects steps that are physically impossible.

use portolan_geometry::{Rigid3, Time, Vector3};

use crate::settings::tracking::{
    CATCHING_UP, FARTHEST_OFF, FRICTION, MOVING_SPANS, SHORTEST_JUMP, SPEED_SPAN, STAMP_ERROR, TIMES_AS_FAST,
};

/// Speed of the scanner so far.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pace {
    /// Highest speed, metres per second, and the number of time spans over which speed was measured.
    fastest: f64,
    spans: u32,
    /// Velocity over the last time span, metres per second; none before the first has passed.
    velocity: Option<Vector3>,
    /// Start of the current time span.
    since: Option<(Time, Rigid3)>,
    last: Option<(Time, Rigid3)>,
    jumped: Option<Time>,
}

impl Pace {
    /// Whether the scanner cannot have moved from the last scan to this one; the path then starts anew.
    pub fn is_jump(&mut self, time: Time, local_from_scan: &Rigid3) -> bool {
        let here = (time, *local_from_scan);
        let is_jump = self.last.replace(here).is_some_and(|last| self.is_farther(&last, &here));
        if is_jump {
            (self.since, self.velocity, self.jumped) = (Some(here), Some(Vector3::zeros()), Some(time));
            return true;
        }
        let since = self.since.get_or_insert(here);
        let (translation, seconds) = motion(since, &here);
        if seconds >= SPEED_SPAN {
            *since = here;
            self.fastest = self.fastest.max(translation.norm() / seconds);
            self.velocity = Some(translation / seconds);
            self.spans += 1;
        }
        false
    }

    /// Whether a step is longer than possible.
    fn is_farther(&self, last: &(Time, Rigid3), here: &(Time, Rigid3)) -> bool {
        let (step, seconds) = motion(last, here);
        let farthest = TIMES_AS_FAST * self.fastest * seconds.max(SPEED_SPAN);
        if self.spans >= MOVING_SPANS && step.norm() > farthest.max(SHORTEST_JUMP) {
            return true;
        }
        let Some(velocity) = self.velocity else { return false };
        let catches_up = self.jumped.is_some_and(|jumped| here.0.seconds_since(jumped) < SPEED_SPAN);
        let off = if catches_up { CATCHING_UP } else { FARTHEST_OFF };
        let farthest_off = (0.5 * FRICTION * seconds * seconds).max(STAMP_ERROR * self.fastest).max(off);
        (step - velocity * seconds).norm() > farthest_off
    }
}

/// Translation, metres, and time, seconds, between two poses.
fn motion(from: &(Time, Rigid3), to: &(Time, Rigid3)) -> (Vector3, f64) {
    (to.1.translation.vector - from.1.translation.vector, to.0.seconds_since(from.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    /// Jumps among scans at these times and places along x.
    fn jumps(scans: impl Iterator<Item = (f64, f64)>) -> usize {
        let mut pace = Pace::default();
        let at = |seconds: f64| Time::from_ticks(0) + Duration::from_seconds(seconds);
        scans.filter(|(seconds, x)| pace.is_jump(at(*seconds), &Rigid3::translation(*x, 0.0, 0.0))).count()
    }

    #[test]
    fn a_robot_that_is_carried_jumps_and_one_whose_scanner_pauses_does_not() {
        let walk = |i: i32| (0.2 * f64::from(i), 0.1 * f64::from(i));
        assert_eq!(jumps((0..100).map(walk)), 0);
        let carried = |i: i32| if i < 50 { walk(i) } else { (walk(i).0 + 1.5, walk(i).1 + 8.0) };
        assert_eq!(jumps((0..100).map(carried)), 1);
        let pauses = |i: i32| if i < 50 { walk(i) } else { (walk(i).0 + 60.0, walk(i).1 + 30.0) };
        assert_eq!(jumps((0..100).map(pauses)), 0);
    }

    #[test]
    fn local_slam_that_catches_up_in_steps_jumps_with_each() {
        let walk = |i: i32| (0.2 * f64::from(i), 0.1 * f64::from(i));
        let late = |i: i32| [0.0, 1.6, 2.5, 3.4][(i - 49).clamp(0, 3) as usize];
        assert_eq!(jumps((0..100).map(|i| (walk(i).0, walk(i).1 + late(i)))), 3);
        // Odometry that stalls and then catches up.
        let stalls = |i: i32| (walk(i).0, walk(if (45..50).contains(&i) { 44 } else { i }).1);
        assert_eq!(jumps((0..100).map(stalls)), 0);
    }

    #[test]
    fn a_car_that_starts_and_stamps_in_bursts_are_no_jumps() {
        let car = |i: i32| (0.1 * f64::from(i), 1.5 * (0.1 * f64::from(i)).powi(2));
        assert_eq!(jumps((0..200).map(car)), 0);
        // The same car, at rest before.
        let starts = |i: i32| if i < 100 { (0.1 * f64::from(i), 0.0) } else { (car(i).0, car(i - 100).1) };
        assert_eq!(jumps((0..300).map(starts)), 0);
        let bursts = |i: i32| (0.6 * f64::from(i / 3) + 0.002 * f64::from(i % 3), 0.2 * f64::from(i));
        assert_eq!(jumps((0..200).map(bursts)), 0);
    }
}
