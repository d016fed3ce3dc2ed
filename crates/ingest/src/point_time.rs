//! Determines the meaning of the time field of a point cloud.
//!
//! Drivers disagree: seconds after the stamp (`time`, Velodyne), nanoseconds after it (`t`, Ouster;
//! `offset_time`, Livox), seconds or nanoseconds of some clock (`timestamp`; Hesai, RoboSense, Livox).
//! Names do not determine it, so the values of the first clouds are used:
//!
//! 1. The values of a cloud span one sweep. The unit (s, ms, µs or ns) is the one that makes the sweep
//!    last closest to the interval between clouds, on a logarithmic scale, but not much longer. Without
//!    an interval, 0.1 s is expected.
//! 2. Values that are far larger than the span are readings of a clock. If they are dates (1973 to 2286) in
//!    one of the units, that unit is right, whatever the span says.
//! 3. A clock that agrees with the stamps to 10 s gives absolute times. Any other clock gives times
//!    after the stamp, the first point being measured at it.
//! 4. A sweep takes about as long as the interval between clouds. Single values far outside it are faults of a
//!    driver: they do not count here, and their points are left out.
//! 5. Values of an integer field that are all equal, and single-precision dates, carry no information: all
//!    points count as measured at the stamp.

use portolan_geometry::Time;
use portolan_recording::FieldType;

/// Names under which drivers give the time of a point, the first one that is there counts.
pub(crate) const TIME_FIELDS: [&str; 7] =
    ["time", "t", "timestamp", "offset_time", "time_stamp", "time_offset", "point_time_offset"];

/// Origin of the values of the time field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointTimeOrigin {
    /// The stamp of the message.
    Stamp,
    /// 1970-01-01, like stamps.
    Epoch,
    /// Another time; the first point is taken to be measured at the stamp.
    OtherClock,
}

/// How to read the time field of a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointTime {
    /// Seconds per unit of the field; negative where values fall with time.
    pub unit: f64,
    /// Origin of the values.
    pub origin: PointTimeOrigin,
    /// Maximum difference from the median time of the cloud, seconds; points beyond it have a wrong time.
    pub reach: f64,
}

/// The time values of one cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TimeSpan {
    pub field_type: FieldType,
    pub stamp: Time,
    /// Smallest and largest value, unscaled, without outliers.
    pub least: f64,
    pub largest: f64,
    /// Largest minus smallest, without loss of digits.
    pub span: f64,
}

impl TimeSpan {
    /// Whether times distinguish points: they are not all equal, and not dates in single precision.
    pub fn is_usable(&self) -> bool {
        self.span > 0.0 && (self.field_type != FieldType::Float32 || self.date_unit().is_none())
    }

    /// The unit in which values are dates, if they are far larger than their span.
    fn date_unit(&self) -> Option<f64> {
        let is_far = self.least.abs().min(self.largest.abs()) > 100.0 * self.span;
        UNITS.into_iter().find(|unit| is_far && (1e8..1e10).contains(&(self.least * unit)))
    }
}

const UNITS: [f64; 4] = [1.0, 1e-3, 1e-6, 1e-9];
/// Interval between sweeps where none is known, seconds.
const USUAL_INTERVAL: f64 = 0.1;
/// Maximum duration of a sweep, as a multiple of the interval between clouds or of the usual duration of
/// sweeps.
const LONGEST_SWEEP: f64 = 2.5;
/// Difference below which a clock counts as that of the stamps, seconds.
const SAME_CLOCK: f64 = 10.0;

