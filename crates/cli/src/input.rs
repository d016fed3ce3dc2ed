//! Inputs of verbs: files or pipes, whose format is recognised by their first bytes.

use std::io::ErrorKind;
use std::path::Path;

use portolan_input::{Forward, named, read_all, regular_file, unwanted_kind_of};
use portolan_pbstream::MAGIC;

use crate::error::CliError;

/// Maximum size of files that are read whole, bytes.
const WHOLE_FILE: u64 = 1 << 30;

/// Opens an input that is read once from start to end: a file, a pipe, or `-` for the standard input.
pub fn open_forward(path: &Path) -> Result<Forward, CliError> {
    Forward::open(path).map_err(|source| CliError::File { path: path.to_owned(), source })
}

/// The next bytes, which are read again afterwards.
pub fn peek<'a>(input: &'a mut Forward, path: &Path, count: usize) -> Result<&'a [u8], CliError> {
    input.peek(count).map_err(|source| CliError::File { path: path.to_owned(), source })
}

/// Whether an input is a map, by its content.
pub fn is_map(input: &mut Forward, path: &Path) -> Result<bool, CliError> {
    Ok(peek(input, path, MAGIC.len())? == MAGIC)
}

/// Opens the input if it is a map; none for a recording, which is a file or folder.
pub fn open_map(path: &Path) -> Result<Option<Forward>, CliError> {
    if named(path).is_dir() {
        return Ok(None);
    }
    let mut input = open_forward(path)?;
    let is_map = is_map(&mut input, path)?;
    if !is_map {
        // A recording is opened again by its path, but the peeked bytes of a pipe are consumed: refuse pipes here.
        must_be_a_file(path)?;
    }
    Ok(is_map.then_some(input))
}

/// Beginnings of the lines of pose graphs (g2o).
pub const GRAPH_TAGS: [&str; 3] = ["VERTEX", "EDGE", "FIX"];

/// Refuses an input of a known format other than a pose graph; the error names the format.
pub fn may_be_graph(input: &mut Forward, path: &Path) -> Result<(), CliError> {
    let start = peek(input, path, 16)?;
    let is_graph = GRAPH_TAGS.iter().any(|tag| start.starts_with(tag.as_bytes()));
    match unwanted_kind_of(start).filter(|_| !is_graph) {
        Some(kind) => Err(CliError::in_file(path, format!("this is {kind}"))),
        None => Ok(()),
    }
}

/// Refuses pipes and devices, for inputs that are read more than once.
pub fn must_be_a_file(path: &Path) -> Result<(), CliError> {
    match regular_file(path) {
        Err(source) if source.kind() == ErrorKind::Unsupported => {
            Err(CliError::File { path: path.to_owned(), source })
        }
        // Other errors are reported by the function that reads the file, with more context.
        _ => Ok(()),
    }
}

/// Reads a whole file of at most 1 GiB.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, CliError> {
    read_all(path, WHOLE_FILE).map_err(|source| CliError::File { path: path.to_owned(), source })
}
