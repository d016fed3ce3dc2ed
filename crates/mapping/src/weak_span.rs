//! Stretches of a trajectory in which scans did not hold in every direction: long bare corridors, tunnels,
//! open fields.

use portolan_geometry::{Duration, Time, Vector3};

/// Scans further apart than this belong to different stretches.
const GAP: Duration = Duration::from_ticks(20_000_000);
/// More stretches are counted with the last one, so that memory is bounded.
const MAX_SPANS: usize = 10_000;
/// Slower than this no direction of the way is told, m/s; velocities are averaged over about this long, seconds.
const SLOW: f64 = 0.1;
const AVERAGED_OVER: f64 = 1.0;

/// What scans do not tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum WeakMotion {
    /// How far it goes in the direction in which it goes.
    Along,
    /// How far it goes sideways.
    Across,
    /// How far it goes up or down.
    Up,
    /// How far it turns about the vertical.
    Heading,
    /// How far it rolls or pitches.
    Tilt,
}

impl WeakMotion {
    /// All of them, in the order in which they are told.
    pub const ALL: [Self; 5] = [Self::Along, Self::Across, Self::Up, Self::Heading, Self::Tilt];

    /// In words, after "did not tell".
    pub fn name(self) -> &'static str {
        match self {
            Self::Along => "movement along the way",
            Self::Across => "movement across the way",
            Self::Up => "movement up and down",
            Self::Heading => "heading",
            Self::Tilt => "tilt",
        }
    }
}

/// What was taken where scans told nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TakenInstead {
    /// What odometry measured.
    Odometry,
    /// What a gyroscope measured.
    Gyroscope,
    /// That it stands: the IMU is at rest.
    Rest,
    /// The velocity before, changed as an accelerometer measured.
    Accelerometer,
    /// That it moves on as it did before: nothing measured it.
    Velocity,
}

impl TakenInstead {
    /// In words, after a number of seconds or before "was taken".
    pub fn name(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::Gyroscope => "the gyroscope",
            Self::Rest => "rest, as the IMU felt it,",
            Self::Accelerometer => "the accelerometer",
            Self::Velocity => "the velocity before, which nothing measured,",
        }
    }
}

/// A stretch of time in which scans left a direction open, and the prediction decided there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeakSpan {
    /// Time of the first such scan.
    pub start: Time,
    /// Time of the last one.
    pub end: Time,
    /// How many there were.
    pub scans: u64,
    /// How long they took together, seconds.
    pub seconds: f64,
    /// What was open.
    pub motion: WeakMotion,
    /// What was taken for it.
    pub taken: TakenInstead,
    /// The direction or axis in the tracking frame, unit length, of the first such scan.
    pub direction_in_tracking: Vector3,
}

/// One scan that left a direction open.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WeakScan {
    pub time: Time,
    /// Since the scan before.
    pub seconds: f64,
    pub taken: TakenInstead,
}

/// Joins scans to stretches.
#[derive(Clone, Debug, Default)]
pub struct WeakSpans {
    spans: Vec<WeakSpan>,
    /// The horizontal direction in which it last went, in the tracking frame.
    way: Option<Vector3>,
    /// m/s, in the tracking frame, averaged.
    velocity: Vector3,
}

impl WeakSpans {
    /// Takes notice of how it moved within some seconds: shift (metres) and the direction up, both in the
    /// tracking frame.
    pub(crate) fn moved(&mut self, shift: &Vector3, seconds: f64, up: &Vector3) {
        let share = (seconds / AVERAGED_OVER).min(1.0);
        self.velocity = self.velocity * (1.0 - share) + shift * (share / seconds.max(1e-9));
        let level = self.velocity - up * self.velocity.dot(up);
        if level.norm() > SLOW {
            self.way = level.try_normalize(0.0).or(self.way);
        }
    }

    /// Counts a scan that left shifts along these directions (orthonormal, in the tracking frame) open.
    pub(crate) fn add_shifts(&mut self, scan: &WeakScan, open: &[Vector3], up: &Vector3) {
        let forward = self.way.unwrap_or_else(Vector3::x);
        let along = (forward - up * forward.dot(up)).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes =
            [(WeakMotion::Along, along), (WeakMotion::Across, up.cross(&along)), (WeakMotion::Up, *up)];
        self.add_nearest(scan, open, &axes);
    }

