//! The common interface of all recording formats.

use std::path::PathBuf;
use std::sync::Arc;

use portolan_geometry::Time;

use crate::RecordedMessage;
use portolan_issue::Issue;

/// Properties of one topic of a recording, from the container's index, without reading every message.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicInfo {
    /// Name.
    pub topic: Arc<str>,
    /// ROS type as `package/Type`.
    pub type_name: Arc<str>,
    /// Number of messages, if the index has it.
    pub count: Option<u64>,
}

/// Why a recording could not be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is of no known format.
    #[error("{} is not a recording that Portolan knows: {detail}", path.display())]
    UnknownFormat {
        /// Which file.
        path: PathBuf,
        /// What was found, and what the user can do.
        detail: String,
    },
    /// The file is damaged beyond what could be repaired.
    #[error("{} is damaged at byte {offset}: {detail}", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// Where.
        offset: u64,
        /// What is wrong.
        detail: String,
    },
    /// The file is of a known format but in a form that cannot be read.
    #[error("cannot read {}: {detail}", path.display())]
    Unsupported {
        /// Which file.
        path: PathBuf,
        /// Why, and what the user can do.
        detail: String,
    },
    /// A recording could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A message or a format cannot be written.
    #[error("{detail}")]
    Unwritable {
        /// Which one, and why.
        detail: String,
    },
    /// Something else that the user requested or supplied with a recording, such as a robot description,
    /// could not be used.
    #[error("{detail}")]
    Description {
        /// What is wrong, and what the user can do.
        detail: String,
    },
}

/// A recording that can be read from start to end, any number of times. The memory use does not depend on its
/// length.
pub trait Recording: Send {
    /// For example "ROS 1 bag 2.0 (lz4)".
    fn format(&self) -> String;

    /// Topics in ascending order.
    fn topics(&self) -> Vec<TopicInfo>;

    /// First and last log time, if known without reading everything.
    fn time_range(&self) -> Option<(Time, Time)>;

    /// Size in bytes on disk, for progress.
    fn size_bytes(&self) -> u64;

    /// Starts reading from the beginning, messages in order of log time (ties in file order). Only topics for
    /// which `wanted` returns true are decoded.
    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError>;
}

/// One pass over a recording.
pub trait MessageReader: Send {
    /// The next message, or `None` at the end. Recoverable damage is repaired and counted; an error ends the
    /// pass.
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError>;

    /// Bytes of the file consumed so far, for progress.
    fn position_bytes(&self) -> u64;

    /// Repairs and losses so far, by kind.
    fn issues(&self) -> Vec<Issue>;
}
