//! The pbstream container: real maps, round trips, damage.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::io::{self, Cursor, Write};
use std::sync::{Arc, Mutex};

use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{self, Trajectory, trajectory};
use portolan_pbstream::{
    FORMAT_VERSION, MapReader, Message, MessageKind, PbstreamError, PbstreamReader, PbstreamWriter,
    RawMessage, ReadLimits, gzip,
};
use portolan_testing::real_maps;
use proptest::prelude::*;
use prost::Message as _;

/// Bytes that stay reachable after a writer is gone.
#[derive(Clone, Default)]
struct Sink(Arc<Mutex<Vec<u8>>>);

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn written(messages: impl IntoIterator<Item = Vec<u8>>) -> Vec<u8> {
    let sink = Sink::default();
    let mut writer = PbstreamWriter::to_sink(sink.clone(), "memory").unwrap();
    messages.into_iter().for_each(|m| writer.write_bytes(m).unwrap());
    writer.finish().unwrap();
    let bytes = sink.0.lock().unwrap();
    bytes.clone()
}

fn reader(bytes: Vec<u8>) -> Result<PbstreamReader, PbstreamError> {
    let length = Some(bytes.len() as u64);
    PbstreamReader::from_source(Cursor::new(bytes), length, ReadLimits::default())
}

fn all(bytes: Vec<u8>) -> Result<Vec<RawMessage>, PbstreamError> {
    reader(bytes)?.collect()
}

fn map_reader(messages: Vec<Vec<u8>>) -> Result<MapReader, PbstreamError> {
    let bytes = written(messages);
    MapReader::from_source(Cursor::new(bytes), None, ReadLimits::default())
}

fn message(data: Data) -> Vec<u8> {
    mapping::SerializedData { data: Some(data) }.encode_to_vec()
}

fn start(version: u32) -> Vec<Vec<u8>> {
    vec![
        mapping::SerializationHeader { format_version: version, ..Default::default() }.encode_to_vec(),
        message(Data::PoseGraph(mapping::PoseGraph::default())),
        message(Data::AllTrajectoryBuilderOptions(mapping::AllTrajectoryBuilderOptions::default())),
    ]
}

fn every_kind() -> Vec<Data> {
    vec![
        Data::Submap(mapping::Submap::default()),
        Data::Node(mapping::Node::default()),
        Data::TrajectoryData(mapping::TrajectoryData::default()),
        Data::ImuData(mapping::ImuData::default()),
        Data::OdometryData(mapping::OdometryData::default()),
        Data::FixedFramePoseData(mapping::FixedFramePoseData::default()),
        Data::LandmarkData(mapping::LandmarkData::default()),
    ]
}

#[test]
fn real_maps_survive_reading_and_writing() {
    let folder = tempfile::tempdir().unwrap();
    for path in real_maps() {
        let before: Vec<RawMessage> = PbstreamReader::open(&path).unwrap().collect::<Result<_, _>>().unwrap();
        let copy = folder.path().join("copy.pbstream");
        let mut writer = PbstreamWriter::create(&copy).unwrap();
        before.iter().for_each(|m| writer.write_bytes(m.bytes.clone()).unwrap());
        writer.finish().unwrap();
        let after: Vec<RawMessage> = PbstreamReader::open(&copy).unwrap().collect::<Result<_, _>>().unwrap();
        assert!(before.iter().map(|m| &m.bytes).eq(after.iter().map(|m| &m.bytes)), "{}", path.display());

        // Decoding and encoding loses nothing but the sign of zeros, which the encoder takes for absent.
        for raw in &before {
            let decoded = raw.decode().unwrap();
            let encoded = match decoded.clone() {
                Message::Header(header) => header.encode_to_vec(),
                Message::Data(data) => message(*data),
                Message::Unknown(tag) => panic!("unknown tag {tag} in {}", path.display()),
            };
            if encoded != raw.bytes {
                let negative_zero = (-0.0_f64).to_le_bytes();
                assert!(raw.bytes.windows(8).any(|w| w == negative_zero), "{}", path.display());
                let again = RawMessage { bytes: encoded, ..*raw }.decode().unwrap();
                assert!(again == decoded, "{} message {}", path.display(), raw.index);
            }
        }
    }
}

