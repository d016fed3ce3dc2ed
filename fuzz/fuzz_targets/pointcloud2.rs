//! Point clouds of any layout, through survey, plan and conversion.
#![no_main]

use libfuzzer_sys::fuzz_target;
use portolan_geometry::Time;
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_recording::{FieldType, Header, MemoryRecording, Message, PointCloud2, PointField, RecordedMessage};

const NAMES: [&str; 8] = ["x", "y", "z", "time", "t", "intensity", "timestamp", "offset_time"];
const TYPES: [Option<FieldType>; 9] = [
    None,
    Some(FieldType::Int8),
    Some(FieldType::Uint8),
    Some(FieldType::Int16),
    Some(FieldType::Uint16),
    Some(FieldType::Int32),
    Some(FieldType::Uint32),
    Some(FieldType::Float32),
    Some(FieldType::Float64),
];

fuzz_target!(|input: (Vec<(u8, u32, u8, u32)>, [u32; 4], [bool; 3], Vec<u8>)| {
    let (fields, [width, height, point_step, row_step], [is_bigendian, is_dense, with_intensities], data) =
        input;
    let field = |(name, offset, field_type, count): (u8, u32, u8, u32)| PointField {
        name: NAMES[usize::from(name) % NAMES.len()].to_owned(),
        offset,
        field_type: TYPES[usize::from(field_type) % TYPES.len()],
        count,
    };
    let fields: Vec<PointField> = fields.into_iter().take(20).map(field).collect();
    let message = |second: i64| RecordedMessage {
        topic: "/points".into(),
        log_time: Time::from_ros(second, 0),
        message: Message::PointCloud2(PointCloud2 {
            header: Header { stamp: Time::from_ros(second, 0), frame_id: "lidar".into() },
            height,
            width,
            fields: fields.clone(),
            is_bigendian,
            point_step,
            row_step,
            data: data.clone(),
            is_dense,
        }),
    };
    let recording = MemoryRecording::new(vec![message(1), message(2)]);
    let options = IngestOptions { with_intensities, ..IngestOptions::default() };
    if let Ok(ingestion) = Ingestion::new(&recording, &options) {
        ingestion.for_each(drop);
    }
});
