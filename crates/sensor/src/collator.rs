//! Sorts the data of several sensors by time (`spec/slam2d.md` §2).
//!
//! Every sensor has a queue. A datum is output when every other sensor has a later one, so the output is in
//! order although sensors report with different delays. Until all sensors of a trajectory have started, only
//! the last datum of each is kept.
//!
//! Unlike in Cartographer, no sensor can block the others for ever. A silent sensor is waited for only up to
//! a [`WaitLimit`], and data that come too late are counted and dropped. The output depends only on the order
//! of the calls.

mod queues;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};

use portolan_geometry::{Duration, Time};

use crate::SensorId;
use queues::Queues;

/// Maximum number of unknown sensors that are counted separately; further ones are counted together.
const MAX_UNKNOWN_SENSORS: usize = 256;

/// How long data wait for a silent sensor before they are output without it. This is a delay, not a timeout:
/// while the sensor is silent, data are held back by this much, and data that it sends within that delay are
/// still sorted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WaitLimit {
    /// Maximum span from the oldest to the newest waiting datum of one sensor; default 3 s. Raise it for
    /// sensors that report with a longer delay.
    pub data_time: Duration,
    /// Maximum number of waiting data of one sensor, for sensors whose stamps do not advance; default 4000.
    pub queued_items: usize,
}

impl Default for WaitLimit {
    fn default() -> Self {
        Self { data_time: Duration::from_ticks(30_000_000), queued_items: 4000 }
    }
}

/// How a [`Collator`] orders data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CollatorOptions {
    /// Whether every trajectory is ordered on its own, instead of all together (where a silent sensor of one
    /// trajectory delays all). Default `false`.
    pub by_trajectory: bool,
    /// How long to wait for a silent sensor. With `None` the wait has no limit, as in Cartographer, and all
    /// data of the others are kept in memory.
    pub wait_limit: Option<WaitLimit>,
}

impl Default for CollatorOptions {
    fn default() -> Self {
        Self { by_trajectory: false, wait_limit: Some(WaitLimit::default()) }
    }
}

/// A datum in the ordered output.
#[derive(Clone, Debug, PartialEq)]
pub struct CollatedItem<P> {
    /// The trajectory that it belongs to.
    pub trajectory_id: u32,
    /// The sensor that it came from.
    pub sensor_id: SensorId,
    /// Time of the measurement.
    pub time: Time,
    /// The measurement.
    pub payload: P,
}

/// A sensor that fell silent while others had data; reported once per sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CollatorReport {
    /// Its trajectory.
    pub trajectory_id: u32,
    /// The sensor.
    pub sensor_id: SensorId,
    /// Time of its last datum, if there was one.
    pub last_time: Option<Time>,
}

/// Counts of the data of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorCounts {
    /// Data that arrived.
    pub received: u64,
    /// Data that were output.
    pub dispatched: u64,
    /// Dropped: before all sensors had started.
    pub before_start: u64,
    /// Dropped: older than an earlier datum of the same sensor, or with a stamp far in the future.
    pub out_of_order: u64,
    /// Dropped: older than data of other sensors that had already been output.
    pub late: u64,
    /// How often data of the others were output without waiting for this sensor.
    pub stalls: u64,
}

/// Merges the data of many sensors by time. After each [`Collator::add`] call [`Collator::pop`] until nothing
/// is left.
pub struct Collator<P> {
    options: CollatorOptions,
    /// One set of queues for all trajectories (under 0), or one per trajectory.
    groups: BTreeMap<u32, Queues<P>>,
    ready: VecDeque<CollatedItem<P>>,
    reports: Vec<CollatorReport>,
    unknown: BTreeMap<(u32, SensorId), u64>,
    unknown_others: u64,
}

impl<P> Collator<P> {
    /// A collator without trajectories.
    pub fn new(options: CollatorOptions) -> Self {
        Self {
            options,
            groups: BTreeMap::new(),
            ready: VecDeque::new(),
            reports: Vec::new(),
            unknown: BTreeMap::new(),
            unknown_others: 0,
        }
    }

    fn group_of(&self, trajectory_id: u32) -> u32 {
        if self.options.by_trajectory { trajectory_id } else { 0 }
    }

    /// Registers the sensors of a trajectory. Sensors that are already registered stay as they are.
    pub fn add_trajectory(&mut self, trajectory_id: u32, sensors: impl IntoIterator<Item = SensorId>) {
        let limit = self.options.wait_limit;
        let group_id = self.group_of(trajectory_id);
        let group = self.groups.entry(group_id).or_insert_with(|| Queues::new(limit));
        for sensor in sensors {
            group.add_queue((trajectory_id, sensor));
        }
    }

    /// Adds one datum. Data of sensors that are not registered, or finished, are counted and dropped.
    pub fn add(&mut self, trajectory_id: u32, sensor_id: &SensorId, time: Time, payload: P) {
        let key = (trajectory_id, sensor_id.clone());
        let group_id = self.group_of(trajectory_id);
        if let Some(group) = self.groups.get_mut(&group_id)
            && group.add(&key, time, payload)
        {
            group.dispatch(&mut self.ready, &mut self.reports);
        } else {
            self.count_unknown(key);
        }
    }

    fn count_unknown(&mut self, key: (u32, SensorId)) {
        if self.unknown.len() < MAX_UNKNOWN_SENSORS || self.unknown.contains_key(&key) {
            *self.unknown.entry(key).or_default() += 1;
        } else {
            self.unknown_others += 1;
        }
    }

    /// Ends the data of a trajectory; its waiting data are output as soon as others allow.
    pub fn finish_trajectory(&mut self, trajectory_id: u32) {
        let group_id = self.group_of(trajectory_id);
        if let Some(group) = self.groups.get_mut(&group_id) {
            group.finish(Some(trajectory_id));
            group.dispatch(&mut self.ready, &mut self.reports);
        }
    }

    /// Ends all data and outputs everything that is waiting.
    pub fn flush(&mut self) {
        for group in self.groups.values_mut() {
            group.finish(None);
            group.dispatch(&mut self.ready, &mut self.reports);
        }
    }

    /// The next datum in order, if one is ready.
    pub fn pop(&mut self) -> Option<CollatedItem<P>> {
        self.ready.pop_front()
    }

    /// The sensor for which data of other trajectories may have to wait. `None` if trajectories are ordered
    /// on their own, because then they never wait for each other.
    pub fn blocking(&self) -> Option<&(u32, SensorId)> {
        if self.options.by_trajectory { None } else { self.groups.get(&0)?.blocking() }
    }

    /// Sensors that fell silent since the last call.
    pub fn take_reports(&mut self) -> Vec<CollatorReport> {
        std::mem::take(&mut self.reports)
    }

    /// Counts of the data, by trajectory and sensor.
    pub fn counts(&self) -> BTreeMap<(u32, SensorId), SensorCounts> {
        self.groups.values().flat_map(Queues::counts).map(|(key, counts)| (key.clone(), counts)).collect()
    }

    /// Data of sensors that were not registered, by trajectory and sensor.
    pub fn unknown(&self) -> &BTreeMap<(u32, SensorId), u64> {
        &self.unknown
    }

    /// Data of further unregistered sensors, which are too many to count separately.
    pub fn unknown_others(&self) -> u64 {
        self.unknown_others
    }
}
