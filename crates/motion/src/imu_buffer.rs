//! Buffers the IMU samples between two scans.

use portolan_geometry::Time;
use portolan_sensor::ImuData;

/// Maximum number of samples that are kept while no scan comes: 100 s at 200 Hz.
const MAX_SAMPLES: usize = 20_000;

/// Samples since the last scan, and the last one before it.
#[derive(Clone, Debug, Default)]
pub struct ImuBuffer {
    samples: Vec<ImuData>,
}

impl ImuBuffer {
    /// Takes a sample, in order of time. If no scans come, samples are not integrated; when the buffer is
    /// full, it is cleared, and the gap is detected later.
    pub fn push(&mut self, data: &ImuData) {
        if self.samples.len() >= MAX_SAMPLES {
            self.samples.clear();
        }
        self.samples.push(*data);
    }

    /// All samples.
    pub fn all(&self) -> &[ImuData] {
        &self.samples
    }

    /// Number of samples up to and including a time.
    pub fn count_until(&self, time: Time) -> usize {
        self.samples.partition_point(|s| s.time <= time)
    }

    /// Drops all samples before the last one at or before a time.
    pub fn forget_until(&mut self, time: Time) {
        let after = self.count_until(time);
        self.samples.drain(..after.saturating_sub(1));
    }
}
