//! Reads and writes the file: eight magic bytes, then records of a length, a checksum and as many bytes. The
//! first record is the identity of the job, each of the others a question and its answer. An incomplete
//! record ends the file.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::ErrorKind::StorageFull;
use std::io::{self, BufReader, Read, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use portolan_atomic_file::{Disk, require_room_for};

use super::Identity;
use crate::job::JobError;

/// Magic bytes at the start of the file.
const MAGIC: &[u8] = b"\x89PMAPJ1\n";
/// Maximum size of an answer, bytes: ten million nodes.
const LARGEST: u32 = 1 << 30;
/// Time after which results are in the file.
const WRITING: Duration = Duration::from_secs(1);
/// Time after which they are on the disk.
const SYNCING: Duration = Duration::from_secs(15);

/// Content of a journal.
pub(super) struct Content {
    /// Open and locked.
    file: Disk<File>,
    pub identity: Identity,
    pub known: BTreeMap<u64, Vec<u64>>,
    /// Number of complete bytes.
    whole: u64,
    /// Number of incomplete bytes after them.
    pub cut_off: u64,
}

impl Content {
    /// The file, truncated to its complete records.
    pub fn cut(mut self) -> io::Result<Disk<File>> {
        self.file.set_len(self.whole)?;
        self.file.seek(SeekFrom::Start(self.whole))?;
        Ok(self.file)
    }
}

/// Reads the complete records of a journal. Where the disk cannot be read the rest is unknown, so this is an
/// error and not the end of the journal.
pub(super) fn read(path: &Path) -> Result<Content, JobError> {
    let failed = |source| JobError::file(path, source);
    let file =
        OpenOptions::new().read(true).write(true).open(path).map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => JobError::NoJournal(path.to_owned()),
            _ => failed(source),
        })?;
    lock(&file).map_err(failed)?;
    let size = file.metadata().map_err(failed)?.len();
    let file = Disk(file);
    let mut reader = BufReader::new(file.shared());
    let mut first = [0; MAGIC.len()];
    let is_journal = filled(&mut reader, &mut first).map_err(failed)? && first == MAGIC;
    let header = if is_journal { record(&mut reader, size).map_err(failed)? } else { None };
    let identity = header.as_deref().and_then(|header| serde_json::from_slice(header).ok());
    let Some(identity) = identity else { return Err(JobError::NoJournal(path.to_owned())) };
    let mut known = BTreeMap::new();
    let mut whole = (MAGIC.len() + FRAME + header.map_or(0, |h| h.len())) as u64;
    while let Some(bytes) = record(&mut reader, size).map_err(failed)? {
        let (words, rest) = bytes.as_chunks::<8>();
        let mut words = words.iter().map(|word| u64::from_le_bytes(*word));
        let (Some(question), []) = (words.next(), rest) else { break };
        known.insert(question, words.collect());
        whole += (FRAME + bytes.len()) as u64;
    }
    drop(reader);
    Ok(Content { file, identity, known, whole, cut_off: size.saturating_sub(whole) })
}

/// Number of bytes of a record beside its content.
const FRAME: usize = 8;

/// The next record; none if it is incomplete.
fn record(reader: &mut impl Read, most: u64) -> io::Result<Option<Vec<u8>>> {
    let mut frame = [0; FRAME];
    if !filled(reader, &mut frame)? {
        return Ok(None);
    }
    let [a, b, c, d, checksum @ ..] = frame;
    let length = u32::from_le_bytes([a, b, c, d]);
    if length > LARGEST || u64::from(length) > most {
        return Ok(None);
    }
    let mut content = Vec::new();
    reader.take(u64::from(length)).read_to_end(&mut content)?;
    let is_whole = content.len() as u64 == u64::from(length)
        && crc32fast::hash(&content) == u32::from_le_bytes(checksum);
    Ok(is_whole.then_some(content))
}

/// Fills these bytes; false where the file ends earlier.
fn filled(reader: &mut impl Read, bytes: &mut [u8]) -> io::Result<bool> {
    match reader.read_exact(bytes) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

fn add_record(bytes: &mut Vec<u8>, content: &[u8]) {
    // Larger answers are not kept, and computed again.
    if let Some(length) = u32::try_from(content.len()).ok().filter(|length| *length <= LARGEST) {
        bytes.extend(length.to_le_bytes());
        bytes.extend(crc32fast::hash(content).to_le_bytes());
        bytes.extend(content);
    }
}

fn lock(file: &File) -> io::Result<()> {
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            Err(io::Error::new(io::ErrorKind::ResourceBusy, "another process is writing it"))
        }
        // Where files cannot be locked, the user must not start two runs with one folder.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
    }
}

