//! Opens files that must not be pipes, and reads small files whole.

use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use crate::Forward;

/// Maximum size of an input from a pipe that is read into memory, bytes.
const MOST_OF_A_PIPE: u64 = 256 << 20;

/// Path under which the system knows an input: `-` is the standard input.
pub fn named(path: &Path) -> Cow<'_, Path> {
    match path.to_str() {
        Some("-") if cfg!(unix) => Cow::Borrowed(Path::new("/dev/stdin")),
        _ => Cow::Borrowed(path),
    }
}

/// Opens a file that is read more than once, or not from start to end.
///
/// # Errors
/// Errors of the system; [`io::ErrorKind::Unsupported`] for pipes and devices, with advice in the message. A pipe is
/// not opened, because that might block forever.
pub fn regular_file(path: &Path) -> io::Result<File> {
    let path = named(path);
    let metadata = fs::metadata(&path)?;
    if metadata.is_file() || metadata.is_dir() {
        return File::open(&path);
    }
    Err(io::Error::new(
        io::ErrorKind::Unsupported,
        "this is a pipe or a device, but such an input is read more than once: save it as a file first \
         (`cat > FILE`) and name that",
    ))
}

/// Reads a whole file of at most `limit` bytes; from a pipe at most 256 MiB.
///
/// # Errors
/// Errors of the system, and [`io::ErrorKind::FileTooLarge`] beyond the limit.
pub fn read_all(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let mut input = Forward::open(path)?;
    let limit = if input.length().is_some() { limit } else { limit.min(MOST_OF_A_PIPE) };
    let too_large = || {
        let text = format!("larger than {} MiB: this is no such file", limit >> 20);
        Err(io::Error::new(io::ErrorKind::FileTooLarge, text))
    };
    if input.length().is_some_and(|length| length > limit) {
        return too_large();
    }
    let mut bytes = Vec::new();
    input.by_ref().take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { too_large() } else { Ok(bytes) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn endless_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sparse");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let error = read_all(&path, 1 << 20).unwrap_err();
        assert!(error.to_string().contains("larger than 1 MiB"), "{error}");
        assert!(read_all(&folder.path().join("none"), 1).is_err());
        fs::write(&path, "text").unwrap();
        assert_eq!(read_all(&path, 4).unwrap(), b"text");
        assert!(regular_file(&path).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_no_files() {
        let zero = Path::new("/dev/zero");
        assert!(read_all(zero, 1 << 16).is_err());
        assert!(regular_file(zero).unwrap_err().to_string().contains("save it as a file first"));
        assert_eq!(named(Path::new("-")), Path::new("/dev/stdin"));
    }
}
