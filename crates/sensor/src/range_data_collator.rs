//! Joins the messages of several range sensors over common time spans (`spec/slam2d.md` §3).

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::{Duration, Point3f, Time};

use crate::{TimedPoint, TimedPointCloudData};

/// A point with the sensor that measured it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SynchronizedPoint {
    /// Position in the tracking frame at the point's own time; time relative to the end of the span, at most
    /// zero.
    pub point: TimedPoint,
    /// Index of the sensor's position in `origins`.
    pub origin_index: usize,
}

/// The points of all range sensors over one time span.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SynchronizedRanges {
    /// End of the span.
    pub time: Time,
    /// Positions of the sensors in the tracking frame, metres.
    pub origins: Vec<Point3f>,
    /// In ascending order of time.
    pub points: Vec<SynchronizedPoint>,
    /// One per point, zero where the sensor has none; empty if no sensor has any.
    pub intensities: Vec<f32>,
}

/// Points and messages that were dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RangeDataCollatorCounts {
    /// Points older than the end of the previous span.
    pub earlier_points: u64,
    /// Points whose time is not a finite number.
    pub points_without_time: u64,
    /// Messages whose points were not in order of time; they were sorted.
    pub reordered_messages: u64,
    /// Messages of sensors that are not expected.
    pub unexpected_messages: u64,
}

/// Holds back at most one message per sensor, until every sensor has one or one sensor has a second.
#[derive(Clone, Debug)]
pub struct RangeDataCollator {
    /// The expected sensors in ascending order of their name, with the message held back of each.
    sensors: BTreeMap<Arc<str>, Option<Pending>>,
    /// End of the last span.
    end: Time,
    counts: RangeDataCollatorCounts,
}

#[derive(Clone, Debug)]
struct Pending {
    /// Points in ascending order of time.
    data: TimedPointCloudData,
    /// Number of points that were already used.
    next: usize,
}

impl Pending {
    fn time_of(&self, point: &TimedPoint) -> Time {
        self.data.time + Duration::from_seconds(f64::from(point.time))
    }

    fn rest(&self) -> &[TimedPoint] {
        self.data.points_in_tracking.get(self.next..).unwrap_or_default()
    }
}

impl RangeDataCollator {
    /// Expects messages of the sensors with these names.
    pub fn new(expected_sensors: impl IntoIterator<Item = Arc<str>>) -> Self {
        Self {
            sensors: expected_sensors.into_iter().map(|id| (id, None)).collect(),
            end: Time::MIN,
            counts: RangeDataCollatorCounts::default(),
        }
    }

    /// Adds a message and returns the span that it completes, if any. The times of successive messages should
    /// not decrease, which the [`Collator`](crate::Collator) ensures.
    pub fn add(&mut self, sensor_id: &str, data: TimedPointCloudData) -> Option<SynchronizedRanges> {
        let Some(slot) = self.sensors.get_mut(sensor_id) else {
            self.counts.unexpected_messages += 1;
            return None;
        };
        let pending = Pending { data: in_order(data, &mut self.counts), next: 0 };
        if let Some(waiting) = slot {
            let end = waiting.data.time;
            let joined = self.join_until(end);
            self.sensors.insert(sensor_id.into(), Some(pending));
            return Some(joined);
        }
        *slot = Some(pending);
        let mut oldest = Time::MAX;
        for waiting in self.sensors.values() {
            oldest = oldest.min(waiting.as_ref()?.data.time);
        }
        Some(self.join_until(oldest))
    }

    /// All points from the end of the last span to `end`.
    fn join_until(&mut self, end: Time) -> SynchronizedRanges {
        // The end of a span never moves backward, whatever the messages contain.
        let start = self.end;
        let end = end.max(start);
        self.end = end;
        let mut joined = SynchronizedRanges { time: end, ..Default::default() };
        for slot in self.sensors.values_mut() {
            if let Some(pending) = slot {
                self.counts.earlier_points += take_span(pending, start, end, &mut joined);
                if pending.rest().is_empty() {
                    *slot = None;
                }
            }
        }
        sort_by_time(&mut joined);
        joined
    }

    /// Counts of dropped or repaired data so far.
    pub fn counts(&self) -> RangeDataCollatorCounts {
        self.counts
    }
}

/// Moves the points from `start` to `end` (both included) to `joined`. Returns how many were too early.
fn take_span(pending: &mut Pending, start: Time, end: Time, joined: &mut SynchronizedRanges) -> u64 {
    let origin_index = joined.origins.len();
    joined.origins.push(pending.data.origin_in_tracking);
    let rest = pending.rest();
    let early = rest.partition_point(|p| pending.time_of(p) < start);
    let count = rest.partition_point(|p| pending.time_of(p) <= end).saturating_sub(early);
    let correction = pending.data.time.seconds_since(end) as f32;
    let taken = rest.iter().skip(early).take(count).map(|p| SynchronizedPoint {
        // Rounding must not move a point beyond the end.
        point: TimedPoint { position: p.position, time: (p.time + correction).min(0.0) },
        origin_index,
    });
    let points_before = joined.points.len();
    joined.points.extend(taken);
    let first = pending.next + early;
    let intensities = pending.data.intensities.get(first..first + count).unwrap_or_default();
    if !intensities.is_empty() || !joined.intensities.is_empty() {
        joined.intensities.resize(points_before, 0.0);
        joined.intensities.extend_from_slice(intensities);
        joined.intensities.resize(joined.points.len(), 0.0);
    }
    pending.next = first + count;
    early as u64
}

/// Sorts by time. Points of equal time stay in the order of the sensors' names.
fn sort_by_time(joined: &mut SynchronizedRanges) {
    if joined.points.is_sorted_by(|a, b| a.point.time <= b.point.time) {
        return;
    }
    if joined.intensities.is_empty() {
        joined.points.sort_by(|a, b| a.point.time.total_cmp(&b.point.time));
        return;
    }
    let mut both: Vec<(SynchronizedPoint, f32)> =
        joined.points.iter().copied().zip(joined.intensities.iter().copied()).collect();
    both.sort_by(|a, b| a.0.point.time.total_cmp(&b.0.point.time));
    (joined.points, joined.intensities) = both.into_iter().unzip();
}

/// The message with its points sorted by time: many lidars do not send them in order.
fn in_order(mut data: TimedPointCloudData, counts: &mut RangeDataCollatorCounts) -> TimedPointCloudData {
    let points = &mut data.points_in_tracking;
    // Intensities that do not correspond to the points one by one are dropped.
    if data.intensities.len() != points.len() {
        data.intensities.clear();
    }
    if points.is_sorted_by(|a, b| a.time <= b.time) && points.iter().all(|p| p.time.is_finite()) {
        return data;
    }
    let mut order: Vec<usize> = (0..points.len()).filter(|i| points[*i].time.is_finite()).collect();
    counts.points_without_time += (points.len() - order.len()) as u64;
    if !order.is_sorted_by(|a, b| points[*a].time <= points[*b].time) {
        counts.reordered_messages += 1;
        order.sort_by(|a, b| points[*a].time.total_cmp(&points[*b].time));
    }
    data.points_in_tracking = order.iter().map(|i| points[*i]).collect();
    if !data.intensities.is_empty() {
        data.intensities = order.iter().map(|i| data.intensities[*i]).collect();
    }
    data
}

#[cfg(test)]
mod tests;
