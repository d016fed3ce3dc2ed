#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

use std::fmt;
use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::Path;
use std::sync::OnceLock;

use portolan_atomic_file::{Disk, nameless_file};
use portolan_recall::{Answer, Words};

/// Number of words written or read at a time: 256 kB.
const BLOCK: usize = 1 << 15;

/// An append-only list that keeps the newest records in memory and the others in a file.
pub struct Spool<T> {
    /// Blocks of words before the newest records; none if everything is in memory.
    file: Option<Disk<File>>,
    /// Positions of the blocks in the file, in order.
    blocks: Vec<Block>,
    newest: Vec<T>,
    words: Vec<u64>,
    len: usize,
    last: Option<T>,
    failure: Option<io::Error>,
    /// Error of reading the file again, if it failed.
    unreadable: OnceLock<io::Error>,
}

/// A block of records that were written together.
#[derive(Clone, Copy, Debug)]
struct Block {
    /// Offset in the file, bytes.
    begin: u64,
    words: usize,
}

impl<T> Default for Spool<T> {
    /// An empty list that stays in memory.
    fn default() -> Self {
        Self {
            file: None,
            blocks: Vec::new(),
            newest: Vec::new(),
            words: Vec::new(),
            len: 0,
            last: None,
            failure: None,
            unreadable: OnceLock::new(),
        }
    }
}

impl<T> fmt::Debug for Spool<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Spool").field("len", &self.len).field("blocks", &self.blocks.len()).finish()
    }
}

impl<T: Answer + Clone> Clone for Spool<T> {
    /// A copy in memory.
    fn clone(&self) -> Self {
        let mut copy: Self = self.iter().collect();
        if let Some(error) = self.unreadable.get() {
            copy.unreadable = OnceLock::from(io::Error::new(error.kind(), error.to_string()));
        }
        copy
    }
}

impl<T: Answer + Clone> FromIterator<T> for Spool<T> {
    fn from_iter<I: IntoIterator<Item = T>>(records: I) -> Self {
        let mut spool = Self::default();
        records.into_iter().for_each(|record| spool.push(record));
        spool
    }
}

impl<T> Spool<T> {
    /// Number of records.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there are no records.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The newest record.
    pub fn last(&self) -> Option<&T> {
        self.last.as_ref()
    }

    /// Error because of which records stay in memory instead of the file, if any.
    pub fn failure(&self) -> Option<&io::Error> {
        self.failure.as_ref()
    }

    /// Reports whether all iterations over the records so far were complete.
    ///
    /// # Errors
    /// The file could not be read again, so that an iteration ended too early.
    pub fn whole(&self) -> io::Result<()> {
        self.unreadable.get().map_or(Ok(()), |error| {
            let text = format!("what waited in a nameless file cannot be read again: {error}");
            Err(io::Error::new(error.kind(), text))
        })
    }
}

impl<T: Answer + Clone> Spool<T> {
    /// An empty list with a nameless file in this folder for its records.
    pub fn in_folder(folder: &Path) -> Self {
        match nameless_file(folder) {
            Ok(file) => Self { file: Some(file), ..Self::default() },
            Err(error) => Self { failure: Some(error), ..Self::default() },
        }
    }

    /// Adds a record.
    pub fn push(&mut self, record: T) {
        if self.file.is_some() && self.failure.is_none() {
            record.write(&mut self.words);
        }
        self.len += 1;
        self.last = Some(record.clone());
        self.newest.push(record);
        if self.words.len() >= BLOCK {
            self.write_block();
        }
    }

    /// All records, in order. If the file can no longer be read, the iteration ends early, and
    /// [`Spool::whole`] returns the error.
    pub fn iter(&self) -> impl Iterator<Item = T> + '_ {
        let (mut blocks, mut newest) = (self.blocks.iter(), self.newest.iter());
        let mut read = Vec::new().into_iter();
        let next = move || loop {
            if let Some(record) = read.next() {
                return Some(record);
            }
            match blocks.next() {
                Some(block) => read = self.read_block(*block)?.into_iter(),
                None => return newest.next().cloned(),
            }
        };
        // Nothing follows a block that cannot be read: the records after it would be out of sequence.
        std::iter::from_fn(next).fuse()
    }

    /// Writes the newest records to the file. If that fails, they and all later ones stay in memory.
    fn write_block(&mut self) {
        let Some(file) = &mut self.file else { return };
        let begin = self.blocks.last().map_or(0, |block| block.begin + bytes_of(block.words));
        let bytes: Vec<u8> = self.words.iter().flat_map(|word| word.to_le_bytes()).collect();
        match file.seek(SeekFrom::Start(begin)).and_then(|_| file.write_all(&bytes)) {
            Ok(()) => {
                self.blocks.push(Block { begin, words: self.words.len() });
                self.newest.clear();
            }
            Err(error) => self.failure = Some(error),
        }
        self.words.clear();
    }

    fn read_block(&self, block: Block) -> Option<Vec<T>> {
        let mut file = self.file.as_ref()?.shared();
        let mut bytes = vec![0; usize::try_from(bytes_of(block.words)).ok()?];
        let read = file.seek(SeekFrom::Start(block.begin)).and_then(|_| file.read_exact(&mut bytes));
        if let Err(error) = read {
            tracing::error!("what waited in a nameless file cannot be read again, and is missing: {error}");
            self.unreadable.get_or_init(|| error);
            return None;
        }
        let words: Vec<u64> = bytes.as_chunks::<8>().0.iter().map(|word| u64::from_le_bytes(*word)).collect();
        let mut words = Words::new(&words);
        Some(std::iter::from_fn(|| T::read(&mut words)).collect())
    }
}

fn bytes_of(words: usize) -> u64 {
    words as u64 * 8
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use portolan_geometry::{Rigid3, Time};

    use super::*;

    type Pose = (Time, Rigid3);

    fn pose(index: i64) -> Pose {
        (Time::from_ticks(index), Rigid3::translation(0.1 * index as f64, 1.0, -2.0))
    }

    #[test]
    fn spooled_items_come_back_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::<Pose>::in_folder(folder.path());
        let count = 3 * BLOCK as i64 / 8 + 7;
        for index in 0..count {
            spool.push(pose(index));
            if index % 5000 == 0 {
                assert_eq!(spool.iter().last(), Some(pose(index)));
            }
        }
        assert!(spool.blocks.len() == 3 && spool.newest.len() < 10, "{spool:?}");
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "the file has a name");
        let all: Vec<Pose> = (0..count).map(pose).collect();
        assert_eq!(spool.iter().collect::<Vec<_>>(), all);
        assert_eq!(spool.clone().iter().collect::<Vec<_>>(), all);
        assert_eq!((spool.len(), spool.last()), (all.len(), all.last()));
    }

    #[test]
    fn items_that_cannot_be_written_are_kept_in_memory() {
        let mut spool = Spool::<Pose>::in_folder(Path::new("/no such folder"));
        assert!(spool.failure().is_some() && spool.is_empty() && spool.last().is_none());
        spool.push(pose(1));
        assert_eq!(spool.iter().collect::<Vec<_>>(), [pose(1)]);
        let Ok(full) = File::options().read(true).write(true).open("/dev/full") else { return };
        let mut spool = Spool { file: Some(Disk(full)), ..Spool::default() };
        (0..20_000).for_each(|index| spool.push(pose(index)));
        assert!(spool.failure().is_some() && spool.iter().eq((0..20_000).map(pose)));
    }
}
