//! Degenerate intervals of a trajectory: where scans left a direction unconstrained, as in long bare corridors, tunnels and
//! open fields.

use portolan_geometry::{Duration, Time, Vector3};

/// More intervals are counted with the last one, which bounds memory.
const MAX_INTERVALS: usize = 10_000;

/// A component of motion that scans do not constrain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DegenerateMotion {
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

impl DegenerateMotion {
    /// All of them, in the order in which they are reported.
    pub const ALL: [Self; 5] = [Self::Along, Self::Across, Self::Up, Self::Heading, Self::Tilt];

    /// Whether it is a turn.
    pub fn is_rotation(self) -> bool {
        matches!(self, Self::Heading | Self::Tilt)
    }

    /// In words, after "do not constrain".
    pub fn name(self) -> &'static str {
        match self {
            Self::Along => "motion along the direction of travel",
            Self::Across => "motion across the direction of travel",
            Self::Up => "vertical motion",
            Self::Heading => "heading",
            Self::Tilt => "roll and pitch",
        }
    }
}

/// What was taken where scans constrained nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Substitute {
    /// What odometry measured.
    Odometry,
    /// What a gyroscope measured.
    Gyroscope,
    /// That it stands: the IMU is at rest.
    Rest,
    /// The velocity before, changed as an accelerometer measured.
    Accelerometer,
    /// What correlation of what stands upright tells against sweeps about a second before.
    Correlation,
    /// That it moves on as it did before: nothing measured it.
    Velocity,
}

impl Substitute {
    /// In words, before "was used".
    pub fn name(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::Gyroscope => "the gyroscope",
            Self::Rest => "a zero-velocity update",
            Self::Accelerometer => "the accelerometer",
            Self::Correlation => "correlation of what stands upright",
            Self::Velocity => "constant velocity",
        }
    }
}

/// An interval in which scans left a direction unconstrained, and the prediction decided there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DegenerateInterval {
    /// Time of the first such scan.
    pub start: Time,
    /// Time of the last one.
    pub end: Time,
    /// How many there were.
    pub scans: u64,
    /// How long they took together, seconds.
    pub seconds: f64,
    /// What was not constrained.
    pub motion: DegenerateMotion,
    /// What was taken for it.
    pub taken: Substitute,
    /// Standard deviation of the error that has gathered at the end, metres or radians; none where it is not known.
    pub sigma: Option<f64>,
    /// The direction or axis in the tracking frame, unit length, of the first such scan.
    pub direction_in_tracking: Vector3,
}

/// One scan that left a direction unconstrained.
#[derive(Clone, Copy, Debug)]
pub struct DegenerateScan {
    /// When it was taken.
    pub time: Time,
    /// Since the scan before.
    pub seconds: f64,
    /// What was taken for what it left open.
    pub taken: Substitute,
    /// Standard deviation of that, metres or radians; none where it is not known.
    pub sigma: Option<f64>,
}

/// Joins degenerate scans to intervals.
#[derive(Clone, Debug)]
pub struct DegenerateIntervals {
    /// Slower, m/s, it may as well stand: the direction of motion is not known anew.
    resting_speed: f64,
    /// Velocities are averaged over about this long, seconds, as accelerations are; scans farther apart than this belong to
    /// different intervals.
    averaged_over: f64,
    intervals: Vec<DegenerateInterval>,
    /// The horizontal direction in which it last went, in the tracking frame.
    heading: Option<Vector3>,
    /// m/s, in the tracking frame, averaged.
    velocity: Vector3,
}

impl DegenerateIntervals {
    /// None so far. A platform that is slower than `resting_speed`, m/s, may as well stand; velocities are averaged over
    /// `averaged_over` seconds, and scans farther apart than this belong to different intervals.
    pub fn new(resting_speed: f64, averaged_over: f64) -> Self {
        Self {
            resting_speed,
            averaged_over,
            intervals: Vec::new(),
            heading: None,
            velocity: Vector3::zeros(),
        }
    }

    /// Takes notice of how it moved within some seconds: translation (metres) and the direction up, both in the tracking
    /// frame.
    pub fn moved(&mut self, translation: &Vector3, seconds: f64, up: &Vector3) {
        let weight = (seconds / self.averaged_over).min(1.0);
        self.velocity = self.velocity * (1.0 - weight) + translation * (weight / seconds.max(1e-9));
        let level = self.velocity - up * self.velocity.dot(up);
        if level.norm() > self.resting_speed {
            self.heading = level.try_normalize(0.0).or(self.heading);
        }
    }

    /// Counts a scan that left translations along these directions (orthonormal, in the tracking frame) unconstrained.
    pub fn add_translations(&mut self, scan: &DegenerateScan, directions: &[Vector3], up: &Vector3) {
        let forward = self.heading.unwrap_or_else(Vector3::x);
        let along = (forward - up * forward.dot(up)).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes = [
            (DegenerateMotion::Along, along),
            (DegenerateMotion::Across, up.cross(&along)),
            (DegenerateMotion::Up, *up),
        ];
        self.add_nearest(scan, directions, &axes);
    }

