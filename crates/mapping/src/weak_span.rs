//! Stretches of a trajectory in which scans did not hold in every direction: long bare corridors, tunnels,
//! open fields.

use portolan_geometry::{Duration, Time, Vector3};

/// Scans further apart than this belong to different stretches.
const GAP: Duration = Duration::from_ticks(20_000_000);
/// More stretches are counted with the last one, so that memory is bounded.
const MAX_SPANS: usize = 10_000;

/// What scans do not tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum WeakMotion {
    /// How far it goes along a direction.
    Shift,
    /// How far it turns about a direction.
    Turn,
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
    /// Whether shifts or turns were open.
    pub motion: WeakMotion,
    /// The direction in the tracking frame, unit length, of the first such scan.
    pub direction_in_tracking: Vector3,
}

/// Joins scans to stretches.
#[derive(Clone, Debug, Default)]
pub struct WeakSpans {
    spans: Vec<WeakSpan>,
}

impl WeakSpans {
    /// Counts a scan that left a direction (in the tracking frame) open.
    pub fn add(&mut self, time: Time, motion: WeakMotion, direction_in_tracking: Vector3) {
        let full = self.spans.len() >= MAX_SPANS;
        let last = self.spans.iter_mut().rev().find(|span| span.motion == motion);
        match last.filter(|span| full || time - span.end <= GAP) {
            Some(span) => {
                // Two open directions of one scan count once.
                span.scans += u64::from(span.end != time);
                span.end = time.max(span.end);
            }
            None if full => {}
            None => {
                let (start, end, scans) = (time, time, 1);
                self.spans.push(WeakSpan { start, end, scans, motion, direction_in_tracking });
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

    #[test]
    fn scans_of_one_corridor_are_one_stretch() {
        let time = |t: f64| Time::from_ticks((t * 1e7) as i64);
        let mut spans = WeakSpans::default();
        for i in 0..30 {
            spans.add(time(0.1 * f64::from(i)), WeakMotion::Shift, Vector3::x());
        }
        spans.add(time(2.9), WeakMotion::Shift, Vector3::y());
        spans.add(time(2.9), WeakMotion::Turn, Vector3::z());
        spans.add(time(60.0), WeakMotion::Shift, Vector3::x());
        let found: Vec<(WeakMotion, u64)> = spans.spans().iter().map(|s| (s.motion, s.scans)).collect();
        assert_eq!(found, [(WeakMotion::Shift, 30), (WeakMotion::Turn, 1), (WeakMotion::Shift, 1)]);
        for i in 0..3 * MAX_SPANS {
            spans.add(time(100.0 + 10.0 * i as f64), WeakMotion::Turn, Vector3::z());
        }
        assert_eq!(spans.spans().len(), MAX_SPANS);
    }
}
