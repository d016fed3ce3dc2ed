#![doc = include_str!("../README.md")]

mod disk;
#[cfg(feature = "faults")]
pub mod faults;
mod folder;
mod leftover;
mod space;

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use portolan_unfinished::Unfinished;
use tempfile::NamedTempFile;

pub use disk::{Disk, nameless_file};
use disk::{before_operation, sync};
pub use folder::ResultFolder;
pub use leftover::{Leftovers, remove_leftovers};
pub use space::{NoRoom, free_bytes, require_room, require_room_for};

/// A file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write \"{}\": {source}", path.display())]
pub struct WriteError {
    /// The file that should have been written.
    pub path: PathBuf,
    /// Error of the system.
    pub source: io::Error,
}

/// A file that is written under a temporary name in the folder of its destination and renamed by
/// [`AtomicFile::commit`]. If it is dropped without that, the temporary file is removed, and an earlier file of the
/// final name stays unchanged.
///
/// Devices and pipes (`/dev/stdout`) are written to directly.
pub struct AtomicFile {
    path: PathBuf,
    target: Target,
    /// First error of a write. The file is then incomplete, even if the caller ignored the error and went on.
    failure: Option<io::Error>,
}

enum Target {
    /// Temporary file, to be renamed to the path.
    Temporary(BufWriter<Disk<NamedTempFile>>, Unfinished, PathBuf),
    Direct(BufWriter<Disk<File>>),
}

const BUFFER: usize = 256 << 10;

impl AtomicFile {
    /// Begins a file.
    ///
    /// # Errors
    /// The folder is missing or not writable, the path is a folder, or it is a dangling symbolic link.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, WriteError> {
        let path = path.as_ref();
        let target = open_target(path).map_err(|source| WriteError { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), target, failure: None })
    }

    /// Final path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces bytes that were written before: for headers with counts that are known only at the end.
    ///
    /// # Errors
    /// The system cannot write, or this is a pipe, which is not seekable.
    pub fn overwrite(&mut self, offset: u64, bytes: &[u8]) -> io::Result<()> {
        fn overwrite(file: &mut (impl Write + Seek), offset: u64, bytes: &[u8]) -> io::Result<()> {
            file.seek(SeekFrom::Start(offset))?;
            file.write_all(bytes)?;
            file.seek(SeekFrom::End(0)).map(drop)
        }
        let done = match &mut self.target {
            Target::Temporary(writer, ..) => overwrite(writer, offset, bytes),
            Target::Direct(writer) => overwrite(writer, offset, bytes),
        };
        self.noted(done)
    }

    /// An unbuffered handle, for a library that writes the file itself and reads it while writing.
    ///
    /// # Errors
    /// The system cannot duplicate the handle.
    pub fn handle(&self) -> io::Result<Disk<File>> {
        let handle = match &self.target {
            Target::Temporary(writer, ..) => writer.get_ref().0.as_file().try_clone(),
            Target::Direct(writer) => writer.get_ref().0.try_clone(),
        };
        handle.map(Disk)
    }

    /// Remembers the first error of a write.
    fn noted<T>(&mut self, done: io::Result<T>) -> io::Result<T> {
        match &done {
            // An interrupted write is retried by the caller and is no failure.
            Err(error) if error.kind() != io::ErrorKind::Interrupted && self.failure.is_none() => {
                self.failure = Some(copy_of(error));
            }
            _ => {}
        }
        done
    }

    /// Flushes the buffer, waits until the content is on the disk and renames the file to its final name.
    ///
    /// # Errors
    /// The buffer or anything before could not be written, or the file cannot be synchronised or renamed.
    pub fn commit(self) -> Result<(), WriteError> {
        if let Some(source) = self.failure {
            return Err(WriteError { path: self.path, source });
        }
        let written = match self.target {
            Target::Temporary(writer, unfinished, destination) => {
                commit_temporary(writer, unfinished, &destination)
            }
            Target::Direct(mut writer) => writer.flush(),
        };
        written.map_err(|source| WriteError { path: self.path, source })
    }

    /// Adds the path of the file to the error of a write.
    pub fn error(&self, source: io::Error) -> WriteError {
        WriteError { path: self.path.clone(), source }
    }
}

/// Writes a whole file at once.
///
/// # Errors
/// The file cannot be created, as with [`AtomicFile::create`], or cannot be written, synchronised or renamed.
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
            // Some formats are read while they are written.
            let both = OpenOptions::new().read(true).write(true).open(path);
            let file = both.or_else(|_| OpenOptions::new().write(true).open(path))?;
            return Ok(Target::Direct(BufWriter::with_capacity(BUFFER, Disk(file))));
        }
    }
    let destination = destination(path)?;
    let folder = folder_of(&destination);
    if !folder.is_dir() {
        let text = format!("the folder \"{}\" does not exist", folder.display());
        return Err(io::Error::new(io::ErrorKind::NotFound, text));
    }
    before_operation()?;
    let (unfinished, file) = temporary_file(folder)?;
    Ok(Target::Temporary(BufWriter::with_capacity(BUFFER, Disk(file)), unfinished, destination))
}

/// Maximum number of attempts to create a temporary file: another process may take it for a leftover and remove it
/// between its creation and its lock.
const ATTEMPTS: usize = 8;

