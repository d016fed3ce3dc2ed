//! What a job has found out so far, in a file beside its results: if it is cut off, it goes on from there.
//!
//! Mapping gives the same bytes for the same input. So nothing of its state has to be kept, only the answers of what takes
//! long: where scans match, where searches found nodes, what optimisations gave ([`portolan_recall`]). A job that goes on
//! does everything again from the beginning and takes the answers from the journal as long as there are any.

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

/// The journal of a job. Its file stays until somebody removes it.
pub struct Journal {
    answers: Arc<Answers>,
}

/// Answers of an earlier run, and where those of this one go.
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

/// What there was of an earlier run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resumed {
    /// Answers that need not be found again.
    pub answers: usize,
    /// Bytes at the end that were not whole.
    pub cut_off: u64,
}

impl Journal {
    /// Begins a journal in a folder; the file appears with the first answers that have been there for a moment. What
    /// another run left of this name is replaced. It ends where less than `reserve` bytes would be left for the results.
    pub fn begin(folder: &Path, identity: &Identity, reserve: u64) -> Self {
        let writer = Writer::begin(folder.join(JOURNAL), identity, reserve);
        Self { answers: Arc::new(Answers { known: BTreeMap::new(), writer: Mutex::new(Some(writer)) }) }
    }

    /// Goes on with the journal in a folder, with a reserve as in [`Journal::begin`].
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
        let writer = Mutex::new(Some(Writer::go_on(path, file, reserve)));
        Ok((Self { answers: Arc::new(Answers { known, writer }) }, resumed))
    }

    /// Remembers with this journal.
    pub fn memory(&self) -> Memory {
        Memory::new(self.answers.clone())
    }

    /// Writes what is not written yet; the file, if there is one, and why it ends early or is missing, if it does or is.
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
