//! MCAP files of another library, and ours read by it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

use mcap::{Compression, WriteOptions};
use portolan_recording::*;

use crate::sample::{assert_same, bytes, read_all, recorded};

/// The messages of a file we wrote, as the other library gives them.
fn by_the_library(data: &[u8]) -> Vec<mcap::Message<'_>> {
    mcap::MessageStream::new(data).unwrap().collect::<Result<_, _>>().unwrap()
}

#[test]
fn another_library_reads_our_files() {
    let messages = recorded(200);
    for compression in [McapCompression::None, McapCompression::Lz4, McapCompression::Zstd] {
        let data = bytes(RecordingFormat::Mcap(compression), &messages);
        let found = by_the_library(&data);
        assert_eq!(found.len(), messages.len());
        for (found, expected) in found.iter().zip(&messages) {
            assert_eq!(found.channel.topic, *expected.topic);
            assert_eq!(found.channel.message_encoding, "cdr");
            assert_eq!(found.log_time as i64, expected.log_time.unix_nanoseconds());
            let schema = found.channel.schema.as_ref().unwrap();
            assert_eq!(schema.name, expected.message.type_name().replacen('/', "/msg/", 1));
            assert_eq!(schema.encoding, "ros2msg");
            assert!(schema.data.windows(28).any(|w| w == b"builtin_interfaces/Time stam"));
        }
        let summary = mcap::Summary::read(&data).unwrap().unwrap();
        assert_eq!(summary.stats.as_ref().unwrap().message_count, messages.len() as u64);
        // Every message can be found through the indexes.
        let mut indexed = 0;
        for chunk in &summary.chunk_indexes {
            for entries in summary.read_message_indexes(&data, chunk).unwrap().values() {
                for entry in entries {
                    let message = summary.seek_message(&data, chunk, entry).unwrap();
                    assert_eq!(message.log_time, entry.log_time);
                    indexed += 1;
                }
            }
        }
        assert_eq!(indexed, messages.len());
    }
}

/// Our messages written anew by the other library; ROS 1 serialisation if `ros1`.
fn rewritten(options: WriteOptions, messages: &[RecordedMessage], ros1: bool) -> Vec<u8> {
    let data = bytes(RecordingFormat::Mcap(McapCompression::None), messages);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for message in by_the_library(&data) {
        let mut channel = (*message.channel).clone();
        let schema = channel.schema.take().unwrap();
        let (encoding, message_encoding) = if ros1 { ("ros1msg", "ros1") } else { ("ros2msg", "cdr") };
        let schema = writer.add_schema(&schema.name, encoding, &schema.data).unwrap();
        let id = writer.add_channel(schema, &channel.topic, message_encoding, &BTreeMap::new()).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: id,
            sequence: message.sequence,
            log_time: message.log_time,
            publish_time: message.publish_time,
        };
        writer.write_to_known_channel(&header, &message.data).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn files_of_every_shape_are_read() {
    let messages = recorded(60);
    let base = || WriteOptions::new().chunk_size(Some(20_000)).compression(Some(Compression::Zstd));
    let shapes = [
        base(),
        base().compression(Some(Compression::Lz4)),
        base().compression(None),
        base().use_chunks(false),
        base().emit_summary_records(false),
        base().emit_summary_records(false).emit_message_indexes(false),
        base().emit_message_indexes(false),
        base().emit_statistics(false),
        base().emit_chunk_indexes(false),
        base().repeat_channels(false),
        base().repeat_schemas(false),
        base().repeat_channels(false).emit_message_indexes(false),
        base().calculate_chunk_crcs(false).calculate_summary_section_crc(false),
        base().use_chunks(false).emit_summary_records(false),
    ];
    for (number, options) in shapes.into_iter().enumerate() {
        let recording = open_bytes("test", rewritten(options, &messages, false).into()).unwrap();
        let (found, issues) = read_all(&*recording);
        assert_eq!(issues, [], "shape {number}");
        assert_same(&found, &messages);
        assert!(recording.topics().iter().all(|topic| topic.count == Some(60)), "shape {number}");
        assert_eq!(recording.topics().len(), 10);
    }
}

#[test]
fn ros1_messages_inside_of_mcap_are_read() {
    let messages = recorded(20);
    let bag = bytes(RecordingFormat::Ros1Bag(BagCompression::None), &messages);
    // The payloads of an uncompressed bag, found by their record headers.
    let payloads: Vec<&[u8]> = bag
        .windows(9)
        .enumerate()
        .filter(|(_, window)| window.starts_with(b"\x04\0\0\0op=\x02"))
        .map(|(at, _)| {
            let length_at = at + 9 - 1 + 4 + 5 + 8;
            let length = u32::from_le_bytes(bag[length_at..length_at + 4].try_into().unwrap()) as usize;
            &bag[length_at + 4..length_at + 4 + length]
        })
        .collect();
    assert_eq!(payloads.len(), messages.len());
    let mut writer = WriteOptions::new().profile("ros1").create(Cursor::new(Vec::new())).unwrap();
    for (message, payload) in messages.iter().zip(payloads) {
        let schema = Arc::new(mcap::Schema {
            id: 0,
            name: message.message.type_name().to_owned(),
            encoding: "ros1msg".to_owned(),
            data: Cow::Borrowed(b""),
        });
        let schema = writer.add_schema(&schema.name, &schema.encoding, &schema.data).unwrap();
        let channel_id = writer.add_channel(schema, &message.topic, "ros1", &BTreeMap::new()).unwrap();
        let log_time = message.log_time.unix_nanoseconds() as u64;
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, payload).unwrap();
    }
    writer.finish().unwrap();
    let recording = open_bytes("test", writer.into_inner().into_inner().into()).unwrap();
    assert!(recording.format().starts_with("MCAP (ros1"));
    assert_same(&read_all(&*recording).0, &messages);
}

