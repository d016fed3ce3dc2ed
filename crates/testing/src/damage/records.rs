//! Where the records of a file begin and end, and which of their bytes are lengths.

use std::ops::Range;

/// How records are distinguished.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Text, a record a line.
    Lines,
    /// Text without lines that matter.
    Tokens,
    /// ROS 1: length and header, length and data.
    Bag,
    /// Opcode, length, content.
    Mcap,
    /// Length and gzip, with protobuf in it.
    Pbstream,
    /// Pages of so many bytes.
    Pages(usize),
    /// Pages with checksums, which are put right.
    E57,
    /// A header in the first hundreds of bytes; then anything.
    HeaderThenRows,
}

/// The records of a file, and the fields in it that are lengths or counts.
#[derive(Default)]
pub(super) struct Records {
    pub records: Vec<Range<usize>>,
    pub lengths: Vec<Range<usize>>,
}

impl Records {
    /// Looks through a sound file.
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
            // Fields of the header: each has a length, too.
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

/// A little-endian number of so many bytes.
pub(super) fn number(bytes: &[u8], at: usize, size: usize) -> Option<usize> {
    let mut value = [0; 8];
    value[..size].copy_from_slice(bytes.get(at..at.checked_add(size)?)?);
    usize::try_from(u64::from_le_bytes(value)).ok()
}
