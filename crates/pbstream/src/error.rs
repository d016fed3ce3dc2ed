//! Errors of map files.

use std::io;
use std::path::PathBuf;

use crate::gzip::GzipError;

/// Why a map file could not be read or written. The texts say what the user can do, where something can be
/// done.
#[derive(Debug, thiserror::Error)]
pub enum PbstreamError {
    /// The file could not be opened.
    #[error("cannot open the map: {source}")]
    Open {
        /// The file, for the caller's error message.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The file does not start with the magic number of pbstream files.
    #[error("this is no map (pbstream): it begins with {found}")]
    Magic {
        /// The first bytes, as text or in hexadecimal.
        found: String,
    },
    /// The file is of another kind.
    #[error("this is no map (pbstream) but {kind}")]
    OtherKind {
        /// The kind, and what can be done with the file.
        kind: &'static str,
    },
    /// A record could not be read.
    #[error("message {index} at byte {offset}: {problem}")]
    Record {
        /// Number of the record; the header is 0.
        index: u64,
        /// Position of the record's size field in the file.
        offset: u64,
        /// What is wrong with it.
        problem: RecordError,
    },
    /// The first record is not a header, or has an unknown format version.
    #[error("Unsupported serialization format \"{version}\" (1 and 2 are known)")]
    Version {
        /// The version in the header.
        version: u32,
    },
    /// The file ends before the header.
    #[error("the map is empty: there is no header; the file was probably never written completely")]
    MissingHeader,
    /// The second message is missing.
    #[error("Serialized stream misses PoseGraph.")]
    MissingPoseGraph,
    /// The second message is of another kind.
    #[error(
        "Serialized stream order corrupt. Expecting `PoseGraph` after `SerializationHeader`, but got \
         field tag {tag}"
    )]
    PoseGraphOrder {
        /// The field number found.
        tag: u32,
    },
    /// The third message is missing.
    #[error("Serialized stream misses `AllTrajectoryBuilderOptions`.")]
    MissingOptions,
    /// The third message is of another kind.
    #[error(
        "Serialized stream order corrupt. Expecting `AllTrajectoryBuilderOptions` after `PoseGraph`, but \
         got field tag {tag}"
    )]
    OptionsOrder {
        /// The field number found.
        tag: u32,
    },
    /// Options and trajectories do not match.
    #[error(
        "the map has options for {options} trajectories but poses of {trajectories}; `repair` makes them \
         agree"
    )]
    OptionsCount {
        /// Number of options.
        options: usize,
        /// Number of trajectories.
        trajectories: usize,
    },
    /// The map could not be written.
    #[error("cannot write the map \"{}\": {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
}

/// Why one record could not be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// Reading failed.
    #[error("reading failed: {0}")]
    Io(#[from] io::Error),
    /// The file ends within the eight bytes of a record's size.
    #[error("the file ends within a record's size: it was cut off; `repair` keeps what is whole")]
    TruncatedSize,
    /// The stated size does not fit into what is left of the file.
    #[error(
        "the record says it has {stated} bytes but only {available} are left: the file was cut off or is \
         damaged; `repair` keeps what is whole"
    )]
    Size {
        /// Bytes according to the size field.
        stated: u64,
        /// Bytes that are left in the file.
        available: u64,
    },
    /// The record is larger than the limit.
    #[error(
        "the record has {stated} compressed bytes, more than the limit of {limit}; `repair` keeps what is whole"
    )]
    CompressedTooLarge {
        /// Bytes according to the size field.
        stated: u64,
        /// The limit.
        limit: u64,
    },
    /// The record cannot be decompressed.
    #[error("{0}; `repair` keeps what is whole")]
    Gzip(#[from] GzipError),
    /// The message is short but expands to very many parts.
    #[error(
        "the message would need {needed} bytes of memory, more than the limit of {limit}: it is damaged; `repair` keeps what is \
         whole"
    )]
    DecodedTooLarge {
        /// Upper bound of the bytes that the decoded message needs.
        needed: u64,
        /// The limit.
        limit: u64,
    },
    /// The record is not the message it should be.
    #[error("not a valid message: {0}; `repair` keeps what is whole")]
    Decode(#[from] prost::DecodeError),
}

impl RecordError {
    /// Whether the records after this one can still be found.
    pub fn is_local(&self) -> bool {
        matches!(self, Self::Gzip(_) | Self::Decode(_) | Self::DecodedTooLarge { .. })
    }
}
