//! Reads and writes Point Cloud Data of PCL: ascii, binary, and binary_compressed.

mod header;
mod lzf;
mod reader;
mod writer;

pub(crate) use header::sniff;
pub(crate) use reader::PcdReader;
pub(crate) use writer::PcdWriter;
