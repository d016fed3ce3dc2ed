//! Checks that at least one scan is within the time span of the other sensors, without which no scan can be
//! used.

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_ingest::{PlannedSensor, SensorPlan};
use portolan_issue::Severity;

use crate::finding::{Findings, Kind};

const NO_SCANS: Kind = Kind {
    name: "no usable scan",
    severity: Severity::Error,
    effect: "there is no scan to make a map of",
    to_do: "record for longer; or map without the sensor that ends too early (--no-imu, --no-odometry)",
};

/// Time spans in which topics have measurements.
#[derive(Debug, Default)]
pub(crate) struct Coverage {
    spans: BTreeMap<Arc<str>, (Time, Time)>,
    /// Times of the first and the last points of scans.
    scans: BTreeMap<Arc<str>, Vec<(Time, Time)>>,
}

impl Coverage {
    /// Takes a measurement; of a scan also the times of its first and last point.
    pub fn add(&mut self, topic: &Arc<str>, time: Time, sweep: Option<(Time, Time)>) {
        let span = self.spans.entry(topic.clone()).or_insert((time, time));
        *span = (time.min(span.0), time.max(span.1));
        if let Some(sweep) = sweep {
            self.scans.entry(topic.clone()).or_default().push(sweep);
        }
    }

    /// Adds a finding if no scan that the plan uses is within the time span of the IMU and odometry that it
    /// uses.
    pub fn finish(&self, plan: &SensorPlan, findings: &mut Findings) {
        let odometry = plan.odometry.as_ref().filter(|odometry| odometry.topic().is_some());
        let odometry = odometry.map(|odometry| &odometry.source);
        let others = plan.imu.as_ref().map(|imu| &imu.source).into_iter().chain(odometry);
        let span = |s: &PlannedSensor| {
            let (first, last) = self.spans.get(&s.topic)?;
            Some((s.topic.clone(), *first + s.clock_shift, *last + s.clock_shift))
        };
        let others: Vec<(Arc<str>, Time, Time)> = others.filter_map(span).collect();
        let scans = || {
            plan.range.iter().flat_map(|range| {
                let sweeps = self.scans.get(&range.source.topic).into_iter().flatten();
                sweeps.map(|(a, b)| (*a + range.source.clock_shift, *b + range.source.clock_shift))
            })
        };
        let covers =
            |(a, b): (Time, Time), (_, first, last): &(Arc<str>, Time, Time)| *first < a && b < *last;
        if scans().any(|sweep| others.iter().all(|other| covers(sweep, other))) {
            return;
        }
        let culprit = others.iter().find(|other| !scans().any(|sweep| covers(sweep, other)));
        let name = culprit.map_or("the other sensors", |(topic, ..)| topic);
        findings.add(&NO_SCANS, "", || match scans().count() {
            0 => "there is not one scan with a point".to_owned(),
            1 => format!("the only scan begins before {name} does, or ends after it"),
            n => format!("all {n} scans begin before {name} does, or end after it"),
        });
    }
}
