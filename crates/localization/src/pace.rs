//! How fast the scanner moves, and steps that it cannot have made.

use portolan_geometry::{Rigid3, Time};

/// Speeds are those over at least so many seconds: stamps come in bursts.
const SPAN: f64 = 1.0;
/// Nothing that has moved for so many such spans moves so many times as fast all at once, by so many metres at least: it was
/// carried while nothing was recorded, or its odometry was reset.
const SPANS: u32 = 5;
const TIMES_AS_FAST: f64 = 3.0;
const SHORTEST_JUMP: f64 = 2.0;

/// The fastest that the scanner has been.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pace {
    /// Metres per second, and over how many spans it was looked at.
    fastest: f64,
    spans: u32,
    /// Where the span began that goes on.
    since: Option<(Time, Rigid3)>,
    last: Option<(Time, Rigid3)>,
}

impl Pace {
    /// Whether a scan lies where the scanner cannot have come since the last one; the way is then taken to begin anew.
    pub fn is_jump(&mut self, time: Time, local_from_scan: &Rigid3) -> bool {
        let here = (time, *local_from_scan);
        let (step, seconds) = self.last.map_or((0.0, 0.0), |last| motion(&last, &here));
        self.last = Some(here);
        let farthest = TIMES_AS_FAST * self.fastest * seconds.max(SPAN);
        if self.spans >= SPANS && step > farthest.max(SHORTEST_JUMP) {
            self.since = Some(here);
            return true;
        }
        let (way, seconds) = motion(self.since.get_or_insert(here), &here);
        if seconds >= SPAN {
            self.fastest = self.fastest.max(way / seconds);
            self.spans += 1;
            self.since = Some(here);
        }
        false
    }
}

/// Metres and seconds from one place to another one.
fn motion(from: &(Time, Rigid3), to: &(Time, Rigid3)) -> (f64, f64) {
    let way = to.1.translation.vector - from.1.translation.vector;
    (way.norm(), to.0.seconds_since(from.0))
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
    fn a_car_that_starts_and_stamps_in_bursts_are_no_jumps() {
        let car = |i: i32| (0.1 * f64::from(i), 1.5 * (0.1 * f64::from(i)).powi(2));
        assert_eq!(jumps((0..200).map(car)), 0);
        let bursts = |i: i32| (0.6 * f64::from(i / 3) + 0.002 * f64::from(i % 3), 0.2 * f64::from(i));
        assert_eq!(jumps((0..200).map(bursts)), 0);
    }
}