    /// Counts a scan that left rotations about these axes (orthonormal, in the tracking frame) unconstrained.
    pub fn add_rotations(&mut self, scan: &DegenerateScan, directions: &[Vector3], up: &Vector3) {
        let along = up.cross(&Vector3::y()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes = [
            (DegenerateMotion::Heading, *up),
            (DegenerateMotion::Tilt, along),
            (DegenerateMotion::Tilt, up.cross(&along)),
        ];
        self.add_nearest(scan, directions, &axes);
    }

    /// As many of the axes as there are degenerate directions: those that lie nearest to the space that these span.
    /// Which directions span it is chance.
    fn add_nearest(
        &mut self,
        scan: &DegenerateScan,
        directions: &[Vector3],
        axes: &[(DegenerateMotion, Vector3); 3],
    ) {
        let nearness = |axis: &Vector3| directions.iter().map(|o| o.dot(axis).powi(2)).sum::<f64>();
        let mut by_nearness: Vec<(f64, &(DegenerateMotion, Vector3))> =
            axes.iter().map(|axis| (nearness(&axis.1), axis)).collect();
        by_nearness.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, (motion, axis)) in by_nearness.into_iter().take(directions.len()) {
            self.add(scan, *motion, axis);
        }
    }

    fn add(&mut self, scan: &DegenerateScan, motion: DegenerateMotion, direction: &Vector3) {
        let DegenerateScan { time, seconds, taken, sigma } = *scan;
        // More are counted with the last one, so that memory is bounded.
        let full = self.intervals.len() >= MAX_INTERVALS;
        let gap = Duration::from_seconds(self.averaged_over);
        let last = self.intervals.iter_mut().rev().find(|s| s.motion == motion && s.taken == taken);
        match last.filter(|interval| full || time - interval.end <= gap) {
            // Both ways to tilt count once.
            Some(interval) if interval.end == time => {}
            Some(interval) => {
                interval.scans += 1;
                interval.seconds += seconds;
                interval.end = time.max(interval.end);
                interval.sigma = interval.sigma.zip(sigma).map(|(gathered, sigma)| gathered.hypot(sigma));
            }
            None if full => {}
            None => {
                let (start, end, scans, direction_in_tracking) = (time, time, 1, *direction);
                self.intervals.push(DegenerateInterval {
                    start,
                    end,
                    scans,
                    seconds,
                    motion,
                    taken,
                    sigma,
                    direction_in_tracking,
                });
            }
        }
    }

    /// All intervals in order of their beginning.
    pub fn all(&self) -> &[DegenerateInterval] {
        &self.intervals
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intervals() -> DegenerateIntervals {
        DegenerateIntervals::new(0.02, 1.0)
    }

    fn scan(t: f64) -> DegenerateScan {
        let time = Time::from_ticks((t * 1e7) as i64);
        DegenerateScan { time, seconds: 0.1, taken: Substitute::Odometry, sigma: Some(0.02) }
    }

    #[test]
    fn scans_of_one_corridor_are_one_interval() {
        let mut found = intervals();
        // It goes to the left of the sensor.
        found.moved(&Vector3::new(0.0, 1.2, 0.3), 1.0, &Vector3::z());
        for i in 0..30 {
            found.add_translations(&scan(0.1 * f64::from(i)), &[Vector3::y()], &Vector3::z());
        }
        found.add_rotations(&scan(2.9), &[Vector3::x(), Vector3::y()], &Vector3::z());
        found.add_translations(&scan(60.0), &[-Vector3::y()], &Vector3::z());
        let counted: Vec<(DegenerateMotion, u64)> = found.all().iter().map(|s| (s.motion, s.scans)).collect();
        assert_eq!(
            counted,
            [(DegenerateMotion::Along, 30), (DegenerateMotion::Tilt, 1), (DegenerateMotion::Along, 1)]
        );
        assert!((found.all()[0].seconds - 3.0).abs() < 1e-9);
        // Thirty scans, each 0.02 m.
        assert!((found.all()[0].sigma.unwrap() - 0.02 * 30f64.sqrt()).abs() < 1e-9);
        let most = MAX_INTERVALS;
        for i in 0..3 * most {
            found.add_rotations(&scan(100.0 + 10.0 * i as f64), &[Vector3::z()], &Vector3::z());
        }
        assert_eq!(found.all().len(), most);
    }

    #[test]
    fn in_a_field_all_of_the_plane_is_open_however_it_is_spanned() {
        let mut found = intervals();
        let (a, b) = (Vector3::new(0.6, 0.8, 0.0), Vector3::new(-0.8, 0.6, 0.0));
        found.add_translations(&scan(0.0), &[a, b], &Vector3::z());
        // A slope leaves hardly anything of the vertical open.
        let steep = Vector3::new(0.9, 0.0, 0.436);
        found.add_translations(&scan(9.0), &[steep], &Vector3::z());
        let motions: Vec<DegenerateMotion> = found.all().iter().map(|s| s.motion).collect();
        assert_eq!(motions, [DegenerateMotion::Along, DegenerateMotion::Across, DegenerateMotion::Along]);
    }
}
