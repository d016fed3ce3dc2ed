//! Damaged files: never a panic, never a silent loss, never memory by lying sizes.

use std::sync::LazyLock;

use portolan_issue::Issue;
use portolan_recording::*;
use proptest::prelude::*;

use crate::sample::{FORMATS, assert_same, bytes, recorded};

/// A recording of every format with several chunks, and its messages.
static RECORDINGS: LazyLock<(Vec<RecordedMessage>, Vec<Vec<u8>>)> = LazyLock::new(|| {
    let mut messages = recorded(60);
    // Large enough for several chunks.
    for message in &mut messages {
        if let Message::PointCloud2(cloud) = &mut message.message {
            cloud.data = (0..30_000u32).map(|i| ((i * i) >> 7) as u8).collect();
        }
    }
    let data = FORMATS.iter().map(|format| bytes(*format, &messages)).collect();
    (messages, data)
});

/// Reads what can be read; `None` if the file is refused with an error.
fn survive(data: Vec<u8>) -> Option<(Vec<RecordedMessage>, Vec<Issue>)> {
    let recording = open_bytes("damaged", data.into()).ok()?;
    let mut reader = recording.read(&|_| true).ok()?;
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message().ok()? {
        messages.push(message);
        assert!(messages.len() < 100_000, "more messages than were ever written");
    }
    Some((messages, reader.issues()))
}

fn assert_not_silent(messages: &[RecordedMessage], issues: &[Issue]) {
    let all = RECORDINGS.0.len();
    assert!(
        messages.len() >= all
            || issues.iter().any(|issue| issue.lost_data() || issue.text().contains("ended")),
        "{} of {all} messages, {issues:?}",
        messages.len()
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn truncated_recordings_give_their_complete_messages(which in 0..FORMATS.len(), share in 0.0..1.0f64) {
        let data = &RECORDINGS.1[which];
        let length = (data.len() as f64 * share) as usize;
        if let Some((messages, issues)) = survive(data[..length].to_vec()) {
            assert!(messages.len() <= RECORDINGS.0.len());
            assert_same(&messages, &RECORDINGS.0[..messages.len()]);
            assert_not_silent(&messages, &issues);
        }
    }

    #[test]
    fn flipped_bytes_lose_little_and_never_silently(
        which in 0..FORMATS.len(),
        flips in prop::collection::vec((0.0..1.0f64, 1u8..), 1..4),
    ) {
        let mut data = RECORDINGS.1[which].clone();
        for (share, flip) in flips {
            let at = (data.len() as f64 * share) as usize;
            data[at] ^= flip;
        }
        if let Some((messages, issues)) = survive(data) {
            assert_not_silent(&messages, &issues);
        }
    }

    /// Headers and index are a small part of a file; they get flips of their own.
    #[test]
    fn flipped_bytes_in_the_structure_never_lose_silently(
        which in 0..FORMATS.len(),
        at in 0..6000usize,
        from_the_end in any::<bool>(),
        flip in 1u8..,
    ) {
        let mut data = RECORDINGS.1[which].clone();
        let at = if from_the_end { data.len() - 1 - at } else { at };
        data[at] ^= flip;
        if let Some((messages, issues)) = survive(data) {
            assert_not_silent(&messages, &issues);
        }
    }

    #[test]
    fn a_missing_block_is_survived(which in 0..FORMATS.len(), from in 0.0..1.0f64, bytes in 1..5000usize) {
        let mut data = RECORDINGS.1[which].clone();
        let from = (data.len() as f64 * from) as usize;
        data.drain(from..(from + bytes).min(data.len()));
        if let Some((messages, issues)) = survive(data) {
            assert_not_silent(&messages, &issues);
        }
    }

    #[test]
    fn arbitrary_bytes_are_survived(magic in 0..3usize, tail in prop::collection::vec(any::<u8>(), 0..2000)) {
        let magic: &[u8] = [&b"#ROSBAG V2.0\n"[..], b"\x89MCAP0\r\n", b"SQLite format 3\0"][magic];
        survive([magic, &tail].concat());
    }
}

#[test]
fn most_of_a_recording_survives_a_damaged_spot() {
    let (messages, recordings) = &*RECORDINGS;
    for (format, data) in FORMATS.iter().zip(recordings) {
        let mut data = data.clone();
        let middle = data.len() / 2;
        data[middle..middle + 8].fill(0xff);
        let (found, issues) = survive(data).unwrap();
        // At most the chunk that was hit is lost; here there are two or three.
        assert!(found.len() * 3 > messages.len(), "{format:?}: {} {issues:?}", found.len());
        assert!(issues.iter().any(|issue| issue.lost_data()) || found.len() == messages.len());
    }
}

#[test]
fn a_recording_without_its_index_is_whole() {
    let (messages, recordings) = &*RECORDINGS;
    for (format, data) in FORMATS.iter().zip(recordings) {
        let mut data = data.clone();
        match format {
            // As after a crash of `rosbag record`: no index, no place of it.
            RecordingFormat::Ros1Bag(_) => {
                let place = data.windows(10).position(|w| w == b"index_pos=").unwrap() + 10;
                let index = u64::from_le_bytes(data[place..place + 8].try_into().unwrap());
                data.truncate(index as usize);
                data[place..place + 8].fill(0);
            }
            RecordingFormat::Mcap(_) => {
                let footer = data.len() - 8 - 20;
                let summary = u64::from_le_bytes(data[footer..footer + 8].try_into().unwrap());
                data.truncate(summary as usize);
            }
        }
        let (found, issues) = survive(data).unwrap();
        assert_same(&found, messages);
        assert_eq!(issues.len(), 1, "{issues:?}");
        assert!(!issues[0].lost_data() && issues[0].text().contains("ended properly"));
    }
}

#[test]
fn an_encrypted_bag_is_refused_by_name() {
    let mut data = bytes(FORMATS[0], &recorded(1));
    // The field `chunk_count=xxxx` has as many bytes as this one.
    let field = data.windows(12).position(|w| w == b"chunk_count=").unwrap();
    data[field..field + 16].copy_from_slice(b"encryptor=aes-gc");
    let error = open_bytes("test.bag", data.into()).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("encrypted") && error.contains("aes-gc"), "{error}");
}

