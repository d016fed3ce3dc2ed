//! Converts sweeps to clouds with the layout of Velodyne's ROS driver.

use std::sync::Arc;

use portolan_lidar_packets::Sweep;

use crate::{FieldType, Header, PointCloud2, PointField};

/// Size of a point, bytes: x, y, z, intensity and time as `f32`, ring as `u16`.
const POINT_BYTES: usize = 22;

/// The points of a sweep, each with its time in seconds after the stamp.
pub(crate) fn cloud_of(sweep: &Sweep, frame: &Arc<str>) -> PointCloud2 {
    let mut data = Vec::with_capacity(sweep.points.len() * POINT_BYTES);
    for point in &sweep.points {
        let [x, y, z] = point.position;
        for value in [x, y, z, point.intensity] {
            data.extend_from_slice(&value.to_le_bytes());
        }
        data.extend_from_slice(&point.ring.to_le_bytes());
        data.extend_from_slice(&point.seconds.to_le_bytes());
    }
    let field = |name: &str, offset: u32, field_type: FieldType| PointField {
        name: name.to_owned(),
        offset,
        field_type: Some(field_type),
        count: 1,
    };
    PointCloud2 {
        header: Header { stamp: sweep.stamp, frame_id: Arc::clone(frame) },
        height: 1,
        width: sweep.points.len() as u32,
        fields: vec![
            field("x", 0, FieldType::Float32),
            field("y", 4, FieldType::Float32),
            field("z", 8, FieldType::Float32),
            field("intensity", 12, FieldType::Float32),
            field("ring", 16, FieldType::Uint16),
            field("time", 18, FieldType::Float32),
        ],
        is_bigendian: false,
        point_step: POINT_BYTES as u32,
        row_step: data.len() as u32,
        data,
        is_dense: true,
    }
}