/// Determines the meaning of time values from those of the first clouds and the interval between clouds in
/// seconds; `None` if they carry no information.
pub(crate) fn detect(spans: &[TimeSpan], interval: Option<f64>) -> Option<PointTime> {
    let mut by_length: Vec<&TimeSpan> =
        spans.iter().filter(|s| s.span > 0.0 && s.span.is_finite() && s.least.is_finite()).collect();
    by_length.sort_by(|a, b| a.span.total_cmp(&b.span));
    let typical = by_length.get(by_length.len() / 2)?;
    let interval = interval.filter(|i| *i > 0.0).unwrap_or(USUAL_INTERVAL).clamp(1e-3, 10.0);
    let by_span = unit_of_span(typical.span, interval);
    let far = typical.least.abs().min(typical.largest.abs());
    let reach = |unit: f64| LONGEST_SWEEP * interval.max(typical.span * unit);
    if far <= 100.0 * typical.span && far * by_span <= SAME_CLOCK {
        return Some(PointTime { unit: by_span, origin: PointTimeOrigin::Stamp, reach: reach(by_span) });
    }
    let date_unit = UNITS.into_iter().find(|unit| (1e8..1e10).contains(&(typical.least * unit)));
    if date_unit.is_some() && typical.field_type == FieldType::Float32 {
        return None;
    }
    let unit = date_unit.unwrap_or(by_span);
    let same_clock = (typical.least * unit - typical.stamp.unix_seconds()).abs() < SAME_CLOCK;
    let origin = if same_clock { PointTimeOrigin::Epoch } else { PointTimeOrigin::OtherClock };
    Some(PointTime { unit, origin, reach: reach(unit) })
}

fn unit_of_span(span: f64, interval: f64) -> f64 {
    let misfit = |unit: f64| {
        let ratio = (span * unit / interval).ln();
        // Sweeps are not much longer than the interval between them.
        if ratio > 2.5f64.ln() { ratio + 100.0 } else { ratio.abs() }
    };
    UNITS.into_iter().min_by(|a, b| misfit(*a).total_cmp(&misfit(*b))).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use PointTimeOrigin::{Epoch, OtherClock, Stamp};

    fn detected(
        field_type: FieldType,
        least: f64,
        largest: f64,
        interval: f64,
    ) -> Option<(f64, PointTimeOrigin)> {
        let stamp = Time::from_ros(1_700_000_000, 0);
        let span = TimeSpan { field_type, stamp, least, largest, span: largest - least };
        detect(&[span], Some(interval)).map(|t| (t.unit, t.origin))
    }

    #[test]
    fn point_times_of_known_drivers() {
        use FieldType::{Float32, Float64, Uint32};
        let date = 1.7e9;
        for (name, field_type, least, largest, interval, expected) in [
            ("Velodyne", Float32, 0.0, 0.0997, 0.1, Some((1.0, Stamp))),
            ("end of sweep", Float32, -0.0997, 0.0, 0.1, Some((1.0, Stamp))),
            ("Ouster, 20 Hz", Uint32, 0.0, 49_900_000.0, 0.05, Some((1e-9, Stamp))),
            ("Ouster, 5 Hz", Uint32, 0.0, 199_900_000.0, 0.2, Some((1e-9, Stamp))),
            ("Livox", Uint32, 0.0, 99_700_000.0, 0.1, Some((1e-9, Stamp))),
            ("Livox, 500 Hz", Uint32, 0.0, 1_990_000.0, 0.002, Some((1e-9, Stamp))),
            ("microseconds", Uint32, 0.0, 99_700.0, 0.1, Some((1e-6, Stamp))),
            ("milliseconds", Float32, 0.0, 99.7, 0.1, Some((1e-3, Stamp))),
            ("Hesai", Float64, date, date + 0.0998, 0.1, Some((1.0, Epoch))),
            ("Hesai, other clock", Float64, 1.3e9, 1.3e9 + 0.0998, 0.1, Some((1.0, OtherClock))),
            ("Livox, double", Float64, date * 1e9, date * 1e9 + 9.98e7, 0.1, Some((1e-9, Epoch))),
            ("since boot", Float64, 812.0, 812.0998, 0.1, Some((1.0, OtherClock))),
            ("a bit late", Float32, 0.3, 0.4, 0.1, Some((1.0, Stamp))),
            ("float date", Float32, date, date + 128.0, 0.1, None),
            ("constant", Uint32, 7.0, 7.0, 0.1, None),
            ("few points", Float32, 0.0, 0.002, 0.1, Some((1.0, Stamp))),
        ] {
            assert_eq!(detected(field_type, least, largest, interval), expected, "{name}");
        }
        assert_eq!(detect(&[], None), None);
    }
}