#[test]
fn real_maps_open_as_maps() {
    for path in real_maps() {
        let mut reader = MapReader::open(&path).unwrap();
        assert!(!reader.pose_graph().trajectory.is_empty());
        let (mut nodes, mut submaps) = (0, 0);
        while let Some(message) = reader.next_message().unwrap() {
            match message.data {
                Data::Node(_) => nodes += 1,
                Data::Submap(_) => submaps += 1,
                _ => {}
            }
        }
        let trajectories = &reader.pose_graph().trajectory;
        assert_eq!(nodes, trajectories.iter().map(|t| t.node.len()).sum::<usize>(), "{}", path.display());
        assert_eq!(submaps, trajectories.iter().map(|t| t.submap.len()).sum::<usize>());
        assert_eq!(reader.ignored(), Default::default());
        assert_eq!(Some(reader.bytes_read()), reader.length());
    }
}

#[test]
fn messages_come_back_in_order() {
    let trajectories: Vec<Vec<u8>> = (0..10)
        .map(|i| {
            let node = trajectory::Node { node_index: i, timestamp: i64::from(i), pose: None };
            Trajectory { node: vec![node], ..Trajectory::default() }.encode_to_vec()
        })
        .collect();
    let mut reader = reader(written(trajectories)).unwrap();
    for i in 0..10 {
        let raw = reader.next_message().unwrap().unwrap();
        let trajectory = Trajectory::decode(&*raw.bytes).unwrap();
        assert_eq!((raw.index, trajectory.node[0].timestamp), (i, i as i64));
    }
    assert_eq!(reader.next_message().unwrap(), None);
    assert_eq!(reader.next_message().unwrap(), None);
}

#[test]
fn a_map_begins_with_three_messages() {
    for version in [1, 2] {
        let mut messages = start(version);
        messages.extend(every_kind().into_iter().map(message));
        let mut reader = map_reader(messages).unwrap();
        assert_eq!(reader.header().format_version, version);
        for expected in every_kind() {
            assert_eq!(reader.next_message().unwrap().unwrap().data, expected);
        }
        assert_eq!(reader.next_message().unwrap(), None);
    }
    let error = |messages: Vec<Vec<u8>>| map_reader(messages).err().unwrap().to_string();
    assert!(error(start(123)).contains("Unsupported serialization format \"123\""));
    assert!(error(start(2)[..1].to_vec()).contains("Serialized stream misses PoseGraph."));
    assert!(error(vec![]).contains("there is no header"));
    let mut swapped = start(2);
    swapped.swap(1, 2);
    assert!(
        error(swapped).contains("Expecting `PoseGraph` after `SerializationHeader`, but got field tag 2")
    );
    let mut more = start(2);
    more[1] = message(Data::PoseGraph(mapping::PoseGraph {
        trajectory: vec![Trajectory::default()],
        ..mapping::PoseGraph::default()
    }));
    assert!(error(more).contains("options for 0 trajectories but poses of 1"));
}

#[test]
fn unknown_messages_are_counted_and_survive() {
    let mut messages = start(2);
    let unknown = vec![0xa2, 6, 3, 1, 2, 3];
    messages.extend([unknown.clone(), vec![], messages[1].clone(), messages[2].clone()]);
    let copies = all(written(messages.clone())).unwrap();
    assert_eq!(copies.iter().map(|m| m.bytes.clone()).collect::<Vec<_>>(), messages);
    let kinds: Vec<MessageKind> = copies.iter().map(RawMessage::kind).collect();
    assert_eq!(
        kinds[..5],
        [
            MessageKind::Header,
            MessageKind::PoseGraph,
            MessageKind::Options,
            MessageKind::Unknown(100),
            MessageKind::Unknown(0)
        ]
    );
    let mut reader = map_reader(messages).unwrap();
    assert_eq!(reader.next_message().unwrap(), None);
    let ignored = reader.ignored();
    assert_eq!((ignored.unknown, ignored.pose_graphs, ignored.options), (2, 1, 1));
}

#[test]
fn the_number_of_threads_does_not_change_the_bytes() {
    let Some(path) = real_maps().into_iter().find(|p| p.ends_with("corridor_imu.pbstream")) else { return };
    let pack = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let messages: Vec<RawMessage> =
                PbstreamReader::open(&path).unwrap().collect::<Result<_, _>>().unwrap();
            crc32fast::hash(&written(messages.into_iter().map(|m| m.bytes)))
        })
    };
    let one = pack(1);
    assert_eq!([pack(2), pack(4)], [one, one]);
}

