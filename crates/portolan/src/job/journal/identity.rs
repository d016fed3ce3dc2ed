//! Identifies the job that a journal belongs to.

use std::io::Read;
use std::path::Path;

use portolan_recall::Fingerprint;
use portolan_recording::Recording;

use super::super::MapRequest;
use crate::job::JobError;
use crate::pipeline::Preparation;

/// Everything that the results of a job depend on, each part with its name.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Identity(Vec<(String, String)>);

impl Identity {
    /// Identity of a prepared job.
    ///
    /// # Errors
    /// A known map cannot be read.
    pub fn of(
        recording: &dyn Recording,
        request: &MapRequest,
        preparation: &Preparation,
    ) -> Result<Self, JobError> {
        let topics = fingerprint(&format!("{:?}", preparation.inventory().topics));
        let (size, range) = (recording.size_bytes(), recording.time_range());
        let recorded = format!("{}, {size} bytes, {range:?}, {topics}", recording.format());
        let sensors = fingerprint(&format!("{:?} {:?}", request.ingest, preparation.plan));
        let mut maps = Fingerprint::of("known maps");
        maps.add_text(&format!("{:?} {:?}", request.known.frozen, request.known.start));
        for path in &request.known.files {
            add_file(&mut maps, path).map_err(|source| JobError::file(path, source))?;
        }
        Ok(Self::from_parts(&[
            ("the program", &program()),
            ("the recording", &recorded),
            ("what is used of it", &sensors),
            ("the options", &preparation.options.fingerprint()),
            ("the known map", &format!("{:016x}", maps.value())),
        ]))
    }

    /// From parts and their names.
    pub fn from_parts(parts: &[(&str, &str)]) -> Self {
        Self(parts.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect())
    }

    /// The names of the parts that differ; none if all are equal.
    pub fn difference_from(&self, other: &Self) -> Option<String> {
        let differs = |(name, value): &&(String, String)| {
            other.0.iter().all(|(other_name, other)| other_name != name || other != value)
        };
        let names: Vec<&str> = self.0.iter().filter(differs).map(|(name, _)| name.as_str()).collect();
        (!names.is_empty()).then(|| names.join(" and "))
    }
}

fn fingerprint(text: &str) -> String {
    format!("{:016x}", Fingerprint::of(text).value())
}

/// The version and build of the program: another build may compute differently.
fn program() -> String {
    let file = std::env::current_exe().and_then(std::fs::metadata);
    let build = file.and_then(|file| Ok((file.len(), file.modified()?))).ok();
    format!("{} {build:?}", env!("CARGO_PKG_VERSION"))
}

fn add_file(fingerprint: &mut Fingerprint, path: &Path) -> std::io::Result<()> {
    let mut file = std::fs::File::open(path)?;
    let mut buffer = vec![0; 1 << 20];
    loop {
        let count = file.read(&mut buffer)?;
        if count == 0 {
            return Ok(());
        }
        fingerprint.add_bytes(buffer.get(..count).unwrap_or_default());
    }
}
