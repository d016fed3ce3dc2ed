//! Batches of points in the pipeline.

use std::sync::Arc;

use portolan_geometry::{Point3f, Time};

use crate::colour::Rgb;

/// Points of one message of a sensor, in a near frame of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct PointsBatch {
    /// Time stamp of the message.
    pub start_time: Time,
    /// Position of the sensor in that frame, metres.
    pub origin: Point3f,
    /// Name of the sensor's frame.
    pub frame_id: Arc<str>,
    /// Number of the recording.
    pub trajectory_id: usize,
    /// Positions in that frame, metres.
    pub points: Vec<Point3f>,
    /// Intensity of each point, or empty.
    pub intensities: Vec<f32>,
    /// Colour of each point, or empty.
    pub colors: Vec<Rgb>,
}

impl PointsBatch {
    /// Keeps only some points, with their intensities and colours.
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

/// The voxel of a point in a lattice with cells of this size, metres, one of them centred at the origin. None
/// for points that are not finite.
pub(super) fn voxel_of(point: &Point3f, size: f32) -> Option<[i32; 3]> {
    let index = [point.x / size, point.y / size, point.z / size];
    index.iter().all(|i| i.is_finite()).then(|| index.map(|i| i.round() as i32))
}