#[test]
fn wrong_sizes_are_errors_before_memory_is_reserved() {
    let good = written(start(2));
    for wrong_size in [u64::MAX, 1 << 40, good.len() as u64] {
        let mut bad = good.clone();
        bad.extend_from_slice(&wrong_size.to_le_bytes());
        bad.extend_from_slice(&[0; 7]);
        for length in [Some(bad.len() as u64), None] {
            let source = Cursor::new(bad.clone());
            let mut reader = PbstreamReader::from_source(source, length, ReadLimits::default()).unwrap();
            for _ in 0..3 {
                assert!(reader.next_message().unwrap().is_some());
            }
            let error = reader.next_message().unwrap_err().to_string();
            assert!(error.starts_with(&format!("message 3 at byte {}:", good.len())), "{error}");
            assert_eq!(reader.next_message().unwrap(), None);
        }
    }
}

#[test]
fn bombs_are_refused_and_the_rest_is_read() {
    let limits = ReadLimits { max_message_bytes: 40_000_000, ..ReadLimits::default() };
    let mut messages = start(2);
    // Within the limit although larger than what is unpacked ahead, beyond the limit, small.
    messages.extend([vec![0; 39_000_000], vec![0; 41_000_000], message(every_kind().remove(1))]);
    let bytes = written(messages);
    let mut reader = PbstreamReader::from_source(Cursor::new(bytes), None, limits).unwrap();
    let lengths: Vec<Option<usize>> =
        reader.by_ref().map(|m| m.ok().map(|m| m.bytes.len())).skip(3).collect();
    assert_eq!(lengths, [Some(39_000_000), None, Some(2)]);
}

#[test]
fn invalid_writes_fail() {
    let folder = tempfile::tempdir().unwrap();
    let error = PbstreamWriter::create(folder.path().join("no/map.pbstream")).err().unwrap();
    assert!(error.to_string().contains("does not exist"), "{error}");
    let path = folder.path().join("map.pbstream");
    let mut writer = PbstreamWriter::create(&path).unwrap();
    writer.write_header(FORMAT_VERSION).unwrap();
    drop(writer);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    if cfg!(target_os = "linux") {
        let mut writer = PbstreamWriter::create("/dev/full").unwrap();
        writer.write_header(FORMAT_VERSION).unwrap();
        assert!(matches!(writer.finish(), Err(PbstreamError::Write { .. })));
    }
}

fn sample() -> (Vec<Vec<u8>>, Vec<u8>) {
    let mut messages = start(2);
    messages.extend(every_kind().into_iter().map(message));
    messages.push(message(Data::ImuData(mapping::ImuData {
        trajectory_id: 7,
        imu_data: None,
        derived_from_poses: false,
    })));
    let bytes = written(messages.clone());
    (messages, bytes)
}

proptest! {
    #[test]
    fn truncation_is_an_error_unless_between_records(at in any::<prop::sample::Index>()) {
        let (messages, bytes) = sample();
        let cut = at.index(bytes.len());
        match reader(bytes[..cut].to_vec()) {
            Err(error) => prop_assert!(cut < 8, "{}", error),
            Ok(reader) => {
                let (good, bad): (Vec<_>, Vec<_>) = reader.partition(Result::is_ok);
                let whole: usize = 8 + messages.iter().take(good.len()).map(|m| 8 + gzip(m).unwrap().len()).sum::<usize>();
                prop_assert_eq!(bad.len(), usize::from(whole != cut));
                for (raw, expected) in good.into_iter().zip(&messages) {
                    prop_assert_eq!(&raw.unwrap().bytes, expected);
                }
            }
        }
    }

    #[test]
    fn flipped_bits_never_change_data_silently(at in any::<prop::sample::Index>(), bit in 0..8u8) {
        let (messages, mut bytes) = sample();
        let byte = at.index(bytes.len());
        bytes[byte] ^= 1 << bit;
        let Ok(reader) = reader(bytes) else { return Ok(()) };
        let (good, bad): (Vec<_>, Vec<_>) = reader.partition(Result::is_ok);
        for raw in good.iter().flatten() {
            prop_assert_eq!(&raw.bytes, &messages[raw.index as usize]);
        }
        prop_assert!(!bad.is_empty() || good.len() == messages.len());
    }

    #[test]
    fn any_bytes_are_read_without_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let magic = 0x7b1d_1f7b_5bf5_01db_u64.to_le_bytes();
        bytes.splice(0..0, magic);
        let _ = all(bytes.clone());
        let _ = MapReader::from_source(Cursor::new(bytes), None, ReadLimits::default()).err();
    }

    #[test]
    fn any_message_is_decoded_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let raw = RawMessage { index: 5, offset: 0, bytes };
        let _ = raw.decode();
        let _ = raw.kind();
    }
}
