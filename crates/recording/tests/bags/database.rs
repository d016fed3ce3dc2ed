//! ROS 2 bags in SQLite.

use std::path::Path;

use portolan_issue::Issue;
use portolan_recording::*;
use proptest::prelude::*;
use rusqlite::{Connection, params};

use crate::sample::{assert_same, bytes, read_all, recorded};

/// CDR payloads of messages, from an MCAP file.
fn payloads(messages: &[RecordedMessage]) -> Vec<Vec<u8>> {
    let data = bytes(RecordingFormat::Mcap(McapCompression::None), messages);
    let stream = mcap::MessageStream::new(&data).unwrap();
    stream.map(|message| message.unwrap().data.into_owned()).collect()
}

/// Writes a database as ROS 2 does; rows in reverse order of time if `reversed`.
fn write_db3(path: &Path, messages: &[RecordedMessage], with_index: bool, reversed: bool, packed: bool) {
    let database = Connection::open(path).unwrap();
    database
        .execute_batch(
            "PRAGMA journal_mode = MEMORY; PRAGMA synchronous = OFF;
             CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
             CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                 serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                 timestamp INTEGER NOT NULL, data BLOB NOT NULL);",
        )
        .unwrap();
    if with_index {
        database.execute_batch("CREATE INDEX timestamp_idx ON messages (timestamp ASC);").unwrap();
    }
    let mut topics: Vec<&str> = Vec::new();
    let mut rows: Vec<_> = messages.iter().zip(payloads(messages)).collect();
    if reversed {
        rows.reverse();
    }
    database.execute_batch("BEGIN").unwrap();
    for (message, payload) in rows {
        let topic = topics.iter().position(|topic| **topic == *message.topic).unwrap_or_else(|| {
            topics.push(&message.topic);
            let type_name = message.message.type_name().replacen('/', "/msg/", 1);
            let row = params![topics.len() as i64, &*message.topic, type_name, "cdr", ""];
            database.execute("INSERT INTO topics VALUES (?1, ?2, ?3, ?4, ?5)", row).unwrap();
            topics.len() - 1
        });
        let payload = if packed { zstd::bulk::compress(&payload, 1).unwrap() } else { payload };
        let row = params![topic as i64 + 1, message.log_time.unix_nanoseconds(), payload];
        database
            .execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)", row)
            .unwrap();
    }
    database.execute_batch("COMMIT").unwrap();
}

#[test]
fn databases_are_read_in_order_of_time() {
    let folder = tempfile::tempdir().unwrap();
    let messages = recorded(120);
    for (with_index, reversed, packed) in
        [(true, false, false), (true, true, false), (false, true, false), (true, false, true)]
    {
        let path = folder.path().join(format!("{with_index}{reversed}{packed}.db3"));
        write_db3(&path, &messages, with_index, reversed, packed);
        let recording = open(&path).unwrap();
        assert_eq!(recording.format(), "ROS 2 bag (SQLite)");
        let ends = (messages[0].log_time, messages[messages.len() - 1].log_time);
        assert_eq!(recording.time_range(), Some(ends));
        assert!(recording.topics().iter().all(|topic| topic.count == Some(120)));
        let (found, issues) = read_all(&*recording);
        assert_same(&found, &messages);
        assert_eq!(issues, []);
        let mut reader = recording.read(&|info| &*info.topic == "/imu").unwrap();
        let mut count = 0;
        while let Some(message) = reader.next_message().unwrap() {
            assert_eq!(&*message.topic, "/imu");
            count += 1;
        }
        assert_eq!(count, 120);
        assert_eq!(reader.position_bytes(), recording.size_bytes());
    }
}

