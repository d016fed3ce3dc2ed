//! Laser scans as timed points in the frame of the scanner.

use portolan_geometry::{Point3f, Time};
use portolan_recording::{LaserScan, MultiEchoLaserScan};
use portolan_sensor::TimedPoint;

use crate::beam_smoothing::BeamSmoothing;
use crate::timed_points::TimedPoints;

/// Range above which a reading is not a distance, metres.
const HUGE: f32 = 1e6;
/// Maximum duration of a scan, seconds.
const LONGEST_SCAN: f32 = 10.0;

/// Faults in the readings and limits of a scan, and how they were repaired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ScanFaults {
    /// Readings that are not a number: taken as no return.
    pub nan_readings: u64,
    /// Readings below zero, except minus infinity, which means "too near".
    pub negative_readings: u64,
    /// Readings beyond 1,000 km that are not infinite.
    pub huge_readings: u64,
    /// `range_min > range_max`, or not numbers: the limits are not used.
    pub bad_limits: bool,
    /// `angle_increment` is zero, not a number or has the opposite sign of the span of the limits.
    pub bad_increment: bool,
    /// `time_increment` is negative, not a number or makes the scan longer than 10 s: taken as zero.
    pub bad_time_increment: bool,
}

/// Fields that a laser scan and a multi-echo scan have in common.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanShape {
    pub angle_min: f32,
    pub angle_max: f32,
    pub angle_increment: f32,
    pub time_increment: f32,
    pub range_min: f32,
    pub range_max: f32,
    pub beams: usize,
}

impl ScanShape {
    pub fn of<R>(scan: &LaserScan<R>) -> Self {
        Self {
            angle_min: scan.angle_min,
            angle_max: scan.angle_max,
            angle_increment: scan.angle_increment,
            time_increment: scan.time_increment,
            range_min: scan.range_min,
            range_max: scan.range_max,
            beams: scan.ranges.len(),
        }
    }

    /// Sets the duration from the first beam to the last, seconds; negative if the last beam comes first.
    fn take(&mut self, seconds: f64) {
        self.time_increment = (seconds / self.beams.saturating_sub(1).max(1) as f64) as f32;
    }

    /// Makes the shape usable and reports its faults.
    pub fn repair(&mut self) -> ScanFaults {
        let mut faults = ScanFaults::default();
        if !self.angle_min.is_finite() {
            (self.angle_min, faults.bad_increment) = (0.0, true);
        }
        let (increment, span) = (self.angle_increment, self.angle_max - self.angle_min);
        if self.beams > 1 && (!increment.is_finite() || increment == 0.0) {
            faults.bad_increment = true;
            self.angle_increment = if span.is_finite() { span / (self.beams - 1) as f32 } else { 0.0 };
        } else if self.beams > 1 && span.is_finite() && span * increment < 0.0 {
            // Which of the two is wrong is unknown; drivers compute with the increment.
            faults.bad_increment = true;
        }
        if self.range_min < 0.0 || self.range_min.is_nan() {
            (self.range_min, faults.bad_limits) = (0.0, true);
        }
        if self.range_max.is_nan() || self.range_max < self.range_min || self.range_max <= 0.0 {
            (self.range_min, self.range_max, faults.bad_limits) = (0.0, f32::INFINITY, true);
        }
        let duration = self.time_increment * self.beams as f32;
        if !duration.is_finite() || self.time_increment < 0.0 || duration > LONGEST_SCAN {
            (self.time_increment, faults.bad_time_increment) = (0.0, true);
        }
        faults
    }
}

/// Sines and cosines of the beams, computed once per scanner.
#[derive(Clone, Debug, Default)]
pub struct BeamDirections {
    key: Option<(u32, u32, usize)>,
    directions: Vec<(f32, f32)>,
}

impl BeamDirections {
    /// Directions of beams `angle_min`, `angle_min + increment`, …, summed up in `f32`
    /// (`spec/slam2d.md` §1).
    fn of(&mut self, shape: &ScanShape) -> &[(f32, f32)] {
        let key = (shape.angle_min.to_bits(), shape.angle_increment.to_bits(), shape.beams);
        if self.key != Some(key) {
            let mut angle = shape.angle_min;
            self.directions.clear();
            for _ in 0..shape.beams {
                let (sin, cos) = angle.sin_cos();
                self.directions.push((cos, sin));
                angle += shape.angle_increment;
            }
            self.key = Some(key);
        }
        &self.directions
    }
}