/// A message whose array claims more elements than there are is dropped, named and counted.
#[test]
fn a_wrong_array_length_costs_one_message() {
    let messages = recorded(40);
    for format in [FORMATS[0], FORMATS[3]] {
        let mut data = bytes(format, &messages);
        // The length 39 in front of the ranges 0, 0.1, 0.2.
        let pattern = [39u32.to_le_bytes(), 0f32.to_le_bytes(), 0.1f32.to_le_bytes()].concat();
        let at = data.windows(12).position(|window| window == pattern).unwrap();
        data[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        let (found, issues) = survive(data).unwrap();
        assert_eq!(found.len(), messages.len() - 1);
        let dropped = issues.iter().find(|issue| issue.text().contains("/scan")).unwrap();
        assert_eq!((dropped.count, dropped.lost_data()), (1, true));
        assert!(dropped.text().contains("length of an array"), "{dropped:?}");
    }
}

/// Small compressed data that claim to unpack to gigabytes, or do.
#[test]
fn wrong_sizes_do_not_take_memory() {
    let bomb = zstd::bulk::compress(&vec![0u8; 64 << 20], 1).unwrap();
    for (claimed, packed) in [(u64::MAX, b"abcd".to_vec()), (1 << 29, b"abcd".to_vec()), (1000, bomb)] {
        let mut data = b"\x89MCAP0\r\n".to_vec();
        let mut chunk = Vec::new();
        chunk.extend([1u64, 2, claimed].iter().flat_map(|v| v.to_le_bytes()));
        chunk.extend(0u32.to_le_bytes());
        chunk.extend(4u32.to_le_bytes());
        chunk.extend(b"zstd");
        chunk.extend((packed.len() as u64).to_le_bytes());
        chunk.extend(&packed);
        data.push(6);
        data.extend((chunk.len() as u64).to_le_bytes());
        data.extend(chunk);
        let before = peak_kib();
        let (messages, issues) = survive(data).unwrap();
        assert!(messages.is_empty());
        assert!(issues.iter().any(|issue| issue.lost_data()), "{issues:?}");
        if let (Some(before), Some(after)) = (before, peak_kib()) {
            // Other tests run at the same time; a trusted size would show as hundreds of megabytes.
            assert!(after < before + (256 << 10), "{before} KiB became {after} KiB");
        }
    }
}

/// Peak memory of this process, where the system reports it.
fn peak_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse().ok()
}