    /// Counts a scan that left turns about these axes (orthonormal, in the tracking frame) open.
    pub(crate) fn add_turns(&mut self, scan: &WeakScan, open: &[Vector3], up: &Vector3) {
        let along = up.cross(&Vector3::y()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes =
            [(WeakMotion::Heading, *up), (WeakMotion::Tilt, along), (WeakMotion::Tilt, up.cross(&along))];
        self.add_nearest(scan, open, &axes);
    }

    /// As many of the axes as there are open directions: those that lie nearest to the space that these span.
    /// Which directions span it is chance.
    fn add_nearest(&mut self, scan: &WeakScan, open: &[Vector3], axes: &[(WeakMotion, Vector3); 3]) {
        let openness = |axis: &Vector3| open.iter().map(|o| o.dot(axis).powi(2)).sum::<f64>();
        let mut by_openness: Vec<(f64, &(WeakMotion, Vector3))> =
            axes.iter().map(|axis| (openness(&axis.1), axis)).collect();
        by_openness.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, (motion, axis)) in by_openness.into_iter().take(open.len()) {
            self.add(scan, *motion, axis);
        }
    }

    fn add(&mut self, scan: &WeakScan, motion: WeakMotion, direction: &Vector3) {
        let WeakScan { time, seconds, taken } = *scan;
        let full = self.spans.len() >= MAX_SPANS;
        let last = self.spans.iter_mut().rev().find(|s| s.motion == motion && s.taken == taken);
        match last.filter(|span| full || time - span.end <= GAP) {
            // Both ways to tilt count once.
            Some(span) if span.end == time => {}
            Some(span) => {
                span.scans += 1;
                span.seconds += seconds;
                span.end = time.max(span.end);
            }
            None if full => {}
            None => {
                let (start, end, scans, direction_in_tracking) = (time, time, 1, *direction);
                self.spans.push(WeakSpan {
                    start,
                    end,
                    scans,
                    seconds,
                    motion,
                    taken,
                    direction_in_tracking,
                });
            }
        }
    }

    /// All stretches in order of their beginning.
    pub fn spans(&self) -> &[WeakSpan] {
        &self.spans
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(t: f64) -> WeakScan {
        let time = Time::from_ticks((t * 1e7) as i64);
        WeakScan { time, seconds: 0.1, taken: TakenInstead::Odometry }
    }

    #[test]
    fn scans_of_one_corridor_are_one_stretch() {
        let mut spans = WeakSpans::default();
        // It goes to the left of the sensor.
        spans.moved(&Vector3::new(0.0, 1.2, 0.3), 1.0, &Vector3::z());
        for i in 0..30 {
            spans.add_shifts(&scan(0.1 * f64::from(i)), &[Vector3::y()], &Vector3::z());
        }
        spans.add_turns(&scan(2.9), &[Vector3::x(), Vector3::y()], &Vector3::z());
        spans.add_shifts(&scan(60.0), &[-Vector3::y()], &Vector3::z());
        let found: Vec<(WeakMotion, u64)> = spans.spans().iter().map(|s| (s.motion, s.scans)).collect();
        assert_eq!(found, [(WeakMotion::Along, 30), (WeakMotion::Tilt, 1), (WeakMotion::Along, 1)]);
        assert!((spans.spans()[0].seconds - 3.0).abs() < 1e-9);
        for i in 0..3 * MAX_SPANS {
            spans.add_turns(&scan(100.0 + 10.0 * i as f64), &[Vector3::z()], &Vector3::z());
        }
        assert_eq!(spans.spans().len(), MAX_SPANS);
    }

    #[test]
    fn in_a_field_all_of_the_plane_is_open_however_it_is_spanned() {
        let mut spans = WeakSpans::default();
        let (a, b) = (Vector3::new(0.6, 0.8, 0.0), Vector3::new(-0.8, 0.6, 0.0));
        spans.add_shifts(&scan(0.0), &[a, b], &Vector3::z());
        // A slope leaves hardly anything of the vertical open.
        let steep = Vector3::new(0.9, 0.0, 0.436);
        spans.add_shifts(&scan(9.0), &[steep], &Vector3::z());
        let motions: Vec<WeakMotion> = spans.spans().iter().map(|s| s.motion).collect();
        assert_eq!(motions, [WeakMotion::Along, WeakMotion::Across, WeakMotion::Along]);
    }
}