/// Creates a temporary file that is removed when a signal ends the process, and that [`remove_leftovers`] of another
/// process does not remove.
fn temporary_file(folder: &Path) -> io::Result<(Unfinished, NamedTempFile)> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(leftover::PREFIX).suffix(leftover::SUFFIX);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // The usual permissions of a new file; the system applies the umask of the user.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    for _ in 0..ATTEMPTS {
        let (unfinished, file) =
            Unfinished::create_named(|| builder.tempfile_in(folder), NamedTempFile::path).map_err(plain)?;
        if leftover::claim(file.as_file(), file.path()) {
            return Ok((unfinished, file));
        }
    }
    Err(io::Error::new(io::ErrorKind::ResourceBusy, "another program removes temporary files there"))
}

/// The error of the system without the temporary path that `tempfile` appends, which is meaningless to the user.
pub(crate) fn plain(error: io::Error) -> io::Error {
    match error.to_string().split_once(" at path \"") {
        Some((cause, _)) => io::Error::new(error.kind(), cause.to_owned()),
        None => error,
    }
}

/// Copy of an error; [`io::Error`] is not `Clone`.
fn copy_of(error: &io::Error) -> io::Error {
    match error.raw_os_error() {
        Some(code) => io::Error::from_raw_os_error(code),
        None => io::Error::new(error.kind(), error.to_string()),
    }
}

/// Target of a symbolic link, so that the file behind the link is replaced and the link is kept; else the path itself.
fn destination(path: &Path) -> io::Result<PathBuf> {
    if !fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_symlink()) {
        return Ok(path.to_owned());
    }
    fs::canonicalize(path).map_err(|error| {
        let text = "it is a link that leads nowhere; remove it, or make what it points to";
        io::Error::new(error.kind(), text)
    })
}

/// The folder that a file is in.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn commit_temporary(
    writer: BufWriter<Disk<NamedTempFile>>,
    unfinished: Unfinished,
    destination: &Path,
) -> io::Result<()> {
    let Disk(file) = writer.into_inner().map_err(io::IntoInnerError::into_error)?;
    before_operation()?;
    sync(file.as_file())?;
    before_operation()?;
    unfinished.complete(|| file.persist(destination).map_err(|e| e.error))?;
    sync_folder(folder_of(destination))
}

/// Waits until the new directory entry is on the disk. Not every system allows folders to be opened or synchronised;
/// there it does nothing.
fn sync_folder(folder: &Path) -> io::Result<()> {
    let Ok(folder) = File::open(folder) else { return Ok(()) };
    sync(&folder).or_else(|error| match error.kind() {
        io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported | io::ErrorKind::PermissionDenied => Ok(()),
        _ => Err(error),
    })
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let done = match &mut self.target {
            Target::Temporary(writer, ..) => writer.write(bytes),
            Target::Direct(writer) => writer.write(bytes),
        };
        self.noted(done)
    }

    fn flush(&mut self) -> io::Result<()> {
        let done = match &mut self.target {
            Target::Temporary(writer, ..) => writer.flush(),
            Target::Direct(writer) => writer.flush(),
        };
        self.noted(done)
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
        file.overwrite(0, b"2").unwrap();
        file.write_all(b" b").unwrap();
        file.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"2 points: a b");
    }

    #[test]
    fn errors_name_the_missing_folder() {
        let folder = tempfile::tempdir().unwrap();
        let error = AtomicFile::create(folder.path().join("no/such/map")).err().unwrap();
        assert!(error.to_string().contains("does not exist"), "{error}");
        #[cfg(target_os = "linux")]
        assert!(!AtomicFile::create("/proc/map").err().unwrap().to_string().contains(".tmp"));
        let error = AtomicFile::create(folder.path()).err().unwrap();
        assert!(error.to_string().contains("folder of this name"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_kept_and_devices_are_written_directly() {
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

    #[cfg(unix)]
    #[test]
    fn symbolic_links_at_temporary_names_are_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (victim, path) = (folder.path().join("victim"), folder.path().join("map"));
        fs::write(&victim, "precious").unwrap();
        for name in ["map.part", "map.tmp", ".map.tmp", ".portolan-.tmp"] {
            std::os::unix::fs::symlink(&victim, folder.path().join(name)).unwrap();
        }
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read(&victim).unwrap(), b"precious");
        let nowhere = folder.path().join("nowhere");
        std::os::unix::fs::symlink(folder.path().join("missing"), &nowhere).unwrap();
        let error = write_atomically(&nowhere, b"new").unwrap_err();
        assert!(error.to_string().contains("leads nowhere"), "{error}");
        assert!(!folder.path().join("missing").exists());
    }

    #[test]
    fn one_of_several_concurrent_writers_leaves_a_whole_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map");
        let mut files: Vec<AtomicFile> = (0..4).map(|_| AtomicFile::create(&path).unwrap()).collect();
        for _ in 0..1000 {
            for (letter, file) in (b'a'..).zip(&mut files) {
                file.write_all(&[letter; 100]).unwrap();
            }
        }
        std::thread::scope(|scope| {
            files.into_iter().for_each(|file| drop(scope.spawn(|| file.commit().unwrap())));
        });
        let written = fs::read(&path).unwrap();
        assert_eq!(written.len(), 100_000);
        assert!(written.iter().all(|byte| *byte == written[0]));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error() {
        let error = write_atomically("/dev/full", b"data").unwrap_err();
        assert!(error.to_string().contains("/dev/full"), "{error}");
    }
}
