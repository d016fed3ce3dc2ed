//! How much room a disk has.

use std::path::Path;

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
mod tests {
    use super::*;

    #[test]
    fn disks_have_room() {
        assert!(free_bytes(Path::new("")).is_some_and(|bytes| bytes > 0));
        assert_eq!(free_bytes(Path::new("/proc")), Some(0));
        assert_eq!(free_bytes(Path::new("/no/such/folder")), None);
    }
}
