//! Stores the results of matching, so that an interrupted job can continue.

use portolan_geometry::{Rigid3, Time};
use portolan_recall::{Answer, Fingerprint, Memory};
use portolan_sensor::PointCloud;

/// A memory, and the fingerprint of the scans processed so far.
#[derive(Debug)]
pub(crate) struct RememberedScans {
    memory: Memory,
    seen: Fingerprint,
}

impl Default for RememberedScans {
    fn default() -> Self {
        Self::new(&Memory::default())
    }
}

impl RememberedScans {
    /// Stores results in this memory.
    pub fn new(memory: &Memory) -> Self {
        Self { memory: memory.clone(), seen: Fingerprint::of("scans") }
    }

    /// Adds the next scan to the fingerprint. The grids follow from the scans before.
    pub fn note(&mut self, time: Time, prediction: &Rigid3, clouds: [&PointCloud; 2]) {
        if !self.memory.is_on() {
            return;
        }
        self.seen.add((time, *prediction));
        for cloud in clouds {
            self.seen.add_f32s(cloud.points.iter().flat_map(|p| [p.x, p.y, p.z]));
        }
    }

    /// The result of matching the scan around a pose: computed, or stored by an earlier run.
    pub fn answer<T: Answer>(&self, around: impl Answer, find: impl FnOnce() -> T) -> T {
        let ask = |question: &mut Fingerprint| {
            question.add_word(self.seen.value());
            question.add(around);
        };
        self.memory.answer(ask, find)
    }
}
