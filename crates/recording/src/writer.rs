//! Writes recordings that other tools can open.

use std::path::Path;

use crate::ros1::BagWriter;
use crate::ros2::mcap::McapWriter;
use crate::{RecordedMessage, RecordingError};

/// Compression of a ROS 1 bag's chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BagCompression {
    /// None: fastest to write.
    None,
    /// LZ4: half the size, little time.
    #[default]
    Lz4,
    /// Bzip2: smallest and slow.
    Bz2,
}

/// Compression of an MCAP file's chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum McapCompression {
    /// None: fastest to write.
    None,
    /// LZ4.
    Lz4,
    /// Zstandard: small and fast to read.
    #[default]
    Zstd,
}

/// Format of the recording to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingFormat {
    /// ROS 1 bag 2.0.
    Ros1Bag(BagCompression),
    /// MCAP with the profile `ros2`: messages in CDR, with their definitions.
    Mcap(McapCompression),
}

impl RecordingFormat {
    /// From a file's extension: `.bag` or `.mcap`, with the default compression.
    pub fn from_path(path: &Path) -> Result<Self, RecordingError> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        match extension.as_str() {
            "bag" => Ok(Self::Ros1Bag(BagCompression::default())),
            "mcap" => Ok(Self::Mcap(McapCompression::default())),
            _ => Err(RecordingError::Unwritable {
                detail: format!(
                    "{} has to end in .bag (ROS 1) or .mcap (ROS 2) so that its format is known",
                    path.display()
                ),
            }),
        }
    }
}

/// A recording being written. The file appears under its name when it is finished; if the writer is dropped
/// before, no file remains. The same messages give the same bytes.
pub trait RecordingWriter: Send {
    /// Appends a message. Log times may come in any order; readers sort. A message that cannot be written
    /// ([`RecordingError::Unwritable`]: [`Message::Other`](crate::Message::Other), a stamp that the format
    /// cannot represent) does not change the recording.
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError>;

    /// Writes the index and gives the file its name.
    fn finish(self: Box<Self>) -> Result<(), RecordingError>;
}

/// Starts a recording; without a format, the extension of the path decides.
pub fn create(
    path: impl AsRef<Path>,
    format: Option<RecordingFormat>,
) -> Result<Box<dyn RecordingWriter>, RecordingError> {
    let path = path.as_ref();
    let format = match format {
        Some(format) => format,
        None => RecordingFormat::from_path(path)?,
    };
    Ok(match format {
        RecordingFormat::Ros1Bag(compression) => Box::new(BagWriter::create(path, compression)?),
        RecordingFormat::Mcap(compression) => Box::new(McapWriter::create(path, compression)?),
    })
}
