//! Which measurements wait for others, and which go straight through (`slam2d.md` §2).

use std::collections::{BTreeMap, BTreeSet};

use portolan_config::TrajectoryBuilderOptions;
use portolan_issue::{IssueKind, IssueLog};
use portolan_sensor::{Collator, CollatorOptions, Measurement, SensorId, SensorKind};

use crate::TrajectoryId;

/// A measurement whose turn has come.
pub type Ready = (TrajectoryId, SensorId, Measurement);

/// Orders the sensors of all trajectories in time.
pub struct SensorCollation {
    collator: Collator<Measurement>,
    uncollated: BTreeMap<TrajectoryId, BTreeSet<SensorKind>>,
}

impl SensorCollation {
    /// One queue for all trajectories, or one for each.
    pub fn new(by_trajectory: bool) -> Self {
        let options = CollatorOptions { by_trajectory, ..CollatorOptions::default() };
        Self { collator: Collator::new(options), uncollated: BTreeMap::new() }
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
    }

    /// Takes a measurement and gives all whose turn has come.
    pub fn add(&mut self, id: TrajectoryId, sensor_id: &SensorId, measurement: Measurement) -> Vec<Ready> {
        let passes = self.uncollated.get(&id).is_some_and(|kinds| kinds.contains(&sensor_id.kind));
        if passes {
            return vec![(id, sensor_id.clone(), measurement)];
        }
        self.collator.add(id.0, sensor_id, measurement.time(), measurement);
        self.drain()
    }

    /// Ends a trajectory: nothing waits for its sensors any more.
    pub fn finish_trajectory(&mut self, id: TrajectoryId) -> Vec<Ready> {
        self.collator.finish_trajectory(id.0);
        self.drain()
    }

    fn drain(&mut self) -> Vec<Ready> {
        let mut ready = Vec::new();
        while let Some(item) = self.collator.pop() {
            ready.push((TrajectoryId(item.trajectory_id), item.sensor_id, item.payload));
        }
        ready
    }

    /// What was dropped so far.
    pub fn issues(&self) -> IssueLog {
        let mut issues = IssueLog::default();
        for counts in self.collator.counts().values() {
            issues.count(IssueKind::BeforeAllSensors, counts.before_start);
            issues.count(IssueKind::OutOfOrderInSensor, counts.out_of_order);
            issues.count(IssueKind::MeasurementLate, counts.late);
            issues.count(IssueKind::SensorStalled, counts.stalls);
        }
        issues.count(IssueKind::UnknownSensor, self.collator.unknown().values().sum::<u64>());
        issues
    }
}
