//! One set of queues that are merged by time (`spec/slam2d.md` §2).

use std::collections::{BTreeMap, VecDeque};

use portolan_geometry::Time;

use super::{CollatedItem, CollatorReport, SensorCounts, WaitLimit};
use crate::SensorId;

/// A sensor of a trajectory: the sort key of the queues.
pub(super) type Key = (u32, SensorId);

/// Data of one sensor that wait for data of other sensors.
struct Queue<P> {
    key: Key,
    waiting: VecDeque<(Time, P)>,
    /// No more data will be added.
    finished: bool,
    /// Data of the others were output without waiting for this sensor, and it has sent nothing since.
    stalled: bool,
    last_added: Option<Time>,
    counts: SensorCounts,
}

/// State of one trajectory.
#[derive(Default)]
struct TrajectoryProgress {
    /// Time from which on all sensors of the trajectory have data.
    common_start: Option<Time>,
    last_dispatched: Option<Time>,
}

/// Next action of the merging.
enum Step {
    /// Output the front of a queue.
    Dispatch(usize),
    /// Drop the front of a queue: it is before the common start.
    Drop(usize),
    /// Wait for more data in a queue.
    Wait(usize),
    /// There are no data.
    Idle,
}

/// Several queues that are merged.
pub(super) struct Queues<P> {
    /// In ascending order of the key.
    queues: Vec<Queue<P>>,
    trajectories: BTreeMap<u32, TrajectoryProgress>,
    /// Counts of removed queues, whose sensors are finished.
    done: Vec<(Key, SensorCounts)>,
    limit: Option<WaitLimit>,
    blocking: Option<Key>,
}

impl<P> Queues<P> {
    pub fn new(limit: Option<WaitLimit>) -> Self {
        Self { queues: Vec::new(), trajectories: BTreeMap::new(), done: Vec::new(), limit, blocking: None }
    }

    pub fn add_queue(&mut self, key: Key) {
        if let Err(index) = self.queues.binary_search_by(|q| q.key.cmp(&key)) {
            self.trajectories.entry(key.0).or_default();
            let queue = Queue {
                key,
                waiting: VecDeque::new(),
                finished: false,
                stalled: false,
                last_added: None,
                counts: SensorCounts::default(),
            };
            self.queues.insert(index, queue);
        }
    }

    /// Adds one datum. Returns `false` if there is no such queue, or it is finished.
    pub fn add(&mut self, key: &Key, time: Time, payload: P) -> bool {
        let Ok(index) = self.queues.binary_search_by(|q| q.key.cmp(key)) else { return false };
        let last_dispatched = self.trajectories.get(&key.0).and_then(|t| t.last_dispatched);
        let leap = self.limit.map(|l| l.data_time);
        let Some(queue) = self.queues.get_mut(index).filter(|q| !q.finished) else { return false };
        queue.counts.received += 1;
        if last_dispatched.is_some_and(|last| time < last) {
            queue.counts.late += 1;
            return true;
        }
        if queue.last_added.is_some_and(|last| time < last) {
            queue.counts.out_of_order += 1;
            // If the last stamp is far ahead and the next one does not confirm it, the last one is wrong and
            // is dropped.
            let too_far = |last: Time| leap.is_some_and(|leap| last - time > leap);
            let before = queue.waiting.len().checked_sub(2).and_then(|i| queue.waiting.get(i));
            let fits = before.is_none_or(|(before, _)| *before <= time);
            if !(queue.last_added.is_some_and(too_far) && fits && queue.waiting.pop_back().is_some()) {
                return true;
            }
        }
        queue.last_added = Some(time);
        queue.stalled = false;
        queue.waiting.push_back((time, payload));
        true
    }

    /// Marks the end of the data of a trajectory (of all if none is given).
    pub fn finish(&mut self, trajectory: Option<u32>) {
        for queue in &mut self.queues {
            queue.finished |= trajectory.is_none_or(|id| id == queue.key.0);
        }
    }

    /// Outputs all data that need not wait any longer.
    pub fn dispatch(&mut self, ready: &mut VecDeque<CollatedItem<P>>, reports: &mut Vec<CollatorReport>) {
        self.blocking = None;
        loop {
            let mut step = self.next_step();
            if let Step::Wait(index) = step {
                if !self.held_too_long() {
                    self.blocking = self.queues.get(index).map(|q| q.key.clone());
                    return;
                }
                self.report_silent(reports);
                step = self.next_step_without_waiting();
            }
            match step {
                Step::Dispatch(index) => self.take_front(index, Some(ready)),
                Step::Drop(index) => self.take_front(index, None),
                Step::Wait(_) | Step::Idle => return,
            }
        }
    }