/// Converts the readings of a scan within its limits to points in the frame of the scanner. Times of points
/// count to the last of them, whose time is that of the result (`spec/slam2d.md` §1).
///
/// `readings` gives range and intensity of each beam; a `duration` replaces that of the scan.
pub(crate) fn points_of_scan(
    stamp: Time,
    (mut shape, duration): (ScanShape, Option<f64>),
    readings: impl Iterator<Item = (f32, f32)>,
    with_intensities: bool,
    directions: &mut BeamDirections,
) -> (TimedPoints, ScanFaults) {
    let mut faults = shape.repair();
    if let Some(seconds) = duration {
        shape.take(seconds);
    }
    // The stamp is the time of the beam that is measured first (sensor_msgs/LaserScan), which may be the last
    // of the scan.
    let of_first = (-shape.time_increment * shape.beams.saturating_sub(1) as f32).max(0.0);
    let directions = directions.of(&shape);
    let mut result = TimedPoints::with_capacity(shape.beams, with_intensities);
    for (i, ((range, intensity), (cos, sin))) in readings.zip(directions).enumerate() {
        if shape.range_min <= range && range <= shape.range_max && range < HUGE {
            let position = Point3f::new(cos * range, sin * range, 0.0);
            result.points.push(TimedPoint { position, time: of_first + i as f32 * shape.time_increment });
            if with_intensities {
                result.intensities.push(intensity);
            }
        } else {
            faults.nan_readings += u64::from(range.is_nan());
            faults.negative_readings += u64::from(range < 0.0 && range.is_finite());
            faults.huge_readings += u64::from(range.is_finite() && range >= HUGE);
        }
    }
    result.rebase(stamp);
    (result, faults)
}

/// Corrections of a scan that are known better than from its message.
#[derive(Clone, Copy, Debug, Default)]
pub struct ScanCorrections {
    /// Seconds from the first beam to the last, negative if the last comes first; none: as in the message.
    pub duration: Option<f64>,
    /// Smoothing of noisy readings.
    pub smoothing: Option<BeamSmoothing>,
}

/// Converts the readings of a scan within its limits to points in the frame of the scanner, and reports the
/// faults of the scan. Times of points count to the last of them, whose time is that of the result
/// (`spec/slam2d.md` §1). `stamp` replaces that of the message, and `directions` are kept from scan to scan.
pub fn points_of_laser_scan(
    stamp: Time,
    (scan, corrections): (&LaserScan, ScanCorrections),
    with_intensities: bool,
    directions: &mut BeamDirections,
) -> (TimedPoints, ScanFaults) {
    let intensity = |i: usize| scan.intensities.get(i).copied().unwrap_or(0.0);
    let limits = [scan.range_min, scan.range_max];
    let smoothed = corrections.smoothing.map(|s| s.smoothed(&scan.ranges, scan.angle_increment, limits));
    let ranges = smoothed.as_ref().unwrap_or(&scan.ranges);
    let readings = ranges.iter().enumerate().map(|(i, range)| (*range, intensity(i)));
    let shape = (ScanShape::of(scan), corrections.duration);
    points_of_scan(stamp, shape, readings, with_intensities, directions)
}

