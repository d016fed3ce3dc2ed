//! Reads and writes ROS 1 bags, format 2.0.
//!
//! A bag is a sequence of records, each with a header of named fields and data. Messages and the descriptions
//! of their connections are in chunks, each followed by an index of its messages. An index of the chunks ends
//! the file.

pub(crate) mod record;
mod scan;
mod tail;
mod writer;

use std::path::Path;
use std::sync::Arc;

use crate::container::{ChunkedRecording, FileBytes, Source};
use crate::{Recording, RecordingError};
pub(crate) use record::MAGIC;
use record::{BagFormat, Op};
pub(crate) use writer::BagWriter;

/// Whether a file with these first bytes is a ROS 1 bag of any version.
pub(crate) fn sniff(first_bytes: &[u8]) -> bool {
    first_bytes.starts_with(b"#ROSBAG V") || first_bytes.starts_with(b"#ROSRECORD V")
}

/// Opens a bag. A missing or damaged index is rebuilt by scanning the file.
pub(crate) fn open(source: Source) -> Result<Box<dyn Recording>, RecordingError> {
    let mut file = source.open()?;
    let name = source.name();
    let magic = file.peek(0, MAGIC.len())?;
    if magic != MAGIC {
        let version =
            String::from_utf8_lossy(magic.split(|b| *b == b'\n').next().unwrap_or_default()).into_owned();
        return Err(unsupported(
            name,
            format!("it is a bag of the old format \"{version}\"; convert it with `rosbag migrate`"),
        ));
    }
    let start = MAGIC.len() as u64;
    let index_offset = bag_header(&mut file, name, start)?;
    let tail = tail::read(&mut file, index_offset)?;
    let index = scan::scan(&mut file, start, tail)?;
    let description = match index.compressions() {
        compressions if compressions.is_empty() => "ROS 1 bag 2.0".to_owned(),
        compressions => format!("ROS 1 bag 2.0 ({compressions})"),
    };
    Ok(Box::new(ChunkedRecording {
        size_bytes: file.length(),
        description,
        format: Arc::new(BagFormat),
        index: Arc::new(index),
        source,
    }))
}

/// The offset of the index from the bag header; zero if there is none.
fn bag_header(file: &mut FileBytes, name: &Path, start: u64) -> Result<u64, RecordingError> {
    let Some(head) = record::peek_head(file, start)? else { return Ok(0) };
    if head.op != Op::BagHeader {
        return Ok(0);
    }
    if !head.encryptor.is_empty() {
        let plugin = String::from_utf8_lossy(&head.encryptor).into_owned();
        return Err(unsupported(
            name,
            format!("the bag is encrypted with {plugin}; decrypt it first with `rosbag decrypt`"),
        ));
    }
    Ok(head.index_offset)
}

fn unsupported(path: &Path, detail: String) -> RecordingError {
    RecordingError::Unsupported { path: path.to_owned(), detail }
}
