//! IMU samples between two scans.

use portolan_geometry::Time;
use portolan_sensor::ImuData;

/// So many samples are kept while no scan comes: 100 s at 200 Hz.
const MAX_SAMPLES: usize = 20_000;

/// Samples since the last scan, and the last one before.
#[derive(Clone, Debug, Default)]
pub struct ImuBuffer {
    samples: Vec<ImuData>,
}

impl ImuBuffer {
    /// Takes a sample, in order of time. Without scans nothing is integrated; then samples are forgotten, and the gap is
    /// noticed.
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

    /// How many samples were taken until a time, that time included.
    pub fn count_until(&self, time: Time) -> usize {
        self.samples.partition_point(|s| s.time <= time)
    }

    /// Forgets what was taken before the last sample until a time.
    pub fn forget_until(&mut self, time: Time) {
        let after = self.count_until(time);
        self.samples.drain(..after.saturating_sub(1));
    }
}
