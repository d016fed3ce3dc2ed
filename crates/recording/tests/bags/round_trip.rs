//! What was written comes back.

use std::io::Write;
use std::path::Path;

use portolan_recording::*;

use crate::sample::{FORMATS, assert_same, bytes, read_all, recorded, time, write};

#[test]
fn every_message_type_survives_every_container() {
    let messages = recorded(60);
    for format in FORMATS {
        let recording = open_bytes("test", bytes(format, &messages).into()).unwrap();
        let (found, issues) = read_all(&*recording);
        assert_same(&found, &messages);
        assert_eq!(issues, []);
        assert_eq!(
            recording.time_range(),
            Some((messages[0].log_time, messages[messages.len() - 1].log_time)),
            "{format:?}"
        );
        let topics = recording.topics();
        assert_eq!(topics.len(), 10);
        assert!(topics.is_sorted_by_key(|topic| topic.topic.clone()));
        assert!(topics.iter().all(|topic| topic.count == Some(60)), "{topics:?}");
    }
}

#[test]
fn unwanted_topics_are_left_out() {
    let messages = recorded(30);
    for format in FORMATS {
        let recording = open_bytes("test", bytes(format, &messages).into()).unwrap();
        let mut reader = recording.read(&|info| &*info.type_name == "sensor_msgs/Imu").unwrap();
        let mut count = 0;
        while let Some(message) = reader.next_message().unwrap() {
            assert!(matches!(message.message, Message::Imu(_)));
            count += 1;
        }
        assert_eq!(count, 30);
        assert_eq!(reader.position_bytes(), recording.size_bytes());
    }
}

#[test]
fn the_same_messages_give_the_same_bytes() {
    let messages = recorded(20);
    for format in FORMATS {
        assert_eq!(bytes(format, &messages), bytes(format, &messages));
    }
}

/// Many chunks whose times overlap, as several writers or late messages make them.
#[test]
fn chunks_that_overlap_in_time_are_merged() {
    let mut messages = recorded(2000);
    let sorted = messages.clone();
    // Every stretch of 1500 messages is written backwards; several chunks lie in each.
    messages.chunks_mut(1500).for_each(<[_]>::reverse);
    for format in FORMATS {
        let data = bytes(format, &messages);
        let recording = open_bytes("test", data.into()).unwrap();
        let (found, issues) = read_all(&*recording);
        assert_same(&found, &sorted);
        assert_eq!(issues, [], "{format:?}");
    }
}

#[test]
fn messages_at_the_same_time_stay_in_file_order() {
    let mut messages = recorded(300);
    messages.iter_mut().for_each(|message| message.log_time = time(5));
    for format in FORMATS {
        let recording = open_bytes("test", bytes(format, &messages).into()).unwrap();
        assert_same(&read_all(&*recording).0, &messages);
    }
}

#[test]
fn messages_larger_than_a_chunk_are_kept_whole() {
    let mut messages = recorded(3);
    for message in &mut messages {
        if let Message::PointCloud2(cloud) = &mut message.message {
            cloud.data = (0..3_000_000u32).map(|i| (i >> 5) as u8).collect();
        }
    }
    for format in FORMATS {
        let recording = open_bytes("test", bytes(format, &messages).into()).unwrap();
        let (found, issues) = read_all(&*recording);
        assert_same(&found, &messages);
        assert_eq!(issues, []);
    }
}

#[test]
fn an_empty_recording_is_a_recording() {
    for format in FORMATS {
        let recording = open_bytes("test", bytes(format, &[]).into()).unwrap();
        assert_eq!(recording.time_range(), None);
        assert_eq!(recording.topics(), []);
        let (messages, issues) = read_all(&*recording);
        assert!(messages.is_empty());
        assert_eq!(issues, [], "{format:?}");
    }
}

#[test]
fn the_extension_chooses_the_format_and_content_recognises_it() {
    let folder = tempfile::tempdir().unwrap();
    let messages = recorded(3);
    for (name, expected) in [("a.bag", "ROS 1 bag 2.0 (lz4)"), ("b.mcap", "MCAP (ros2, zstd)")] {
        let path = folder.path().join(name);
        write(&path, None, &messages);
        let renamed = folder.path().join("renamed.dat");
        std::fs::rename(&path, &renamed).unwrap();
        let recording = open(&renamed).unwrap();
        assert_eq!(recording.format(), expected);
        assert_same(&read_all(&*recording).0, &messages);
    }
    assert!(matches!(create(folder.path().join("c.xyz"), None), Err(RecordingError::Unwritable { .. })));
}

