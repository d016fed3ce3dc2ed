//! Fuzz targets for messages: serialised ROS messages, lidar packets, and point clouds of any layout.

use portolan_geometry::{Duration, Time};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_issue::IssueLog;
use portolan_lidar_packets::{Datagrams, OusterMetadata, PacketSource, SensorTime, parse_calibration};
use portolan_recording::{
    FieldType, Header, MemoryRecording, Message, PointCloud2, PointField, RecordedMessage, open_bytes,
};

const TYPES: [&str; 9] = [
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/MultiEchoLaserScan",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Imu",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/NavSatFix",
    "tf2_msgs/msg/TFMessage",
    "geometry_msgs/msg/PoseStamped",
    "cartographer_ros_msgs/msg/LandmarkList",
];
const NAMES: [&str; 8] = ["x", "y", "z", "time", "t", "intensity", "timestamp", "offset_time"];
const FIELD_TYPES: [Option<FieldType>; 9] = [
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

/// Reads numbers from the front of the bytes; after their end, zeros.
struct Input<'a>(&'a [u8]);

impl Input<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let taken = self.0.get(..N).and_then(|bytes| bytes.try_into().ok()).unwrap_or([0; N]);
        self.0 = self.0.get(N..).unwrap_or_default();
        taken
    }

    fn byte(&mut self) -> u8 {
        u8::from_le_bytes(self.take())
    }

    fn word(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }
}

fn record(file: &mut Vec<u8>, op: u8, content: &[u8]) {
    file.push(op);
    file.extend((content.len() as u64).to_le_bytes());
    file.extend(content);
}

fn string(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// A serialised message as the only message of an MCAP file: the first byte selects the type, the second whether it is
/// CDR or ROS 1 serialisation.
pub fn cdr(bytes: &[u8]) {
    let mut input = Input(bytes);
    let (kind, is_cdr) = (input.byte(), input.byte() % 2 == 0);
    let name = TYPES.get(usize::from(kind) % TYPES.len()).copied().unwrap_or_default();
    let mut file = b"\x89MCAP0\r\n".to_vec();
    record(&mut file, 3, &[&[1, 0], string(name).as_slice(), &string(""), &string("")].concat());
    let encoding = if is_cdr { "cdr" } else { "ros1" };
    record(&mut file, 4, &[&[0, 0, 1, 0], string("/tf").as_slice(), &string(encoding), &string("")].concat());
    record(&mut file, 5, &[&[0; 22], input.0].concat());
    if let Ok(recording) = open_bytes("fuzz.mcap", file.into())
        && let Ok(mut reader) = recording.read(&|_| true)
    {
        while let Ok(Some(_)) = reader.next_message() {}
    }
}

/// Lidar packets without a capture file. The bytes are a link type, the size of a description, the description, and
/// packets, each preceded by its size (two bytes) and the time since the last packet (two bytes).
pub fn packets(bytes: &[u8]) {
    let mut input = Input(bytes);
    let (link_type, length) = (input.word(), usize::from(u16::from_le_bytes(input.take())));
    let (description, rest) = input.0.split_at(length.min(input.0.len()));
    let description = String::from_utf8_lossy(description);
    let mut input = Input(rest);
    let mut packets = Vec::new();
    while !input.0.is_empty() && packets.len() < 256 {
        let (size, time): ([u8; 2], [u8; 2]) = (input.take(), input.take());
        let (packet, rest) = input.0.split_at(usize::from(u16::from_le_bytes(size)).min(input.0.len()));
        packets.push((i64::from(u16::from_le_bytes(time)) * 1000, packet));
        input = Input(rest);
    }
    let (mut issues, mut datagrams) = (IssueLog::default(), Datagrams::default());
    let metadata = OusterMetadata::parse(&description);
    let first = packets.first().map_or(&[][..], |(_, bytes)| bytes);
    let lidar = PacketSource::ouster_lidar(metadata.as_ref(), first, u16::MAX, &mut issues);
    let velodyne = PacketSource::Velodyne(parse_calibration(&description));
    for source in [Some(velodyne), Some(PacketSource::OusterImu), lidar].into_iter().flatten() {
        let (mut decoder, mut clock) = (source.decoder(), SensorTime::default());
        let mut arrival = Time::from_ros(1_700_000_000, 0);
        for (ticks, bytes) in &packets {
            arrival += Duration::from_ticks(*ticks);
            decoder.push((bytes, arrival), &mut clock, &mut issues, &mut |_| {});
            datagrams.take(link_type, bytes, &mut issues);
        }
        decoder.finish();
    }
    datagrams.finish(&mut issues);
}

/// Point clouds of any layout, through survey, plan and conversion. The bytes are the number of fields, the fields,
/// sizes, flags and data.
pub fn pointcloud2(bytes: &[u8]) {
    let mut input = Input(bytes);
    let count = input.byte() % 20;
    let fields: Vec<PointField> = (0..count)
        .map(|_| PointField {
            name: NAMES.get(usize::from(input.byte()) % NAMES.len()).copied().unwrap_or_default().to_owned(),
            field_type: FIELD_TYPES.get(usize::from(input.byte()) % FIELD_TYPES.len()).copied().flatten(),
            offset: input.word(),
            count: input.word(),
        })
        .collect();
    let [width, height, point_step, row_step] = [(); 4].map(|()| input.word());
    let flags = input.byte();
    let [is_bigendian, is_dense, with_intensities] = [1, 2, 4].map(|flag| flags & flag != 0);
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
            data: input.0.to_vec(),
            is_dense,
        }),
    };
    let recording = MemoryRecording::new(vec![message(1), message(2)]);
    let options = IngestOptions { with_intensities, ..IngestOptions::default() };
    if let Ok(ingestion) = Ingestion::new(&recording, &options) {
        ingestion.for_each(drop);
    }
}