    fn next_step(&mut self) -> Step {
        self.remove_done();
        if let Some(index) = self.queues.iter().position(|q| q.waiting.is_empty()) {
            return Step::Wait(index);
        }
        self.earliest().map_or(Step::Idle, |index| self.step_for(index))
    }

    /// The next step if silent sensors are not waited for.
    fn next_step_without_waiting(&mut self) -> Step {
        match self.earliest().map_or(Step::Idle, |index| self.step_for(index)) {
            Step::Wait(index) => Step::Dispatch(index),
            step => step,
        }
    }

    /// The queue with the earliest front; of several with the same time the first.
    fn earliest(&self) -> Option<usize> {
        let fronts = self.queues.iter().enumerate().filter_map(|(i, q)| Some((q.waiting.front()?.0, i)));
        fronts.min().map(|(_, index)| index)
    }

    /// The action for the earliest datum. Of the data before the common start only the last of each sensor is
    /// output.
    fn step_for(&mut self, index: usize) -> Step {
        let Some(queue) = self.queues.get(index) else { return Step::Idle };
        let Some((time, _)) = queue.waiting.front() else { return Step::Wait(index) };
        let trajectory = queue.key.0;
        let progress = self.trajectories.entry(trajectory).or_default();
        let start = *progress.common_start.get_or_insert_with(|| {
            let siblings = self.queues.iter().filter(|q| q.key.0 == trajectory);
            siblings.filter_map(|q| Some(q.waiting.front()?.0)).max().unwrap_or(*time)
        });
        match queue.waiting.get(1) {
            _ if *time >= start => Step::Dispatch(index),
            None if queue.finished => Step::Dispatch(index),
            None => Step::Wait(index),
            Some((next, _)) if *next > start => Step::Dispatch(index),
            Some(_) => Step::Drop(index),
        }
    }

    /// Removes the front of a queue and appends it to `ready`, if given.
    fn take_front(&mut self, index: usize, ready: Option<&mut VecDeque<CollatedItem<P>>>) {
        let Some(queue) = self.queues.get_mut(index) else { return };
        let Some((time, payload)) = queue.waiting.pop_front() else { return };
        let Some(ready) = ready else {
            queue.counts.before_start += 1;
            return;
        };
        queue.counts.dispatched += 1;
        let (trajectory_id, sensor_id) = queue.key.clone();
        self.trajectories.entry(trajectory_id).or_default().last_dispatched = Some(time);
        ready.push_back(CollatedItem { trajectory_id, sensor_id, time, payload });
    }

    /// Whether some queue exceeds the limit while another sensor is silent.
    fn held_too_long(&self) -> bool {
        let Some(limit) = self.limit else { return false };
        self.queues.iter().any(|q| match (q.waiting.front(), q.waiting.back()) {
            (Some(front), Some(back)) => {
                back.0 - front.0 > limit.data_time || q.waiting.len() > limit.queued_items
            }
            _ => false,
        })
    }

    fn report_silent(&mut self, reports: &mut Vec<CollatorReport>) {
        for queue in self.queues.iter_mut().filter(|q| q.waiting.is_empty() && !q.stalled) {
            queue.stalled = true;
            queue.counts.stalls += 1;
            if queue.counts.stalls == 1 {
                reports.push(CollatorReport {
                    trajectory_id: queue.key.0,
                    sensor_id: queue.key.1.clone(),
                    last_time: queue.last_added,
                });
            }
        }
    }

    fn remove_done(&mut self) {
        if self.queues.iter().any(|q| q.finished && q.waiting.is_empty()) {
            let (done, rest) = std::mem::take(&mut self.queues)
                .into_iter()
                .partition(|q| q.finished && q.waiting.is_empty());
            self.queues = rest;
            let done: Vec<Queue<P>> = done;
            self.done.extend(done.into_iter().map(|q| (q.key, q.counts)));
        }
    }

    /// The sensor that the others wait for.
    pub fn blocking(&self) -> Option<&Key> {
        self.blocking.as_ref()
    }

    /// Counts of all sensors so far, in arbitrary order.
    pub fn counts(&self) -> impl Iterator<Item = (&Key, SensorCounts)> {
        let running = self.queues.iter().map(|q| (&q.key, q.counts));
        running.chain(self.done.iter().map(|(key, counts)| (key, *counts)))
    }
}