#[test]
fn an_unfinished_recording_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.bag", "a.mcap"] {
        let mut writer = create(folder.path().join(name), None).unwrap();
        writer.write(&recorded(1)[0]).unwrap();
        drop(writer);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn messages_that_cannot_be_written_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.bag", "a.mcap"] {
        let path = folder.path().join(name);
        let mut writer = create(&path, None).unwrap();
        let good = recorded(1)[0].clone();
        let other = Message::Other { type_name: "a/B".into(), bytes: 3 };
        let early = RecordedMessage { log_time: portolan_geometry::Time::MIN, ..good.clone() };
        for bad in [RecordedMessage { message: other, ..good.clone() }, early] {
            assert!(matches!(writer.write(&bad), Err(RecordingError::Unwritable { .. })));
        }
        writer.write(&good).unwrap();
        writer.finish().unwrap();
        assert_same(&read_all(&*open(&path).unwrap()).0, &[good]);
    }
}

#[test]
fn leading_slashes_of_frames_are_removed() {
    let mut message = recorded(1).remove(0);
    let Message::LaserScan(scan) = &mut message.message else { panic!() };
    scan.header.frame_id = "/laser".into();
    for format in FORMATS {
        let recording = open_bytes("test", bytes(format, &[message.clone()]).into()).unwrap();
        let (found, _) = read_all(&*recording);
        assert_eq!(&*found[0].message.header().unwrap().frame_id, "laser");
    }
}

fn parts(folder: &Path, messages: &[RecordedMessage]) -> Vec<std::path::PathBuf> {
    // Overlapping ends, as in split bags: each part takes every other message of the seam.
    let (a, b): (Vec<_>, Vec<_>) = (0..messages.len()).partition(|i| *i < 100 || (*i < 160 && i % 2 == 0));
    let take = |numbers: &[usize]| numbers.iter().map(|i| messages[*i].clone()).collect::<Vec<_>>();
    let paths = vec![folder.join("part_9.bag"), folder.join("part_10.mcap")];
    write(&paths[0], None, &take(&a));
    write(&paths[1], None, &take(&b));
    paths
}

#[test]
fn several_files_are_read_as_one() {
    let folder = tempfile::tempdir().unwrap();
    let messages = recorded(30);
    let paths = parts(folder.path(), &messages);
    for recording in [open_all(&paths).unwrap(), open(folder.path()).unwrap()] {
        assert_eq!(recording.format(), "MCAP (ros2, zstd), ROS 1 bag 2.0 (lz4) in 2 files");
        let (found, issues) = read_all(&*recording);
        assert_same(&found, &messages);
        assert_eq!(issues, []);
        assert!(recording.topics().iter().all(|topic| topic.count == Some(30)));
    }
    assert!(open_all::<&Path>(&[]).is_err());
}

#[test]
fn a_file_without_messages_among_others_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut paths = parts(folder.path(), &recorded(30));
    paths.push(folder.path().join("part_11.bag"));
    write(&paths[2], None, &[]);
    let (found, issues) = read_all(&*open_all(&paths).unwrap());
    assert_eq!(found.len(), 30 * recorded(1).len());
    assert!(
        matches!(&issues[..], [issue] if issue.to_string().contains("part_11.bag has no messages")),
        "{issues:?}"
    );
}

#[test]
fn a_folder_with_metadata_names_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let messages = recorded(30);
    parts(folder.path(), &messages);
    let list =
        "info:\n  relative_file_paths:\n    - old_name/part_9.bag\n    - part_10.mcap\n    - lost.mcap\n";
    std::fs::write(folder.path().join("metadata.yaml"), list).unwrap();
    let (found, issues) = read_all(&*open(folder.path()).unwrap());
    assert_same(&found, &messages);
    assert_eq!(issues.len(), 1);
    assert!(issues[0].lost_data() && issues[0].text().contains("metadata.yaml"), "{issues:?}");
}

#[test]
fn a_file_compressed_as_a_whole_is_unpacked() {
    let folder = tempfile::tempdir().unwrap();
    let messages = recorded(10);
    for format in FORMATS {
        let plain = bytes(format, &messages);
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(&plain).unwrap();
        for packed in [zstd::bulk::compress(&plain, 1).unwrap(), gzip.finish().unwrap()] {
            let path = folder.path().join("recording.mcap.zstd");
            std::fs::write(&path, &packed).unwrap();
            let (found, issues) = read_all(&*open(&path).unwrap());
            assert_same(&found, &messages);
            assert_eq!(issues, []);
            std::fs::write(&path, &packed[..packed.len() - 20]).unwrap();
            if let Ok(recording) = open(&path) {
                assert!(!read_all(&*recording).1.is_empty());
            }
        }
    }
}

#[test]
fn files_that_are_no_recordings_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.bag");
    for (content, expected) in [
        (&b""[..], "empty"),
        (b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b", "map"),
        (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        (b"#ROSBAG V1.2\n", "rosbag migrate"),
        (b"hello", "supported are"),
    ] {
        std::fs::write(&path, content).unwrap();
        let error = open(&path).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    assert!(matches!(open(folder.path().join("none")), Err(RecordingError::Io { .. })));
    let empty = tempfile::tempdir().unwrap();
    assert!(matches!(open(empty.path()), Err(RecordingError::UnknownFormat { .. })));
}
