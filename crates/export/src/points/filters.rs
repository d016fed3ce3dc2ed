//! Stages that filter and count points.

use portolan_sensor::FixedRatioSampler;

use super::{Flush, Log, PointsBatch, PointsError, Stage};

/// `dump_num_points`: logs the number of points.
#[derive(Default)]
pub(super) struct CountPoints {
    count: u64,
}

impl Stage for CountPoints {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        self.count += batch.points.len() as u64;
        Ok(true)
    }

    fn end_pass(&mut self, flush: Flush, log: Log) -> Result<(), PointsError> {
        let how = match flush {
            Flush::Restart => "restarting stream",
            Flush::Finished => "finishing",
        };
        log(&format!("Processed {} and {how}.", std::mem::take(&mut self.count)));
        Ok(())
    }
}

/// `fixed_ratio_sampler`: keeps an evenly spread fraction of the points.
pub(super) struct Sample {
    start: FixedRatioSampler,
    sampler: FixedRatioSampler,
}

impl Sample {
    pub fn new(ratio: f64) -> Result<Self, PointsError> {
        let bad = |reason| PointsError::Setting { action: "fixed_ratio_sampler", reason };
        let start = FixedRatioSampler::new(ratio).map_err(|e| bad(e.to_string()))?;
        if ratio <= 0.0 || ratio >= 1.0 {
            return Err(bad(format!("sampling_ratio is {ratio}: it must be above 0 and below 1")));
        }
        Ok(Self { sampler: start.clone(), start })
    }
}

impl Stage for Sample {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        batch.retain(|_| self.sampler.pulse());
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, _log: Log) -> Result<(), PointsError> {
        // Every pass keeps the same points.
        self.sampler = self.start.clone();
        Ok(())
    }
}

/// `frame_id_filter`: filters batches by the sensor.
pub(super) enum FrameFilter {
    /// Keeps only these.
    Keep(Vec<String>),
    /// Keeps all others.
    Drop(Vec<String>),
}

impl Stage for FrameFilter {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        let is_in = |frames: &[String]| frames.iter().any(|frame| **frame == *batch.frame_id);
        Ok(match self {
            Self::Keep(frames) => is_in(frames),
            Self::Drop(frames) => !is_in(frames),
        })
    }

    fn end_pass(&mut self, _flush: Flush, _log: Log) -> Result<(), PointsError> {
        Ok(())
    }
}

/// `min_max_range_filter`: keeps points by their distance from the sensor, metres.
pub(super) struct RangeFilter {
    min_squared: f32,
    max_squared: f32,
}

impl RangeFilter {
    pub fn new(min_range: f64, max_range: f64) -> Self {
        let squared = |range: f64| (range * range) as f32;
        Self { min_squared: squared(min_range), max_squared: squared(max_range) }
    }
}

impl Stage for RangeFilter {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        let origin = batch.origin;
        batch.retain(|p| (self.min_squared..=self.max_squared).contains(&(p - origin).norm_squared()));
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, _log: Log) -> Result<(), PointsError> {
        Ok(())
    }
}

/// `vertical_range_filter`: keeps points by their height above the sensor, metres.
pub(super) struct HeightFilter {
    pub min_z: f32,
    pub max_z: f32,
}

impl Stage for HeightFilter {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        let z = batch.origin.z;
        batch.retain(|p| (self.min_z..=self.max_z).contains(&(p.z - z)));
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, _log: Log) -> Result<(), PointsError> {
        Ok(())
    }
}
