//! Whether a map that was just written is sound. Maps are copied message by message, and so is damage of their sources.

use std::path::Path;

use portolan_pbstream::{Finding, PbstreamReader, ReadLimits, Severity, validate};

/// What is wrong with it: the errors of [`validate`]. None in what is no regular file, as it cannot be read again.
pub(crate) fn damage_of(output: &Path, limits: ReadLimits) -> Vec<Finding> {
    if !output.is_file() {
        return Vec::new();
    }
    match PbstreamReader::open_with(output, limits) {
        Ok(mut reader) => {
            validate(&mut reader).into_iter().filter(|finding| finding.severity == Severity::Error).collect()
        }
        // It was written a moment ago: something else is at its place now.
        Err(_) => Vec::new(),
    }
}
