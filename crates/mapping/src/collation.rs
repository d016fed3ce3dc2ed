//! Orders measurements of several sensors in time: which wait for others, and which pass at once (`slam2d.md`
//! §2). Drops those that come too long before the first scan to be of use for the map.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use portolan_config::TrajectoryBuilderOptions;
use portolan_geometry::Duration;
use portolan_issue::{IssueKind, IssueLog};
use portolan_sensor::{Collator, CollatorOptions, Measurement, SensorId, SensorKind};

use crate::TrajectoryId;

/// A measurement that is next in order of time.
pub type Ready = (TrajectoryId, SensorId, Measurement);

/// Maximum age of measurements before the first scan: an IMU that runs for days until the lidar is switched
/// on must not fill the memory, and gravity is known after at most ten time constants of ten seconds.
const LONGEST_BEFORE_SCANS: Duration = Duration::from_ticks(1_000_000_000);

/// Orders the sensors of all trajectories in time.
pub struct SensorCollation {
    collator: Collator<Measurement>,
    uncollated: BTreeMap<TrajectoryId, BTreeSet<SensorKind>>,
    /// Measurements before the first scan, of trajectories that have none yet.
    before_scans: BTreeMap<TrajectoryId, VecDeque<Ready>>,
    left_out: u64,
}

impl SensorCollation {
    /// One queue for all trajectories, or one for each.
    pub fn new(by_trajectory: bool) -> Self {
        let options = CollatorOptions { by_trajectory, ..CollatorOptions::default() };
        Self {
            collator: Collator::new(options),
            uncollated: BTreeMap::new(),
            before_scans: BTreeMap::new(),
            left_out: 0,
        }
    }

    /// Expects these sensors from now on.
    pub fn add_trajectory(
        &mut self,
        id: TrajectoryId,
        sensors: &BTreeSet<SensorId>,
        options: &TrajectoryBuilderOptions,
    ) {
        let mut uncollated = BTreeSet::new();
        if !options.collate_landmarks {
            uncollated.insert(SensorKind::Landmark);
        }
        if !options.collate_fixed_frame {
            uncollated.insert(SensorKind::FixedFramePose);
        }
        let collated = sensors.iter().filter(|s| !uncollated.contains(&s.kind)).cloned();
        self.collator.add_trajectory(id.0, collated);
        self.uncollated.insert(id, uncollated);
        self.before_scans.insert(id, VecDeque::new());
    }

    /// Adds a measurement and returns all that are next in order.
    pub fn add(&mut self, id: TrajectoryId, sensor_id: &SensorId, measurement: Measurement) -> Vec<Ready> {
        let passes = self.uncollated.get(&id).is_some_and(|kinds| kinds.contains(&sensor_id.kind));
        if passes {
            return self.since_first_scan(vec![(id, sensor_id.clone(), measurement)]);
        }
        self.collator.add(id.0, sensor_id, measurement.time(), measurement);
        self.drain()
    }

    /// Ends a trajectory: no measurement waits for its sensors any more.
    pub fn finish_trajectory(&mut self, id: TrajectoryId) -> Vec<Ready> {
        self.collator.finish_trajectory(id.0);
        let mut ready = self.drain();
        ready.extend(self.before_scans.remove(&id).into_iter().flatten());
        ready
    }

    fn drain(&mut self) -> Vec<Ready> {
        let mut ready = Vec::new();
        while let Some(item) = self.collator.pop() {
            ready.push((TrajectoryId(item.trajectory_id), item.sensor_id, item.payload));
        }
        self.since_first_scan(ready)
    }

    /// Holds back measurements before the first scan of their trajectory, and releases them with that scan.
    fn since_first_scan(&mut self, measured: Vec<Ready>) -> Vec<Ready> {
        let mut ready = Vec::with_capacity(measured.len());
        for (id, sensor, measurement) in measured {
            if sensor.kind == SensorKind::Range {
                ready.extend(self.before_scans.remove(&id).into_iter().flatten());
            }
            let Some(held) = self.before_scans.get_mut(&id) else {
                ready.push((id, sensor, measurement));
                continue;
            };
            let now = measurement.time();
            held.push_back((id, sensor, measurement));
            while held.front().is_some_and(|(.., first)| now - first.time() > LONGEST_BEFORE_SCANS) {
                held.pop_front();
                self.left_out += 1;
            }
        }
        ready
    }

    /// Counts of dropped measurements so far.
    pub fn issues(&self) -> IssueLog {
        let mut issues = IssueLog::default();
        for counts in self.collator.counts().values() {
            issues.count(IssueKind::BeforeAllSensors, counts.before_start);
            issues.count(IssueKind::OutOfOrderInSensor, counts.out_of_order);
            issues.count(IssueKind::MeasurementLate, counts.late);
            issues.count(IssueKind::SensorStalled, counts.stalls);
        }
        issues.count(IssueKind::BeforeAllSensors, self.left_out);
        issues.count(IssueKind::UnknownSensor, self.collator.unknown().values().sum::<u64>());
        issues
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_config::Options;
    use portolan_geometry::{Point3f, Time, Vector3};
    use portolan_sensor::{ImuData, TimedPointCloudData};

    #[test]
    fn the_newest_sample_before_the_first_scan_is_kept() {
        let [imu, lidar] = [SensorKind::Imu, SensorKind::Range].map(|kind| SensorId::new(kind, "a"));
        let mut collation = SensorCollation::new(false);
        let options = Options::for_3d().trajectory_builder;
        let id = TrajectoryId(0);
        // The lidar is not expected: only this hold-back waits for its first scan.
        collation.add_trajectory(id, &BTreeSet::from([imu.clone()]), &options);
        let at = |seconds: f64| Time::from_ticks(0) + Duration::from_seconds(seconds);
        let sample = |seconds: f64| {
            let (linear_acceleration, angular_velocity) = (Vector3::z(), Vector3::zeros());
            Measurement::Imu(ImuData { time: at(seconds), linear_acceleration, angular_velocity })
        };
        for i in 0..2000 {
            assert!(collation.add(id, &imu, sample(0.1 * f64::from(i))).is_empty());
        }
        assert_eq!(collation.before_scans[&id].len(), 1001);
        let scan = TimedPointCloudData {
            time: at(200.0),
            origin_in_tracking: Point3f::origin(),
            points_in_tracking: Vec::new(),
            intensities: Vec::new(),
        };
        let ready = collation.since_first_scan(vec![(id, lidar, Measurement::Range(scan))]);
        assert_eq!(ready.len(), 1002);
        assert!(ready.is_sorted_by_key(|(.., measurement)| measurement.time()));
        assert_eq!(collation.add(id, &imu, sample(200.1)).len(), 1);
        let left_out: Vec<u64> = collation.issues().list().iter().map(|issue| issue.count).collect();
        assert_eq!(left_out, [999]);
    }
}
