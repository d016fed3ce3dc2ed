//! Output files appear under their name only when they are complete.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use portolan_unfinished::Unfinished;
use tempfile::NamedTempFile;

/// A file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write \"{}\": {source}", path.display())]
pub struct WriteError {
    /// The file that should have been written.
    pub path: PathBuf,
    /// What the system says.
    pub source: io::Error,
}

/// A file that is written under a temporary name beside its place and renamed by
/// [`AtomicFile::commit`]. Dropped without that, it leaves nothing behind, and a file that was there
/// before stays as it was.
///
/// Devices and pipes (`/dev/stdout`) are written to directly.
pub struct AtomicFile {
    path: PathBuf,
    target: Target,
}

enum Target {
    Temporary(BufWriter<NamedTempFile>, Unfinished),
    Direct(BufWriter<File>),
}

const BUFFER: usize = 256 << 10;

impl AtomicFile {
    /// Begins a file. Errors: the folder is missing or not writable, the name is a folder's.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, WriteError> {
        let path = path.as_ref();
        let target = open_target(path).map_err(|source| WriteError { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), target })
    }

    /// The name the file will have.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces bytes at the start: headers whose numbers are known at last. Errors: a pipe, which cannot go
    /// back.
    pub fn overwrite_start(&mut self, bytes: &[u8]) -> io::Result<()> {
        fn overwrite(file: &mut (impl Write + Seek), bytes: &[u8]) -> io::Result<()> {
            file.seek(SeekFrom::Start(0))?;
            file.write_all(bytes)?;
            file.seek(SeekFrom::End(0)).map(drop)
        }
        match &mut self.target {
            Target::Temporary(writer, _) => overwrite(writer, bytes),
            Target::Direct(writer) => overwrite(writer, bytes),
        }
    }

    /// Writes out what is buffered, waits until it is on the disk and gives the file its name.
    pub fn commit(self) -> Result<(), WriteError> {
        let path = self.path;
        let written = match self.target {
            Target::Temporary(writer, unfinished) => commit_temporary(writer, unfinished, &path),
            Target::Direct(mut writer) => writer.flush(),
        };
        written.map_err(|source| WriteError { path, source })
    }

    /// The error of a write, with the name of the file.
    pub fn error(&self, source: io::Error) -> WriteError {
        WriteError { path: self.path.clone(), source }
    }
}

/// Writes a whole file at once.
pub fn write_atomically(path: impl AsRef<Path>, content: &[u8]) -> Result<(), WriteError> {
    let mut file = AtomicFile::create(path)?;
    if let Err(source) = file.write_all(content) {
        return Err(file.error(source));
    }
    file.commit()
}

fn open_target(path: &Path) -> io::Result<Target> {
    if let Ok(metadata) = fs::metadata(path) {
        if metadata.is_dir() {
            return Err(io::Error::new(io::ErrorKind::IsADirectory, "there is a folder of this name"));
        }
        if !metadata.is_file() {
            let file = OpenOptions::new().write(true).open(path)?;
            return Ok(Target::Direct(BufWriter::with_capacity(BUFFER, file)));
        }
    }
    let path = &destination(path);
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        let text = format!("the folder \"{}\" does not exist", folder.display());
        return Err(io::Error::new(io::ErrorKind::NotFound, text));
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".portolan-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // As for any new file; the system takes away what the user's mask forbids.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    let (unfinished, file) = Unfinished::create_named(|| builder.tempfile_in(folder), NamedTempFile::path)?;
    Ok(Target::Temporary(BufWriter::with_capacity(BUFFER, file), unfinished))
}

/// Where a link leads, so that the link stays one.
fn destination(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

fn commit_temporary(writer: BufWriter<NamedTempFile>, unfinished: Unfinished, path: &Path) -> io::Result<()> {
    let file = writer.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.as_file().sync_all()?;
    unfinished.complete(|| file.persist(destination(path)).map(drop).map_err(|e| e.error))
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.target {
            Target::Temporary(writer, _) => writer.write(bytes),
            Target::Direct(writer) => writer.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.target {
            Target::Temporary(writer, _) => writer.flush(),
            Target::Direct(writer) => writer.flush(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn appears_only_when_committed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.pgm");
        write_atomically(&path, b"old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"half").unwrap();
        drop(file);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
    }

    #[test]
    fn headers_are_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud");
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"0 points: a").unwrap();
        file.overwrite_start(b"2").unwrap();
        file.write_all(b" b").unwrap();
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"2 points: a b");
    }

    #[test]
    fn says_what_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let error = AtomicFile::create(folder.path().join("no/such/map")).err().unwrap();
        assert!(error.to_string().contains("does not exist"), "{error}");
        let error = AtomicFile::create(folder.path()).err().unwrap();
        assert!(error.to_string().contains("folder of this name"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_and_devices_are_written_directly() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a"), folder.path().join("b"));
        fs::write(&path, "old").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        write_atomically(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&path).unwrap(), b"new");
        write_atomically("/dev/null", b"gone").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error() {
        let error = write_atomically("/dev/full", b"data").unwrap_err();
        assert!(error.to_string().contains("/dev/full"), "{error}");
    }
}
