//! Checks a map that was just written. Maps are copied message by message, with any damage of their source
//! files.

use std::path::Path;

use portolan_pbstream::{Finding, PbstreamReader, ReadLimits, Severity, validate};

/// Errors of the map found by [`validate`]. None if it is not a regular file, because it cannot be read again.
pub(crate) fn damage_of(output: &Path, limits: ReadLimits) -> Vec<Finding> {
    if !output.is_file() {
        return Vec::new();
    }
    match PbstreamReader::open_with(output, limits) {
        Ok(mut reader) => {
            validate(&mut reader).into_iter().filter(|finding| finding.severity == Severity::Error).collect()
        }
        // It was written just now: another file has replaced it since.
        Err(_) => Vec::new(),
    }
}
