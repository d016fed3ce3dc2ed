//! Points of a sweep as they come out of packets, and the cloud they become.

use std::sync::Arc;

use portolan_geometry::Time;

use crate::{FieldType, Header, PointCloud2, PointField};

/// x, y, z, intensity and time as `f32`, ring as `u16`: the layout of Velodyne's ROS driver.
const POINT_BYTES: usize = 22;
/// No sweep has more points; longer ones are cut.
const MAX_POINTS: usize = 1 << 21;

/// One point in the frame of its sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PacketPoint {
    /// Metres.
    pub position: [f64; 3],
    pub intensity: f32,
    /// Number of its beam, from below.
    pub ring: u16,
    /// When it was measured.
    pub time: Time,
}

/// Collects the points of one sweep.
#[derive(Clone, Debug)]
pub(crate) struct CloudBuilder {
    frame: Arc<str>,
    stamp: Option<Time>,
    data: Vec<u8>,
}

impl CloudBuilder {
    pub fn new(frame: &str) -> Self {
        Self { frame: frame.into(), stamp: None, data: Vec::new() }
    }

    /// Adds a point; the first one's time becomes the stamp.
    pub fn push(&mut self, point: &PacketPoint) {
        let stamp = *self.stamp.get_or_insert(point.time);
        let time = (point.time - stamp).seconds() as f32;
        let [x, y, z] = point.position.map(|v| v as f32);
        for value in [x, y, z, point.intensity] {
            self.data.extend_from_slice(&value.to_le_bytes());
        }
        self.data.extend_from_slice(&point.ring.to_le_bytes());
        self.data.extend_from_slice(&time.to_le_bytes());
    }

    /// Whether no more points should be added.
    pub fn is_full(&self) -> bool {
        self.data.len() >= MAX_POINTS * POINT_BYTES
    }

    /// Seconds since the first point.
    pub fn age(&self, now: Time) -> f64 {
        self.stamp.map_or(0.0, |stamp| (now - stamp).seconds())
    }

    /// The sweep, if it has points; the builder is empty afterwards.
    pub fn take(&mut self) -> Option<PointCloud2> {
        let stamp = self.stamp.take()?;
        let capacity = self.data.len();
        let data = std::mem::replace(&mut self.data, Vec::with_capacity(capacity));
        Some(cloud(Header { stamp, frame_id: Arc::clone(&self.frame) }, data))
    }
}

fn cloud(header: Header, data: Vec<u8>) -> PointCloud2 {
    let field = |name: &str, offset: u32, field_type: FieldType| PointField {
        name: name.to_owned(),
        offset,
        field_type: Some(field_type),
        count: 1,
    };
    PointCloud2 {
        header,
        height: 1,
        width: (data.len() / POINT_BYTES) as u32,
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

/// Little-endian values out of a packet; 0 beyond its end, which callers have checked.
pub(crate) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    bytes.get(at..at + 2).and_then(|b| b.try_into().ok()).map_or(0, u16::from_le_bytes)
}

pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes)
}

pub(crate) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..at + 8).and_then(|b| b.try_into().ok()).map_or(0, u64::from_le_bytes)
}

pub(crate) fn f32_at(bytes: &[u8], at: usize) -> f32 {
    f32::from_bits(u32_at(bytes, at))
}
