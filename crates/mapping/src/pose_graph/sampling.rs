//! Which of the many pairs of nodes and submaps are tried.

use std::collections::BTreeMap;

use portolan_sensor::FixedRatioSampler;

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
