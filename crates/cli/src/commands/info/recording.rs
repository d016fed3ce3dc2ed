//! Summarises recordings.

use std::path::Path;

use portolan_diagnose::{RecordingInfo, info};
use portolan_ingest::IngestOptions;
use portolan_issue::Issue;
use portolan_recording::open;
use serde::Serialize;

use crate::error::CliError;
use crate::progress::Progress;

/// Summary of a recording.
#[derive(Serialize)]
pub struct RecordingReport {
    path: String,
    #[serde(flatten)]
    info: RecordingInfo,
}

/// Summarises a recording; the whole recording is read if its index does not contain the data.
pub fn read(path: &Path, quiet: bool) -> Result<RecordingReport, CliError> {
    let recording = open(path)?;
    let size = recording.size_bytes();
    let mut progress = Progress::start("read", size, quiet);
    let info = info(recording.as_ref(), &IngestOptions::default(), &mut |position| {
        if progress.is_due() {
            progress.update(position, size, String::new());
        }
    })?;
    progress.finish();
    Ok(RecordingReport { path: path.display().to_string(), info })
}

impl RecordingReport {
    /// Whether parts of the recording could not be read.
    pub fn lost_data(&self) -> bool {
        self.info.issues.iter().any(Issue::lost_data)
    }

    /// Summary as text.
    pub fn text(&self) -> String {
        format!("{}\n{}", self.path, self.info.to_text())
    }
}
