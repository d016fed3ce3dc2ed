//! Results on stdout and in files; telling maps from recordings.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use serde::Serialize;

use portolan_atomic_file::AtomicFile;

use crate::error::CliError;

/// The first bytes of every map.
const MAP_MAGIC: [u8; 8] = [0xdb, 0x01, 0xf5, 0x5b, 0x7b, 0x1f, 0x1d, 0x7b];

/// Prints a result; a line feed follows unless it ends with one.
pub fn print(text: &str) -> Result<(), CliError> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())?;
    if !text.ends_with('\n') {
        out.write_all(b"\n")?;
    }
    Ok(out.flush()?)
}

/// Prints a result as indented JSON.
pub fn print_json(value: &impl Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value).map_err(|error| CliError::Failed(error.to_string()))?;
    print(&text)
}

/// Writes a file that appears under its name only when it is complete.
pub fn write_file(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), CliError> {
    let mut file = AtomicFile::create(path)?;
    match write(&mut file) {
        Ok(()) => Ok(file.commit()?),
        Err(source) => Err(file.error(source).into()),
    }
}

/// Whether a file is a map, by its content.
pub fn is_map(path: &Path) -> Result<bool, CliError> {
    let failed = |source| CliError::File { path: path.to_owned(), source };
    if path.is_dir() {
        return Ok(false);
    }
    let mut start = Vec::with_capacity(MAP_MAGIC.len());
    File::open(path)
        .and_then(|file| file.take(MAP_MAGIC.len() as u64).read_to_end(&mut start))
        .map_err(failed)?;
    Ok(start == MAP_MAGIC)
}

/// `1 pose`, `2 poses`.
pub fn counted(count: u64, one: &str, several: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {several}") }
}
