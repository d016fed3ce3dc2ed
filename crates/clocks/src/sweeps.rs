//! Joins the messages of a lidar to sweeps.

use portolan_geometry::{Duration, Point3f, Time};
use portolan_numeric::scramble;
use portolan_sensor::TimedPointCloudData;

/// Duration from which the joined messages are a sweep, seconds; most lidars take a tenth of a second for a
/// revolution.
const ENOUGH: f64 = 0.07;
/// Gap between messages above which they belong to different sweeps, seconds.
const MAX_GAP: f64 = 0.05;
/// Maximum number of messages of a sweep.
const MAX_MESSAGES: usize = 1000;
/// Range below which points are on the scanner or its carrier, metres.
const NEAREST: f32 = 0.5;
/// Number of points of a sweep above which they are thinned.
const MAX_POINTS: usize = 6000;

/// Points of about a tenth of a second.
#[derive(Clone, Debug)]
pub(super) struct Sweep {
    /// Middle of the times of its points.
    pub middle: Time,
    /// Time from there to its last point, seconds.
    pub half: f64,
    /// Time after the middle, seconds, and position in the tracking frame at that time.
    pub points: Vec<(f32, Point3f)>,
    /// Position of the lidar in the tracking frame.
    pub origin: Point3f,
}

/// Gathers the messages of one lidar.
#[derive(Debug, Default)]
pub(super) struct SweepGatherer {
    messages: Vec<TimedPointCloudData>,
}

impl SweepGatherer {
    /// Takes a message; returns the sweep that it completes.
    pub fn add(&mut self, message: TimedPointCloudData) -> Option<Sweep> {
        let begin = begin(&message)?;
        if self.messages.last().is_some_and(|last| begin.seconds_since(last.time).abs() > MAX_GAP) {
            self.messages.clear();
        }
        if self.messages.len() >= MAX_MESSAGES {
            self.messages.clear();
        }
        let end = message.time;
        self.messages.push(message);
        let begin = self.messages.iter().filter_map(self::begin).min()?;
        let is_instant = end == begin;
        if !is_instant && end.seconds_since(begin) < ENOUGH {
            return None;
        }
        let sweep = joined(&self.messages, begin, end);
        self.messages.clear();
        sweep
    }
}

/// Time of the first point.
fn begin(message: &TimedPointCloudData) -> Option<Time> {
    message.points_in_tracking.first().map(|p| message.time + Duration::from_seconds(f64::from(p.time)))
}

fn joined(messages: &[TimedPointCloudData], begin: Time, end: Time) -> Option<Sweep> {
    let half = 0.5 * end.seconds_since(begin);
    let middle = begin + Duration::from_seconds(half);
    let total: usize = messages.iter().map(|m| m.points_in_tracking.len()).sum();
    let stride = total.div_ceil(MAX_POINTS).max(1);
    let origin = messages.last()?.origin_in_tracking;
    let mut points = Vec::with_capacity(total / stride + 1);
    for message in messages {
        let shift = message.time.seconds_since(middle) as f32;
        for (i, chunk) in message.points_in_tracking.chunks(stride).enumerate() {
            // Takes one at random from each group: every 16th point may always be from the same beam.
            let Some(point) = chunk.get(scramble(i as u32) as usize % chunk.len()) else { continue };
            if (point.position - message.origin_in_tracking).norm() > NEAREST {
                points.push((shift + point.time, point.position));
            }
        }
    }
    Some(Sweep { middle, half, points, origin })
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_sensor::TimedPoint;

    fn message(end: f64, seconds: f32, points: usize) -> TimedPointCloudData {
        let point = |i: usize| TimedPoint {
            position: Point3f::new(1.0 + (i % 16) as f32, 0.0, 0.0),
            time: seconds * (i as f32 / (points - 1).max(1) as f32 - 1.0),
        };
        TimedPointCloudData {
            time: Time::UNIX_EPOCH + Duration::from_seconds(end),
            origin_in_tracking: Point3f::origin(),
            points_in_tracking: (0..points).map(point).collect(),
            intensities: Vec::new(),
        }
    }

    #[test]
    fn parts_are_joined_and_whole_sweeps_and_instants_are_left_as_they_are() {
        let mut gatherer = SweepGatherer::default();
        let parts: Vec<Sweep> =
            (1..=20).filter_map(|i| gatherer.add(message(0.01 * f64::from(i), 0.009, 50))).collect();
        assert_eq!(parts.len(), 2);
        assert_eq!(parts[0].points.len(), 400);
        let last = parts[0].points.iter().map(|p| p.0).fold(0.0, f32::max);
        assert!((f64::from(last) - parts[0].half).abs() < 1e-6);
        let mut gatherer = SweepGatherer::default();
        let whole = gatherer.add(message(1.0, 0.1, 100_000)).unwrap();
        assert!((whole.middle.seconds_since(Time::UNIX_EPOCH) - 0.95).abs() < 1e-6);
        assert!(whole.points.len() <= MAX_POINTS);
        // Points of all beams.
        let mut beams: Vec<i32> = whole.points.iter().map(|p| p.1.x as i32).collect();
        beams.sort_unstable();
        beams.dedup();
        assert_eq!(beams.len(), 16);
        assert_eq!(gatherer.add(message(1.1, 0.0, 500)).unwrap().half, 0.0);
        assert!(gatherer.add(message(1.2, 0.0, 0)).is_none());
    }

    #[test]
    fn points_before_a_gap_are_not_joined_to_the_next_sweep() {
        let mut gatherer = SweepGatherer::default();
        assert!(gatherer.add(message(1.0, 0.05, 50)).is_none());
        assert!(gatherer.add(message(5.0, 0.05, 50)).is_none());
        assert_eq!(gatherer.add(message(5.05, 0.05, 50)).unwrap().points.len(), 100);
    }
}