/// As [`points_of_laser_scan`], of the first echo of every beam.
pub fn points_of_echoes(
    stamp: Time,
    (scan, duration): (&MultiEchoLaserScan, Option<f64>),
    with_intensities: bool,
    directions: &mut BeamDirections,
) -> (TimedPoints, ScanFaults) {
    let first = |echoes: Option<&Vec<f32>>| echoes.and_then(|e| e.first().copied());
    // A beam without any echo has no return; that is not a fault.
    let readings = scan.ranges.iter().enumerate().map(|(i, echoes)| {
        (first(Some(echoes)).unwrap_or(f32::INFINITY), first(scan.intensities.get(i)).unwrap_or(0.0))
    });
    points_of_scan(stamp, (ScanShape::of(scan), duration), readings, with_intensities, directions)
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_recording::Header;
    use std::f32::consts::{FRAC_PI_4, PI};

    fn scan(ranges: Vec<f32>) -> LaserScan {
        LaserScan {
            header: Header { stamp: Time::UNIX_EPOCH, frame_id: "laser".into() },
            angle_min: 0.0,
            angle_max: 2.0 * PI,
            angle_increment: FRAC_PI_4,
            time_increment: 0.0,
            scan_time: 0.0,
            range_min: 0.0,
            range_max: 10.0,
            ranges,
            intensities: Vec::new(),
        }
    }

    fn convert(scan: &LaserScan) -> (TimedPoints, ScanFaults) {
        points_of_laser_scan(
            scan.header.stamp,
            (scan, ScanCorrections::default()),
            false,
            &mut BeamDirections::default(),
        )
    }

    #[test]
    fn eight_unit_directions() {
        let (points, faults) = convert(&scan(vec![1.0; 8]));
        let d = 0.5f32.sqrt();
        let expected = [(1.0, 0.0), (d, d), (0.0, 1.0), (-d, d), (-1.0, 0.0), (-d, -d), (0.0, -1.0), (d, -d)];
        for (point, (x, y)) in points.points.iter().zip(expected) {
            assert!((point.position - Point3f::new(x, y, 0.0)).norm() < 1e-6);
            assert_eq!(point.time, 0.0);
        }
        assert_eq!((points.points.len(), faults), (8, ScanFaults::default()));
    }

    #[test]
    fn readings_beyond_the_limits_are_dropped() {
        let mut message = scan(vec![1.0, f32::INFINITY, 2.0, f32::NAN, 3.0]);
        message.range_min = 2.0;
        let (points, faults) = convert(&message);
        let positions: Vec<Point3f> = points.points.iter().map(|p| p.position).collect();
        assert_eq!(positions.len(), 2);
        assert!((positions[0] - Point3f::new(0.0, 2.0, 0.0)).norm() < 1e-6);
        assert!((positions[1] - Point3f::new(-3.0, 0.0, 0.0)).norm() < 1e-6);
        assert_eq!(faults.nan_readings, 1);
    }

    #[test]
    fn times_count_to_the_last_kept_point() {
        let mut message = scan(vec![1.0, 1.0, 1.0, 99.0]);
        message.time_increment = 0.01;
        let (points, _) = convert(&message);
        assert_eq!(
            points.time,
            Time::UNIX_EPOCH + portolan_geometry::Duration::from_seconds(f64::from(0.02f32))
        );
        let times: Vec<f32> = points.points.iter().map(|p| p.time).collect();
        assert_eq!(times, [-0.02, -0.01, 0.0]);
    }

    #[test]
    fn a_measured_duration_replaces_that_of_the_scan() {
        let mut message = scan(vec![1.0; 5]);
        message.time_increment = 0.3;
        let times = |duration| {
            let mut directions = BeamDirections::default();
            let stamp = message.header.stamp;
            let how = ScanCorrections { duration: Some(duration), smoothing: None };
            let (points, _) = points_of_laser_scan(stamp, (&message, how), false, &mut directions);
            let end = points.time.seconds_since(stamp);
            (end, points.points.iter().map(|p| (p.position.y.signum(), p.time)).collect::<Vec<_>>())
        };
        let (end, forward) = times(0.5);
        assert!((end - 0.5).abs() < 1e-6);
        assert_eq!(forward.iter().map(|p| p.1).collect::<Vec<_>>(), [-0.5, -0.375, -0.25, -0.125, 0.0]);
        // The last beam comes first, at the stamp.
        let (end, backward) = times(-0.5);
        assert!((end - 0.5).abs() < 1e-6);
        assert_eq!(backward.first().map(|p| p.1), Some(-0.5));
        assert!(backward.iter().rev().map(|p| p.0).eq(forward.iter().map(|p| p.0)));
        assert_eq!(times(0.0).0, 0.0);
    }

    #[test]
    fn wrong_limits_and_increments_are_repaired() {
        let mut message = scan(vec![1.0, 5.0, -1.0, 1e9]);
        (message.range_min, message.range_max) = (3.0, 2.0);
        message.angle_increment = 0.0;
        message.time_increment = -1.0;
        let (points, faults) = convert(&message);
        assert_eq!(points.points.len(), 2);
        assert!(faults.bad_limits && faults.bad_increment && faults.bad_time_increment);
        assert_eq!((faults.negative_readings, faults.huge_readings), (1, 1));
        assert!((points.points[1].position.y - 5.0 * (2.0 * PI / 3.0).sin()).abs() < 1e-5);
    }
}
