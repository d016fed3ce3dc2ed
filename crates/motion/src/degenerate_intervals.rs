//! Degenerate intervals of a trajectory: where scans do not constrain a direction, as in long bare
//! corridors, tunnels and open fields.

use portolan_geometry::{Duration, Time, Vector3};

/// Maximum number of intervals, which bounds memory; further degenerate scans are counted with the last one.
const MAX_INTERVALS: usize = 10_000;

/// A component of motion that scans do not constrain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DegenerateMotion {
    /// Translation in the direction of travel.
    Along,
    /// Sideways translation.
    Across,
    /// Vertical translation.
    Up,
    /// Rotation about the vertical.
    Heading,
    /// Roll or pitch.
    Tilt,
}

impl DegenerateMotion {
    /// All of them, in the order in which they are reported.
    pub const ALL: [Self; 5] = [Self::Along, Self::Across, Self::Up, Self::Heading, Self::Tilt];

    /// Whether it is a rotation.
    pub fn is_rotation(self) -> bool {
        matches!(self, Self::Heading | Self::Tilt)
    }

    /// Its name in words, after "do not constrain".
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

/// Source of the motion where scans do not constrain it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Substitute {
    /// Measurement of odometry.
    Odometry,
    /// Measurement of a gyroscope.
    Gyroscope,
    /// Zero-velocity update: the IMU is at rest.
    Rest,
    /// Previous velocity, changed by the measurement of an accelerometer.
    Accelerometer,
    /// Correlation of vertical structures with sweeps about a second before.
    Correlation,
    /// Constant velocity: the motion is unmeasured.
    Velocity,
}

impl Substitute {
    /// Its name in words, before "was used".
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

/// An interval in which scans did not constrain a direction, so that the prediction determined it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DegenerateInterval {
    /// Time of the first such scan.
    pub start: Time,
    /// Time of the last one.
    pub end: Time,
    /// Number of degenerate scans.
    pub scans: u64,
    /// Sum of their durations, seconds.
    pub seconds: f64,
    /// Component of motion that was not constrained.
    pub motion: DegenerateMotion,
    /// Source that was used for it instead.
    pub taken: Substitute,
    /// Standard deviation of the accumulated error at the end, metres or radians; none where it is unknown.
    pub sigma: Option<f64>,
    /// Direction or axis in the tracking frame, unit length, of the first such scan.
    pub direction_in_tracking: Vector3,
}

/// A scan that does not constrain a direction.
#[derive(Clone, Copy, Debug)]
pub struct DegenerateScan {
    /// When it was taken.
    pub time: Time,
    /// Time since the scan before, seconds.
    pub seconds: f64,
    /// Source that was used for the degenerate directions.
    pub taken: Substitute,
    /// Standard deviation of its motion, metres or radians; none where it is unknown.
    pub sigma: Option<f64>,
}

/// Joins degenerate scans to intervals.
#[derive(Clone, Debug)]
pub struct DegenerateIntervals {
    /// Speed below which the platform may be at rest, m/s: the direction of motion is then not updated.
    resting_speed: f64,
    /// Approximate time over which velocities are averaged, seconds, as for accelerations. Scans farther
    /// apart belong to different intervals.
    averaged_over: f64,
    intervals: Vec<DegenerateInterval>,
    /// The last known horizontal direction of motion, in the tracking frame.
    heading: Option<Vector3>,
    /// Averaged velocity in the tracking frame, m/s.
    velocity: Vector3,
}

impl DegenerateIntervals {
    /// Without intervals. A platform slower than `resting_speed`, m/s, may be at rest. Velocities are
    /// averaged over `averaged_over` seconds, and scans farther apart belong to different intervals.
    pub fn new(resting_speed: f64, averaged_over: f64) -> Self {
        Self {
            resting_speed,
            averaged_over,
            intervals: Vec::new(),
            heading: None,
            velocity: Vector3::zeros(),
        }
    }

    /// Takes the motion during some seconds: translation (metres) and the direction up, both in the tracking
    /// frame.
    pub fn moved(&mut self, translation: &Vector3, seconds: f64, up: &Vector3) {
        let weight = (seconds / self.averaged_over).min(1.0);
        self.velocity = self.velocity * (1.0 - weight) + translation * (weight / seconds.max(1e-9));
        let level = self.velocity - up * self.velocity.dot(up);
        if level.norm() > self.resting_speed {
            self.heading = level.try_normalize(0.0).or(self.heading);
        }
    }

    /// Counts a scan that does not constrain translations along these directions (orthonormal, in the
    /// tracking frame).
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

    /// Counts a scan that does not constrain rotations about these axes (orthonormal, in the tracking
    /// frame).
    pub fn add_rotations(&mut self, scan: &DegenerateScan, directions: &[Vector3], up: &Vector3) {
        let along = up.cross(&Vector3::y()).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let axes = [
            (DegenerateMotion::Heading, *up),
            (DegenerateMotion::Tilt, along),
            (DegenerateMotion::Tilt, up.cross(&along)),
        ];
        self.add_nearest(scan, directions, &axes);
    }

    /// Counts as many of the axes as there are degenerate directions: those nearest to the space that the
    /// directions span. Which basis of that space they form is arbitrary.
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
        // Further ones are counted with the last one, so that memory is bounded.
        let full = self.intervals.len() >= MAX_INTERVALS;
        let gap = Duration::from_seconds(self.averaged_over);
        let last = self.intervals.iter_mut().rev().find(|s| s.motion == motion && s.taken == taken);
        match last.filter(|interval| full || time - interval.end <= gap) {
            // Both tilt axes count once.
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

    /// All intervals in order of their start.
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
        // The platform moves to the left of the sensor.
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
    fn in_open_country_both_horizontal_translations_are_degenerate() {
        let mut found = intervals();
        let (a, b) = (Vector3::new(0.6, 0.8, 0.0), Vector3::new(-0.8, 0.6, 0.0));
        found.add_translations(&scan(0.0), &[a, b], &Vector3::z());
        // On a slope, hardly any of the degenerate direction is vertical.
        let steep = Vector3::new(0.9, 0.0, 0.436);
        found.add_translations(&scan(9.0), &[steep], &Vector3::z());
        let motions: Vec<DegenerateMotion> = found.all().iter().map(|s| s.motion).collect();
        assert_eq!(motions, [DegenerateMotion::Along, DegenerateMotion::Across, DegenerateMotion::Along]);
    }
}