/// Writes records on a thread of its own, so that a slow disk does not delay mapping.
pub(super) struct Writer {
    pending: Arc<Pending>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

/// Records that are not written yet. The thread polls them: waking it for each record would take longer than
/// writing it.
#[derive(Default)]
struct Pending {
    bytes: Mutex<Vec<u8>>,
    is_closed: AtomicBool,
    /// The file, once it can be resumed.
    file: OnceLock<PathBuf>,
}

impl Pending {
    fn lock(&self) -> MutexGuard<'_, Vec<u8>> {
        self.bytes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Destination of the records.
enum Target {
    /// The file does not exist yet; these bytes come first.
    New(Vec<u8>),
    Open(Disk<File>),
}

impl Writer {
    /// Writes a new file, which appears with the first records, as long as `reserve` bytes remain free.
    pub fn begin(path: PathBuf, identity: &Identity, reserve: u64) -> Self {
        let mut header = MAGIC.to_vec();
        // A list of texts.
        let identity = serde_json::to_vec(identity).unwrap_or_default();
        add_record(&mut header, &identity);
        Self::start(path, Target::New(header), reserve)
    }

    /// Continues a file.
    pub fn resume(path: PathBuf, file: Disk<File>, reserve: u64) -> Self {
        Self::start(path, Target::Open(file), reserve)
    }

    fn start(path: PathBuf, target: Target, reserve: u64) -> Self {
        let pending = Arc::new(Pending::default());
        let records = Arc::clone(&pending);
        let name = "journal".to_owned();
        let thread =
            std::thread::Builder::new().name(name).spawn(move || write(&path, target, &records, reserve));
        Self { pending, thread: thread.ok() }
    }

    /// Writes everything. Returns the file, if there is one, and the error because of which it ends early, if
    /// any.
    pub fn close(mut self) -> (Option<PathBuf>, io::Result<()>) {
        let written = self.written();
        (self.pending.file.get().cloned(), written)
    }

    /// Adds an answer.
    pub fn add(&self, question: u64, answer: &[u64]) {
        let is_written = self.thread.as_ref().is_some_and(|thread| !thread.is_finished());
        if is_written {
            let words = std::iter::once(&question).chain(answer);
            let content: Vec<u8> = words.flat_map(|word| word.to_le_bytes()).collect();
            add_record(&mut self.pending.lock(), &content);
        }
    }

    fn written(&mut self) -> io::Result<()> {
        let Some(thread) = self.thread.take() else {
            return Err(io::Error::other("no thread could be started"));
        };
        self.pending.is_closed.store(true, Ordering::Release);
        thread.thread().unpark();
        thread.join().unwrap_or_else(|_| Err(io::Error::other("its thread has stopped")))
    }
}

/// Writes records until it is closed, or until only the reserve would remain free: results have priority over
/// the journal. A job that takes less than a second leaves no file.
fn write(path: &Path, mut target: Target, pending: &Pending, reserve: u64) -> io::Result<()> {
    if matches!(target, Target::Open(_)) {
        pending.file.get_or_init(|| path.to_owned());
    }
    let began = Instant::now();
    let (mut written_at, mut synced_at) = (began, began);
    loop {
        let rest = WRITING.saturating_sub(written_at.elapsed());
        let is_last = pending.is_closed.load(Ordering::Acquire);
        if !rest.is_zero() && !is_last {
            std::thread::park_timeout(rest);
            continue;
        }
        let bytes = std::mem::take(&mut *pending.lock());
        let is_long = began.elapsed() >= WRITING || matches!(target, Target::Open(_));
        if is_long && !bytes.is_empty() {
            let file = opened(path, &mut target)?;
            pending.file.get_or_init(|| path.to_owned());
            let needed = reserve.saturating_add(bytes.len() as u64);
            require_room_for(path, needed).map_err(|no_room| io::Error::new(StorageFull, no_room))?;
            file.write_all(&bytes)?;
            if synced_at.elapsed() >= SYNCING {
                file.sync_data()?;
                synced_at = Instant::now();
            }
        }
        written_at = Instant::now();
        if is_last {
            return Ok(());
        }
    }
}

/// The file; created if it does not exist yet.
fn opened<'a>(path: &Path, target: &'a mut Target) -> io::Result<&'a mut Disk<File>> {
    if let Target::New(header) = target {
        let mut file = create(path)?;
        if let Err(error) = file.write_all(header).and_then(|()| file.sync_all()) {
            // Without a whole header it cannot be resumed.
            let _ = std::fs::remove_file(path);
            return Err(error);
        }
        *target = Target::Open(file);
    }
    match target {
        Target::Open(file) => Ok(file),
        Target::New(_) => Err(io::Error::other("no journal")),
    }
}

/// Creates the file, or empties one of an earlier run. Anything else of this name stays.
fn create(path: &Path) -> io::Result<Disk<File>> {
    let is_link = std::fs::symlink_metadata(path).is_ok_and(|found| !found.is_file());
    if is_link {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "it is there already and no file"));
    }
    let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
    lock(&file)?;
    let mut file = Disk(file);
    let mut first = Vec::new();
    Read::by_ref(&mut file).take(MAGIC.len() as u64).read_to_end(&mut first)?;
    if !MAGIC.starts_with(&first) {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "it is there already and no journal"));
    }
    file.set_len(0)?;
    file.seek(SeekFrom::Start(0))?;
    Ok(file)
}
