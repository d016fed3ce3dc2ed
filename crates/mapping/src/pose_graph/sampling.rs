//! Which of the many pairs of nodes and submaps are tried.

use std::collections::BTreeMap;

use portolan_sensor::FixedRatioSampler;

use crate::TrajectoryId;

/// Samplers that are made when they are first needed.
pub(super) struct Samplers<K> {
    ratio: f64,
    samplers: BTreeMap<K, FixedRatioSampler>,
}

impl<K: Ord> Samplers<K> {
    /// All with one ratio; one that makes no sense (options are checked elsewhere) samples nothing.
    pub fn new(ratio: f64) -> Self {
        Self { ratio, samplers: BTreeMap::new() }
    }

    /// Whether the turn of this one has come.
    pub fn pulse(&mut self, key: K) -> bool {
        if let Some(sampler) = self.samplers.get_mut(&key) {
            return sampler.pulse();
        }
        let Ok(mut sampler) = FixedRatioSampler::new(self.ratio) else { return false };
        let turn = sampler.pulse();
        self.samplers.insert(key, sampler);
        turn
    }

    /// Starts anew for this one.
    pub fn forget(&mut self, key: &K) {
        self.samplers.remove(key);
    }
}

/// Whose turn it is to be searched in a whole submap.
pub(super) struct WholeSubmapTurns {
    samplers: Samplers<TrajectoryId>,
    per_metre: f64,
    /// Searches that are due.
    due: BTreeMap<TrajectoryId, f64>,
}

impl WholeSubmapTurns {
    /// One pair in so many, whatever their number.
    pub fn new(sampling_ratio: f64) -> Self {
        Self { samplers: Samplers::new(sampling_ratio), per_metre: 0.0, due: BTreeMap::new() }
    }

    /// Each metre of way in so many submaps, however many there are; 0: as the ratio says.
    pub fn set_per_metre(&mut self, submaps: f64) {
        self.per_metre = submaps;
    }

    /// Whether to search a node of a trajectory, a step of so many metres after the one before, in one of so many
    /// submaps.
    pub fn is_due(&mut self, id: TrajectoryId, submaps: usize, step: f64) -> bool {
        if self.per_metre <= 0.0 {
            return self.samplers.pulse(id);
        }
        let due = self.due.entry(id).or_default();
        *due += (self.per_metre * step / submaps.max(1) as f64).clamp(0.0, 1.0);
        let is_due = *due >= 1.0;
        *due -= f64::from(u8::from(is_due));
        is_due
    }
}
