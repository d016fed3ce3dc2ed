//! Points on their way through the pipeline.

use std::sync::Arc;

use portolan_geometry::{Point3f, Time};

use crate::colour::Rgb;

/// Points of one message of a sensor, in a frame near the map.
#[derive(Clone, Debug, PartialEq)]
pub struct PointsBatch {
    /// Stamp of the message.
    pub start_time: Time,
    /// Position of the sensor in that frame, metres.
    pub origin: Point3f,
    /// Frame of the sensor.
    pub frame_id: Arc<str>,
    /// Number of the recording.
    pub trajectory_id: usize,
    /// Positions in that frame, metres.
    pub points: Vec<Point3f>,
    /// One for each point, or empty.
    pub intensities: Vec<f32>,
    /// One for each point, or empty.
    pub colors: Vec<Rgb>,
}

impl PointsBatch {
    /// Leaves only some points, with what belongs to them.
    pub fn retain(&mut self, mut keep: impl FnMut(&Point3f) -> bool) {
        let kept: Vec<bool> = self.points.iter().map(&mut keep).collect();
        retain_marked(&mut self.points, &kept);
        retain_marked(&mut self.intensities, &kept);
        retain_marked(&mut self.colors, &kept);
    }
}

fn retain_marked<T>(values: &mut Vec<T>, kept: &[bool]) {
    let mut marks = kept.iter();
    values.retain(|_| marks.next().copied().unwrap_or(false));
}

/// The voxel of a point in a lattice of cells of this size, metres, one of them centred at the origin. None for
/// what is no number.
pub(super) fn voxel_of(point: &Point3f, size: f32) -> Option<[i32; 3]> {
    let index = [point.x / size, point.y / size, point.z / size];
    index.iter().all(|i| i.is_finite()).then(|| index.map(|i| i.round() as i32))
}
