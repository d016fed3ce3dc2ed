//! Common parts of bags and MCAP files: files of records, most of them inside compressed chunks.
//!
//! Opening gives a [`ChunkIndex`] (from the file's own index or by scanning). Reading merges the messages of
//! its segments in order of log time ([`ChunkedRecording`]).

mod bytes;
mod compression;
mod connection;
mod index;
mod inspection;
mod loader;
mod reader;
mod unpacked;
mod walk;

pub(crate) use bytes::{FileBytes, Source};
pub(crate) use compression::{Compression, Decompressor, most_unpacked, usual_unpacked};
pub(crate) use connection::{Connection, MessageDecoder, topics};
pub(crate) use index::{ChunkIndex, LooseRun, MAX_SEGMENT_BYTES, Segment, SegmentLoader};
pub(crate) use inspection::ChunkInspector;
pub(crate) use reader::ChunkedRecording;
pub(crate) use unpacked::UnpackedFile;
pub(crate) use walk::{Content, Record, RecordFormat, walk};
