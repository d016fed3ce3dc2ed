//! Keeps a journal of a job in a file beside its results, from which an interrupted job can be resumed.
//!
//! Mapping gives the same bytes for the same input. So none of its state has to be kept, only the results of
//! expensive computations: poses of matched scans, nodes found by searches, results of optimisations
//! ([`portolan_recall`]). A resumed job does everything again from the beginning and takes these results from
//! the journal while they last.

mod file;
mod identity;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use portolan_recall::{Memory, Recall};

use super::error::JobError;
use file::Writer;
pub use identity::Identity;

/// Name of the file in the folder of results.
pub const JOURNAL: &str = "map.journal";

/// The journal of a job. Its file stays until it is removed explicitly.
pub struct Journal {
    answers: Arc<Answers>,
}

/// Results of an earlier run, and the writer for those of this one.
struct Answers {
    known: BTreeMap<u64, Vec<u64>>,
    writer: Mutex<Option<Writer>>,
}

impl Recall for Answers {
    fn recall(&self, question: u64) -> Option<Vec<u64>> {
        self.known.get(&question).cloned()
    }

    fn keep(&self, question: u64, answer: &[u64]) {
        if self.known.contains_key(&question) {
            return;
        }
        if let Some(writer) = &*self.writer.lock().unwrap_or_else(PoisonError::into_inner) {
            writer.add(question, answer);
        }
    }
}

/// Content of the journal of an earlier run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resumed {
    /// Results that need not be computed again.
    pub answers: usize,
    /// Incomplete bytes at the end.
    pub cut_off: u64,
}

impl Journal {
    /// Begins a journal in a folder. The file appears with the first results, if the job takes longer than a
    /// second. A journal of another run there is replaced. Writing ends where less than `reserve` bytes would
    /// remain free for the results.
    pub fn begin(folder: &Path, identity: &Identity, reserve: u64) -> Self {
        let writer = Writer::begin(folder.join(JOURNAL), identity, reserve);
        Self { answers: Arc::new(Answers { known: BTreeMap::new(), writer: Mutex::new(Some(writer)) }) }
    }

    /// Resumes the journal in a folder, with a reserve as in [`Journal::begin`].
    ///
    /// # Errors
    /// There is none, it cannot be read, it belongs to another job, or another process is writing it.
    pub fn resume(folder: &Path, identity: &Identity, reserve: u64) -> Result<(Self, Resumed), JobError> {
        let path = folder.join(JOURNAL);
        let mut content = file::read(&path)?;
        if let Some(difference) = identity.difference_from(&content.identity) {
            return Err(JobError::JournalOfAnother { path, difference });
        }
        let known = std::mem::take(&mut content.known);
        let resumed = Resumed { answers: known.len(), cut_off: content.cut_off };
        let file = content.cut().map_err(|source| JobError::file(&path, source))?;
        let writer = Mutex::new(Some(Writer::resume(path, file, reserve)));
        Ok((Self { answers: Arc::new(Answers { known, writer }) }, resumed))
    }

    /// A memory that uses this journal.
    pub fn memory(&self) -> Memory {
        Memory::new(self.answers.clone())
    }

    /// Writes everything that is pending. Returns the file, if there is one, and the error because of which
    /// it ends early or is missing, if any.
    pub fn close(&self) -> (Option<PathBuf>, std::io::Result<()>) {
        let writer = self.answers.writer.lock().unwrap_or_else(PoisonError::into_inner).take();
        writer.map_or((None, Ok(())), Writer::close)
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        let _ = self.close();
    }
}

#[cfg(test)]
mod tests;
