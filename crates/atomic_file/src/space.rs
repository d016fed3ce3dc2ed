//! Free disk space.

use std::path::{Path, PathBuf};

/// The disk has too little free space.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "{}: only {} are free, and the results need at least {}",
    folder.display(),
    size(*free),
    size(*needed)
)]
pub struct NoRoom {
    /// Folder of the results.
    pub folder: PathBuf,
    /// Free space there, bytes.
    pub free: u64,
    /// Minimum space that the results need, bytes.
    pub needed: u64,
}

/// A number of bytes with unit, for people.
fn size(bytes: u64) -> String {
    match bytes {
        0..1024 => format!("{bytes} bytes"),
        1024..1_048_576 => format!("{} kB", bytes.div_ceil(1024)),
        _ => format!("{:.1} MB", bytes as f64 / 1_048_576.0),
    }
}

/// Requires `needed` bytes of free space on the disk of a folder. If the free space is unknown, it succeeds.
///
/// # Errors
/// The free space is smaller.
pub fn require_room(folder: &Path, needed: u64) -> Result<(), NoRoom> {
    match free_bytes(folder) {
        Some(free) if free < needed => Err(NoRoom { folder: folder.to_owned(), free, needed }),
        _ => Ok(()),
    }
}

/// Requires `needed` bytes of free space on the disk of a file. For devices and pipes it succeeds.
///
/// # Errors
/// The free space is smaller.
pub fn require_room_for(file: &Path, needed: u64) -> Result<(), NoRoom> {
    let is_other = std::fs::metadata(file).is_ok_and(|found| !found.is_file());
    match file.parent() {
        Some(folder) if !is_other => require_room(folder, needed),
        _ => Ok(()),
    }
}

/// Bytes that may still be written to the disk of a folder; none where that is not known.
#[cfg(unix)]
pub fn free_bytes(folder: &Path) -> Option<u64> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let disk = rustix::fs::statvfs(folder).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Bytes that may still be written to the disk of a folder; none where that is not known.
#[cfg(not(unix))]
pub fn free_bytes(_: &Path) -> Option<u64> {
    None
}

#[cfg(all(test, target_os = "linux"))]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn disks_without_room_are_refused() {
        let error = require_room_for(Path::new("/proc/map"), 1 << 20).unwrap_err().to_string();
        assert_eq!(error, "/proc: only 0 bytes are free, and the results need at least 1.0 MB");
        let error = require_room_for(Path::new("/proc/map"), 4097).unwrap_err().to_string();
        assert!(error.ends_with("at least 5 kB"), "{error}");
        let here = tempfile::tempdir().unwrap();
        require_room(here.path(), 1).unwrap();
        require_room(here.path(), u64::MAX).unwrap_err();
        require_room_for(Path::new("/dev/null"), u64::MAX).unwrap();
        require_room_for(Path::new("map"), 1).unwrap();
    }

    #[test]
    fn disks_have_room() {
        assert!(free_bytes(Path::new("")).is_some_and(|bytes| bytes > 0));
        assert_eq!(free_bytes(Path::new("/proc")), Some(0));
        assert_eq!(free_bytes(Path::new("/no/such/folder")), None);
    }
}
