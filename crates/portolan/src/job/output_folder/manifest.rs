//! The file that names what was written.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path};

use serde::{Deserialize, Serialize};

/// Its name.
pub const MANIFEST: &str = "portolan.json";
/// No such file is larger: a hundred thousand names. Bytes.
const LARGEST: u64 = 16 << 20;

/// What was written to a folder, by name.
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
    /// What was written; none if the run ended while it was being written.
    pub content: Option<Content>,
}

/// By what a file is known again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Content {
    bytes: u64,
    crc32: u32,
}

impl Content {
    /// Of a file.
    pub fn of(path: &Path) -> io::Result<Self> {
        let mut file = File::open(path)?;
        if !file.metadata()?.is_file() {
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

impl Record {
    /// Whether the file is what was written.
    pub fn is_of(&self, path: &Path) -> bool {
        let size = path.metadata().map(|data| data.len()).ok();
        // Sizes are compared first: files may be large.
        self.content
            .is_some_and(|content| Some(content.bytes) == size && Content::of(path).ok() == self.content)
    }
}

impl Manifest {
    /// That of a folder, empty if there is none; none if there is something else in its place.
    pub fn read(folder: &Path) -> Option<Self> {
        match File::open(folder.join(MANIFEST)) {
            Ok(file) => serde_json::from_reader(io::BufReader::new(file.take(LARGEST))).ok(),
            Err(error) => (error.kind() == io::ErrorKind::NotFound).then(Self::default),
        }
    }

    /// Whether there is a file of this name that the verb did not write, or that was changed since.
    pub fn is_foreign(&self, folder: &Path, name: &str, verb: &str) -> bool {
        let path = folder.join(name);
        let is_there = std::fs::symlink_metadata(&path).is_ok();
        let was_written = |record: &&Record| record.by == verb;
        is_there
            && self.files.get(name).filter(was_written).is_none_or(|record| {
                // A run that was killed as it wrote the file left it whole, or what was there before.
                record.content.is_some() && !record.is_of(&path)
            })
    }
}

/// Whether a name is that of a file in the folder itself.
pub(super) fn is_plain(name: &str) -> bool {
    let mut parts = Path::new(name).components();
    matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None))
}