#[test]
fn unknown_encodings_are_listed_but_not_decoded() {
    let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    let schema = writer.add_schema("foxglove.LaserScan", "protobuf", b"").unwrap();
    let known = writer.add_schema("sensor_msgs/msg/LaserScan", "jsonschema", b"").unwrap();
    for (topic, schema) in [("/a", schema), ("/b", known), ("/c", 0)] {
        let channel_id = writer.add_channel(schema, topic, "json", &BTreeMap::new()).unwrap();
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: 7, publish_time: 7 };
        writer.write_to_known_channel(&header, b"{}").unwrap();
    }
    writer.finish().unwrap();
    let recording = open_bytes("test", writer.into_inner().into_inner().into()).unwrap();
    let (found, issues) = read_all(&*recording);
    assert_eq!(issues, []);
    let types: Vec<_> = found.iter().map(|message| message.message.type_name()).collect();
    assert_eq!(types, ["foxglove.LaserScan", "sensor_msgs/LaserScan", "unknown"]);
    assert!(found.iter().all(|message| matches!(message.message, Message::Other { bytes: 2, .. })));
}

#[test]
fn messages_compressed_one_by_one_are_read() {
    let messages = recorded(5);
    let data = bytes(RecordingFormat::Mcap(McapCompression::None), &messages);
    let mut writer = WriteOptions::new().create(Cursor::new(Vec::new())).unwrap();
    for message in by_the_library(&data) {
        let schema = message.channel.schema.as_ref().unwrap();
        let schema = writer.add_schema(&schema.name, "ros2msg", &schema.data).unwrap();
        let channel_id = writer.add_channel(schema, &message.channel.topic, "cdr", &BTreeMap::new()).unwrap();
        let (sequence, log_time) = (0, message.log_time);
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        let packed = zstd::bulk::compress(&message.data, 1).unwrap();
        writer.write_to_known_channel(&header, &packed).unwrap();
    }
    writer.finish().unwrap();
    let recording = open_bytes("test", writer.into_inner().into_inner().into()).unwrap();
    assert_same(&read_all(&*recording).0, &messages);
}
