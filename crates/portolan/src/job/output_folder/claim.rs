//! Ensures that only one run at a time writes to a folder: otherwise results of two runs would be mixed.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;

use crate::job::JobError;

/// A lock on the folder, which ends with the run, however it ends.
#[derive(Debug, Default)]
pub(super) struct Claim(Option<File>);

impl Claim {
    /// Locks the folder, if it exists. Where folders cannot be locked, the user must not start two runs in
    /// one folder.
    ///
    /// # Errors
    /// Another run has it.
    pub fn make(&mut self, folder: &Path) -> Result<(), JobError> {
        if self.0.is_some() || !folder.is_dir() {
            return Ok(());
        }
        let Ok(opened) = File::open(folder) else { return Ok(()) };
        if let Err(TryLockError::WouldBlock) = opened.try_lock() {
            let reason = "another run is writing its results there; take another folder, or wait for it";
            return Err(JobError::file(folder, io::Error::new(io::ErrorKind::ResourceBusy, reason)));
        }
        self.0 = Some(opened);
        Ok(())
    }
}