#[test]
fn a_bag_of_compressed_files_is_read_from_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let messages = recorded(40);
    let mut list = "rosbag2_bagfile_information:\n  compression_format: zstd\n  compression_mode: FILE\n  \
                    relative_file_paths:\n"
        .to_owned();
    for (number, part) in messages.chunks(150).enumerate() {
        let path = folder.path().join("part.db3");
        write_db3(&path, part, true, false, false);
        let packed = zstd::bulk::compress(&std::fs::read(&path).unwrap(), 1).unwrap();
        std::fs::remove_file(&path).unwrap();
        std::fs::write(folder.path().join(format!("bag_{number}.db3.zstd")), packed).unwrap();
        list += &format!("    - bag_{number}.db3.zstd\n");
    }
    std::fs::write(folder.path().join("metadata.yaml"), list).unwrap();
    let recording = open(folder.path()).unwrap();
    assert_eq!(recording.format(), "ROS 2 bag (SQLite) in 3 files");
    let (found, issues) = read_all(&*recording);
    assert_same(&found, &messages);
    assert_eq!(issues, []);
}

#[test]
fn other_databases_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.db3");
    let database = Connection::open(&path).unwrap();
    // A view of the right name could run anything: it is not a table.
    database.execute_batch("CREATE TABLE topics(id); CREATE VIEW messages AS SELECT 1 AS id;").unwrap();
    drop(database);
    let error = open(&path).map(|_| ()).unwrap_err();
    assert!(matches!(error, RecordingError::UnknownFormat { .. }), "{error}");
}

/// Reads a damaged database, if it opens at all.
fn survive(path: &Path) -> Option<(usize, Vec<Issue>)> {
    let recording = open(path).ok()?;
    let mut reader = recording.read(&|_| true).ok()?;
    let mut count = 0;
    while reader.next_message().ok()?.is_some() {
        count += 1;
        assert!(count < 10_000);
    }
    Some((count, reader.issues()))
}

#[test]
fn a_truncated_database_gives_its_remaining_messages() {
    let folder = tempfile::tempdir().unwrap();
    let messages = recorded(60);
    let path = folder.path().join("whole.db3");
    write_db3(&path, &messages, false, false, false);
    let data = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.db3");
    std::fs::write(&cut, &data[..data.len() * 3 / 4]).unwrap();
    let (count, issues) = survive(&cut).unwrap();
    assert!(count > messages.len() / 2, "{count}");
    assert!(issues.iter().any(|issue| issue.lost_data()));
}

/// Puts the first page of messages in the place of the third and fourth: the rows behind those of the second are the
/// first ones again.
fn mix_up_pages(data: &mut [u8]) {
    const PAGE: usize = 4096;
    const INNER_PAGE_OF_TABLE: u8 = 5;
    let number = |data: &[u8], at: usize, bytes: usize| {
        data[at..at + bytes].iter().fold(0, |value, byte| value << 8 | usize::from(*byte))
    };
    let inner = (PAGE..data.len()).step_by(PAGE).find(|at| data[*at] == INNER_PAGE_OF_TABLE).unwrap();
    assert!(number(data, inner + 3, 2) > 4);
    let child = |cell: usize| {
        let cell = inner + number(data, inner + 12 + 2 * cell, 2);
        (number(data, cell, 4) - 1) * PAGE
    };
    let (first, others) = (child(0), [child(2), child(3)]);
    others.into_iter().for_each(|other| data.copy_within(first..first + PAGE, other));
}

#[test]
fn pages_that_lead_back_to_earlier_rows_are_stepped_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.db3");
    for with_index in [true, false] {
        let messages = recorded(120);
        let _ = std::fs::remove_file(&path);
        write_db3(&path, &messages, with_index, false, false);
        let mut data = std::fs::read(&path).unwrap();
        mix_up_pages(&mut data);
        std::fs::write(&path, data).unwrap();
        let (count, issues) = survive(&path).unwrap();
        assert!(count > messages.len() / 2, "{count} of {}", messages.len());
        assert!(issues.iter().any(|issue| issue.lost_data()), "{with_index}: {issues:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn damaged_databases_are_survived(
        cut in prop::option::of(0.0..1.0f64),
        flips in prop::collection::vec((0.0..1.0f64, any::<u8>()), 0..6),
        with_index in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.db3");
        write_db3(&path, &recorded(8), with_index, false, false);
        let mut data = std::fs::read(&path).unwrap();
        for (share, flip) in flips {
            let at = (data.len() as f64 * share) as usize;
            data[at] ^= flip;
        }
        if let Some(share) = cut {
            data.truncate((data.len() as f64 * share) as usize);
        }
        std::fs::write(&path, data).unwrap();
        survive(&path);
    }
}
