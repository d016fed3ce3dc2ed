//! Reads the file that lists what was written.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path};

use portolan_atomic_file::Disk;
use serde::{Deserialize, Serialize};

/// Its name.
pub const MANIFEST: &str = "portolan.json";
/// Maximum size of the file, bytes: a hundred thousand names.
const LARGEST: u64 = 16 << 20;

/// Files that were written to a folder, by name.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Manifest {
    about: String,
    pub files: BTreeMap<String, Record>,
}

impl Default for Manifest {
    fn default() -> Self {
        let about = "files here that Portolan wrote; others it does not overwrite".to_owned();
        Self { about, files: BTreeMap::new() }
    }
}

/// A file that was written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Record {
    /// The verb that wrote it.
    pub by: String,
    /// Size and checksum; none if the run ended while the file was being written.
    pub content: Option<Content>,
}

/// Size and checksum by which a file is recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Content {
    bytes: u64,
    crc32: u32,
}

impl Content {
    /// Size and checksum of a file; `NotFound` or `InvalidInput` if there is none.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut file = Disk(File::open(path)?);
        if !file.0.metadata()?.is_file() {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        let (mut hasher, mut bytes, mut buffer) = (crc32fast::Hasher::new(), 0, vec![0; 1 << 18]);
        loop {
            let read = match file.read(&mut buffer) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                read => read?,
            };
            let Some(part @ [_, ..]) = buffer.get(..read) else { break };
            hasher.update(part);
            bytes += read as u64;
        }
        Ok(Self { bytes, crc32: hasher.finalize() })
    }
}

/// Whether there is no file, as opposed to a file that cannot be read.
pub(super) fn is_no_file(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::InvalidInput)
}

impl Record {
    /// Whether the file is unchanged since it was written.
    ///
    /// # Errors
    /// It cannot be read, so that this is unknown.
    pub fn is_of(&self, path: &Path) -> io::Result<bool> {
        let size = path.metadata().map(|data| data.len()).ok();
        // Sizes are compared first: files may be large.
        let Some(content) = self.content.filter(|content| Some(content.bytes) == size) else {
            return Ok(false);
        };
        match Content::of(path) {
            Ok(found) => Ok(found == content),
            Err(error) if is_no_file(&error) => Ok(false),
            Err(error) => Err(error),
        }
    }
}

impl Manifest {
    /// The manifest of a folder, empty if there is none; none if there is something else in its place.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn read(folder: &Path) -> io::Result<Option<Self>> {
        let path = folder.join(MANIFEST);
        let file = match File::open(&path) {
            Ok(file) if path.is_file() => Disk(file),
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Some(Self::default())),
            _ => return Ok(None),
        };
        match serde_json::from_reader(io::BufReader::new(file.take(LARGEST))) {
            Ok(manifest) => Ok(Some(manifest)),
            Err(error) if error.is_io() => Err(error.into()),
            Err(_) => Ok(None),
        }
    }

    /// Whether there is a file of this name that the verb did not write, or that was changed since.
    ///
    /// # Errors
    /// It cannot be read, so that this is unknown.
    pub fn is_foreign(&self, folder: &Path, name: &str, verb: &str) -> io::Result<bool> {
        let path = folder.join(name);
        if std::fs::symlink_metadata(&path).is_err() {
            return Ok(false);
        }
        match self.files.get(name).filter(|record| record.by == verb) {
            // A run that was killed while it wrote the file left it complete, or left the file before it.
            Some(record) => Ok(record.content.is_some() && !record.is_of(&path)?),
            None => Ok(true),
        }
    }
}

/// Whether a name is that of a file in the folder itself.
pub(super) fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None))
}
