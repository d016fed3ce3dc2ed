//! Stages that colour points.

use super::{Flush, Log, PointsBatch, PointsError, Stage};
use crate::colour::Rgb;

/// `color_points`: one colour for all points of a sensor.
pub(super) struct ColourSensor {
    pub frame_id: String,
    pub colour: Rgb,
}

impl Stage for ColourSensor {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        if *self.frame_id == *batch.frame_id {
            batch.colors.clear();
            batch.colors.resize(batch.points.len(), self.colour);
        }
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, _log: Log) -> Result<(), PointsError> {
        Ok(())
    }
}

/// `intensity_to_color`: grey by intensity, for points with an intensity.
pub(super) struct IntensityToGrey {
    /// Sensor to which it applies; empty for all sensors.
    pub frame_id: String,
    pub min_intensity: f32,
    pub max_intensity: f32,
}

impl Stage for IntensityToGrey {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        let is_meant = self.frame_id.is_empty() || *self.frame_id == *batch.frame_id;
        if is_meant && !batch.intensities.is_empty() {
            let span = self.max_intensity - self.min_intensity;
            let grey = |i: &f32| [((i - self.min_intensity) / span).clamp(0.0, 1.0); 3];
            batch.colors = batch.intensities.iter().map(grey).collect();
        }
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, _log: Log) -> Result<(), PointsError> {
        Ok(())
    }
}
