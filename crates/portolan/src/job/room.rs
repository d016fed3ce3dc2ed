//! Whether there is room for the results, before hours are spent on them.

use std::path::Path;

use portolan_atomic_file::free_bytes;

use super::error::JobError;

/// The least that trajectory, report and pictures take, bytes.
const LEAST: u64 = 1 << 20;
/// A map takes at least one byte for so many of the recording, a cloud of its points one for so many. Real ones take
/// several times as much.
const RECORDING_BY_MAP: u64 = 400;
const RECORDING_BY_CLOUD: u64 = 50;

/// What the results will need at the very least, bytes.
pub(super) fn needed(recording_bytes: u64, with_cloud: bool) -> u64 {
    let cloud = if with_cloud { recording_bytes / RECORDING_BY_CLOUD } else { 0 };
    LEAST + recording_bytes / RECORDING_BY_MAP + cloud
}

/// Refuses a folder on a disk without that much room. Where it is not known how much there is, everything fits.
pub(super) fn require(folder: &Path, needed: u64) -> Result<(), JobError> {
    match free_bytes(folder) {
        Some(free) if free < needed => Err(JobError::NoRoom { folder: folder.to_owned(), free, needed }),
        _ => Ok(()),
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn disks_without_room_are_refused() {
        let error = require(Path::new("/proc"), needed(0, false)).unwrap_err().to_string();
        assert_eq!(error, "/proc: only 0.0 MB are free, and the results need at least 1.0 MB");
        let here = tempfile::tempdir().unwrap();
        require(here.path(), 1).unwrap();
        require(here.path(), u64::MAX).unwrap_err();
        assert!(needed(1 << 30, true) > needed(1 << 30, false) && needed(0, true) == LEAST);
    }
}
