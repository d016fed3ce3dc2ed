//! Checks the point clouds of one topic.

use portolan_ingest::{CloudError, CloudFaults, CloudLayout, PointTime, PointTimeOrigin};
use portolan_issue::Severity;
use portolan_recording::PointCloud2;

use crate::finding::{Findings, Kind};

const UNUSABLE: Kind = Kind {
    name: "unusable cloud",
    severity: Severity::Error,
    effect: "clouds that cannot be parsed are left out",
    to_do: "clouds need fields x, y and z of a number type that lie within point_step",
};
const MISSING: Kind = Kind {
    name: "missing points",
    severity: Severity::Error,
    effect: "the map is made without the missing points",
    to_do: "mend the driver: width, height, point_step and row_step must fit the data",
};
const NO_TIME: Kind = Kind {
    name: "no time",
    severity: Severity::Warning,
    effect: "times are guessed from the azimuth where the lidar spins; elsewhere motion during a sweep cannot be undone and blurs the map",
    to_do: "let the driver add a time field (time, t, timestamp or offset_time); --point-times chooses how to guess",
};
const TIMES_FROM_START: Kind = Kind {
    name: "times from start",
    severity: Severity::Info,
    effect: "none: times are counted to the last point, and the message gets that time",
    to_do: "",
};
const OTHER_CLOCK: Kind = Kind {
    name: "other clock",
    severity: Severity::Warning,
    effect: "the first point of a cloud is taken to be measured at the stamp",
    to_do: "synchronise the clock of the lidar with that of the computer (PTP), or stamp with its time",
};
const FAR_TIME: Kind = Kind {
    name: "wrong times",
    severity: Severity::Warning,
    effect: "these points are left out",
    to_do: "mend the driver: it writes other values than times for some points, often zero where nothing came back",
};
const MILLIMETRES: Kind = Kind {
    name: "millimetres",
    severity: Severity::Warning,
    effect: "none in the map: coordinates are converted to metres",
    to_do: "let the driver write metres, as point clouds of ROS have them",
};
const NOT_FINITE: Kind =
    Kind { name: "no points", severity: Severity::Info, effect: "these points are left out", to_do: "" };

const EMPTY: Kind = Kind {
    name: "empty clouds",
    severity: Severity::Warning,
    effect: "these messages give nothing",
    to_do: "look for a driver that sends before it has data, or a filter that removes everything",
};
const HUGE: Kind = Kind {
    name: "huge clouds",
    severity: Severity::Warning,
    effect: "mapping uses them, but each is in memory several times, and computing time grows with the number of points",
    to_do: "map with a topic of single sweeps; accumulated clouds have lost the motion in them",
};
/// Number of points above which a cloud is no single sweep.
const HUGE_POINTS: u64 = 1_000_000;

/// Point clouds of one topic.
#[derive(Debug, Default)]
pub(crate) struct CloudChecks {
    not_finite: u64,
    far_time: u64,
    zero: u64,
}

impl CloudChecks {
    /// Adds a finding for a cloud that cannot be decoded.
    pub fn add_error(topic: &str, error: CloudError, findings: &mut Findings) {
        findings.add(&UNUSABLE, topic, || error.to_string());
    }

    /// Checks a cloud, given the faults of its points.
    pub fn add(
        &mut self,
        topic: &str,
        cloud: &PointCloud2,
        layout: &CloudLayout,
        time: Option<PointTime>,
        faults: CloudFaults,
        findings: &mut Findings,
    ) {
        let points = u64::from(cloud.width) * u64::from(cloud.height);
        if points == 0 {
            return findings.add(&EMPTY, topic, || "clouds of zero points".to_owned());
        }
        if points > HUGE_POINTS {
            findings.add(&HUGE, topic, || format!("clouds of {points} points"));
        }
        if layout.length_unit() != 1.0 {
            findings.add(&MILLIMETRES, topic, || "coordinates of clouds are in millimetres".to_owned());
        }
        self.not_finite += faults.not_finite;
        self.far_time += faults.far_time;
        self.zero += faults.zero;
        if faults.missing > 0 {
            findings.add(&MISSING, topic, || {
                format!("the size of a cloud states {} points more than it has", faults.missing)
            });
        }
        match (layout.has_time(), time) {
            (true, Some(time @ PointTime { origin: PointTimeOrigin::Stamp, .. })) => {
                if let Some(last) = layout.last_after_stamp(cloud, time).filter(|last| *last != 0.0) {
                    findings.add(&TIMES_FROM_START, topic, || {
                        format!("range data whose last point has relative time {last:.6} s, should be zero")
                    });
                }
            }
            (true, Some(PointTime { origin: PointTimeOrigin::OtherClock, .. })) => {
                findings.add(&OTHER_CLOCK, topic, || {
                    "times of points come from another clock than stamps".to_owned()
                });
            }
            (true, Some(_)) => {}
            (true, None) => {
                findings.add(&NO_TIME, topic, || "the time field of clouds holds no usable times".to_owned())
            }
            (false, _) => findings.add(&NO_TIME, topic, || "clouds have no time for each point".to_owned()),
        }
    }

    /// Adds findings about the whole topic.
    pub fn finish(self, topic: &str, findings: &mut Findings) {
        let (not_finite, far_time, zero) = (self.not_finite, self.far_time, self.zero);
        if far_time > 0 {
            findings.add(&FAR_TIME, topic, || {
                format!("{far_time} points whose time is far outside the time span of their cloud")
            });
        }
        if not_finite + zero > 0 {
            findings.add(&NOT_FINITE, topic, || {
                format!("{not_finite} points that are not a number or beyond 1,000 km, {zero} at (0, 0, 0)")
            });
        }
    }
}
