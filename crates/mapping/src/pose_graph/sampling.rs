//! Samples the pairs of nodes and submaps that are searched.

use std::collections::BTreeMap;

use portolan_sensor::FixedRatioSampler;

/// Samplers that are made when they are first needed.
pub(super) struct Samplers<K> {
    ratio: f64,
    samplers: BTreeMap<K, FixedRatioSampler>,
}

impl<K: Ord> Samplers<K> {
    /// All with one ratio; an invalid ratio (options are checked elsewhere) samples nothing.
    pub fn new(ratio: f64) -> Self {
        Self { ratio, samplers: BTreeMap::new() }
    }

    /// Whether the sampler of this key selects the next item.
    pub fn pulse(&mut self, key: K) -> bool {
        if let Some(sampler) = self.samplers.get_mut(&key) {
            return sampler.pulse();
        }
        let Ok(mut sampler) = FixedRatioSampler::new(self.ratio) else { return false };
        let turn = sampler.pulse();
        self.samplers.insert(key, sampler);
        turn
    }

    /// Resets the sampler of this key.
    pub fn forget(&mut self, key: &K) {
        self.samplers.remove(key);
    }
}
