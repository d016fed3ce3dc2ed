//! Finds the records of a file and their length fields.

use std::ops::Range;

/// Layout of the records of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Text with one record per line.
    Lines,
    /// Text in which lines have no meaning.
    Tokens,
    /// ROS 1 bag: length and header, length and data.
    Bag,
    /// MCAP: opcode, length, content.
    Mcap,
    /// Length and gzip-compressed protobuf message.
    Pbstream,
    /// Pages of this size, bytes.
    Pages(usize),
    /// E57: pages of 1024 bytes with checksums, which are usually recomputed after the damage.
    E57,
    /// A header in the first few hundred bytes, then rows.
    HeaderThenRows,
}

/// Byte ranges of the records of a file, and of its fields that are lengths or counts.
#[derive(Default)]
pub(super) struct Records {
    pub records: Vec<Range<usize>>,
    pub lengths: Vec<Range<usize>>,
}

impl Records {
    /// Finds the records of a file.
    pub fn of(bytes: &[u8], layout: Layout) -> Self {
        match layout {
            Layout::Lines => Self::lines(bytes),
            Layout::Tokens => Self::pieces(bytes, 64),
            Layout::Pages(size) => Self::pieces(bytes, size),
            Layout::E57 => Self::pieces(bytes, 1024),
            Layout::HeaderThenRows => {
                let mut found = Self::pieces(bytes, 40);
                found.lengths = (0..bytes.len().min(380) / 4).map(|i| 4 * i..4 * i + 4).collect();
                found
            }
            Layout::Bag => Self::bag(bytes),
            Layout::Mcap => Self::mcap(bytes),
            Layout::Pbstream => Self::pbstream(bytes),
        }
    }

    fn lines(bytes: &[u8]) -> Self {
        let mut found = Self::default();
        let mut start = 0;
        for (i, _) in bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n') {
            found.records.push(start..i + 1);
            start = i + 1;
        }
        found
    }

    fn pieces(bytes: &[u8], size: usize) -> Self {
        let records = (0..bytes.len() / size).map(|i| i * size..(i + 1) * size).collect();
        Self { records, lengths: Vec::new() }
    }

    fn bag(bytes: &[u8]) -> Self {
        let (mut found, mut at) = (Self::default(), 13);
        while let Some(header) = number(bytes, at, 4) {
            let Some(data) = number(bytes, at + 4 + header, 4) else { break };
            let end = at + 8 + header + data;
            found.lengths.extend([at..at + 4, at + 4 + header..at + 8 + header]);
            found.records.push(at..end.min(bytes.len()));
            // Each field of the header has a length, too.
            let mut field = at + 4;
            while let Some(length) = number(bytes, field, 4).filter(|l| field + 4 + l <= at + 4 + header) {
                found.lengths.push(field..field + 4);
                field += 4 + length;
            }
            at = end;
        }
        found
    }

    fn mcap(bytes: &[u8]) -> Self {
        let (mut found, mut at) = (Self::default(), 8);
        while let Some(length) = number(bytes, at + 1, 8).filter(|length| *length < bytes.len()) {
            found.lengths.push(at + 1..at + 9);
            found.records.push(at..(at + 9 + length).min(bytes.len()));
            at += 9 + length;
        }
        found
    }

    fn pbstream(bytes: &[u8]) -> Self {
        let (mut found, mut at) = (Self::default(), 8);
        while let Some(length) = number(bytes, at, 8).filter(|length| *length < bytes.len()) {
            found.lengths.push(at..at + 8);
            found.records.push(at..(at + 8 + length).min(bytes.len()));
            at += 8 + length;
        }
        found
    }
}

/// Little-endian number of `size` bytes at offset `at`.
pub(super) fn number(bytes: &[u8], at: usize, size: usize) -> Option<usize> {
    let mut value = [0; 8];
    value[..size].copy_from_slice(bytes.get(at..at.checked_add(size)?)?);
    usize::try_from(u64::from_le_bytes(value)).ok()
}
