//! Loads segments; compressed ones are loaded ahead on other threads.

use std::collections::{BTreeSet, VecDeque};
use std::ops::Range;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};

use super::{
    ChunkIndex, Compression, Content, FileBytes, RecordFormat, Segment, SegmentLoader, Source, walk,
};
use crate::RecordingError;
use portolan_issue::{IssueKind, IssueLog};

/// A message within a loaded segment.
#[derive(Clone)]
pub(super) struct Entry {
    pub(super) nanoseconds: u64,
    pub(super) connection: u32,
    pub(super) payload: Range<u32>,
}

/// A decompressed segment and the wanted messages in it.
pub(super) struct LoadedSegment {
    pub(super) data: Vec<u8>,
    /// In order of log time; ties in file order.
    pub(super) entries: Vec<Entry>,
    /// Damage found in it.
    pub(super) damage: IssueLog,
}

/// Everything that is needed to load any segment.
pub(super) struct Plan {
    pub(super) source: Source,
    pub(super) format: Arc<dyn RecordFormat>,
    pub(super) index: Arc<ChunkIndex>,
    pub(super) wanted: BTreeSet<u32>,
}

impl Plan {
    /// Whether a segment must be read. Segments with messages of unknown connections are read because these
    /// messages must be counted as lost.
    pub(super) fn needs(&self, segment: &Segment) -> bool {
        segment.connections.as_ref().is_none_or(|list| {
            list.iter().any(|id| self.wanted.contains(id) || !self.index.connections.contains_key(id))
        })
    }

    fn load(
        &self,
        segment: &Segment,
        file: &mut FileBytes,
        loader: &mut SegmentLoader,
        mut data: Vec<u8>,
    ) -> Result<LoadedSegment, RecordingError> {
        let mut damage = IssueLog::default();
        loader.load(segment, file, &mut data, &mut damage)?;
        let (mut entries, mut undescribed) = (Vec::new(), 0);
        let gaps = walk(&*self.format, &data, |record| {
            let Content::Message { connection, nanoseconds, payload } = record.content else { return };
            if self.wanted.contains(&connection) {
                // Segments are smaller than 4 GiB.
                let payload = payload.start as u32..payload.end as u32;
                entries.push(Entry { nanoseconds, connection, payload });
            } else if !self.index.connections.contains_key(&connection) {
                undescribed += 1;
            }
        });
        damage.count(IssueKind::DamagedRecords, gaps);
        damage.count(IssueKind::UndescribedTopic, undescribed);
        entries.sort_by_key(|entry| entry.nanoseconds); // stable
        Ok(LoadedSegment { data, entries, damage })
    }
}

/// A segment to load on another thread: its number, a buffer to use, and the channel for the result.
type Job = (usize, Vec<u8>, SyncSender<Result<LoadedSegment, RecordingError>>);

/// Maximum size of decompressed data that is loaded ahead, bytes.
const MAX_AHEAD_BYTES: u64 = 64 << 20;
const MAX_THREADS: usize = 8;

/// Loads the needed segments one after the other, in the order of the index.
pub(super) struct Loader {
    plan: Arc<Plan>,
    file: FileBytes,
    segments: SegmentLoader,
    /// Buffers of closed segments, for reuse.
    spare: Vec<Vec<u8>>,
    threads: usize,
    /// Threads are started with the first segment that is loaded ahead.
    jobs: Option<Sender<Job>>,
    /// Next segment to give to a thread.
    ahead: usize,
    ahead_bytes: u64,
    loading: VecDeque<(usize, Receiver<Result<LoadedSegment, RecordingError>>)>,
}

impl Loader {
    pub(super) fn new(plan: Plan) -> Result<Self, RecordingError> {
        let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MAX_THREADS);
        Ok(Self {
            file: plan.source.open()?,
            plan: Arc::new(plan),
            segments: SegmentLoader::default(),
            spare: Vec::new(),
            threads,
            jobs: None,
            ahead: 0,
            ahead_bytes: 0,
            loading: VecDeque::new(),
        })
    }

    /// The plan that it loads from.
    pub(super) fn plan(&self) -> &Arc<Plan> {
        &self.plan
    }

    /// Size of the file.
    pub(super) fn file_bytes(&self) -> u64 {
        self.file.length()
    }

    /// The needed segment `number`. Numbers must ascend from call to call.
    pub(super) fn next(&mut self, number: usize) -> Result<LoadedSegment, RecordingError> {
        let plan = self.plan.clone();
        self.look_ahead(number);
        while let Some((ready, reply)) = self.loading.pop_front() {
            let bytes = plan.index.segments.get(ready).map_or(0, |segment| segment.unpacked_bytes);
            self.ahead_bytes = self.ahead_bytes.saturating_sub(bytes);
            if ready == number
                && let Ok(loaded) = reply.recv()
            {
                return loaded;
            }
        }
        self.load_now(number)
    }

    /// Loads segment `number` on this thread, for the first time or again.
    pub(super) fn load_now(&mut self, number: usize) -> Result<LoadedSegment, RecordingError> {
        let data = self.spare.pop().unwrap_or_default();
        match self.plan.index.segments.get(number) {
            Some(segment) => self.plan.load(segment, &mut self.file, &mut self.segments, data),
            None => Ok(LoadedSegment { data, entries: Vec::new(), damage: IssueLog::default() }),
        }
    }

    /// Takes back a buffer that is no longer needed.
    pub(super) fn recycle(&mut self, data: Vec<u8>) {
        if self.spare.len() < self.threads + 1 && data.capacity() as u64 <= MAX_AHEAD_BYTES / 8 {
            self.spare.push(data);
        }
    }

    /// Gives segments from `number` on to the threads, within the memory limit.
    fn look_ahead(&mut self, number: usize) {
        self.ahead = self.ahead.max(number);
        let plan = self.plan.clone();
        while self.loading.len() <= self.threads {
            let Some(segment) = plan.index.segments.get(self.ahead) else { return };
            if !plan.needs(segment) {
                self.ahead += 1;
                continue;
            }
            let fits = self.ahead_bytes.saturating_add(segment.unpacked_bytes) <= MAX_AHEAD_BYTES;
            // Uncompressed data are read as fast here as on another thread. The segment that is needed now is
            // not worth a thread if there is nothing else to load.
            if segment.compression == Compression::None
                || !fits
                || (self.ahead == number && self.is_last(number))
            {
                return;
            }
            let (reply, receiver) = sync_channel(1);
            let job = (self.ahead, self.spare.pop().unwrap_or_default(), reply);
            let jobs = self.jobs.get_or_insert_with(|| start_threads(&plan, self.threads));
            if jobs.send(job).is_err() {
                return;
            }
            self.loading.push_back((self.ahead, receiver));
            self.ahead_bytes += segment.unpacked_bytes;
            self.ahead += 1;
        }
    }

    fn is_last(&self, number: usize) -> bool {
        let later = self.plan.index.segments.iter().skip(number + 1);
        self.loading.is_empty() && !later.take(self.threads).any(|segment| self.plan.needs(segment))
    }
}

/// Starts threads that load segments until the sender is dropped. If a thread cannot open the file or panics,
/// the reader does its work.
fn start_threads(plan: &Arc<Plan>, threads: usize) -> Sender<Job> {
    let (sender, receiver) = channel::<Job>();
    let receiver = Arc::new(Mutex::new(receiver));
    for number in 0..threads {
        let (plan, receiver) = (plan.clone(), receiver.clone());
        let work = move || {
            let Ok(mut file) = plan.source.open() else { return };
            let mut loader = SegmentLoader::default();
            loop {
                let job = receiver.lock().unwrap_or_else(PoisonError::into_inner).recv();
                let Ok((number, data, reply)) = job else { return };
                if let Some(segment) = plan.index.segments.get(number) {
                    // Sending fails if the reader was dropped; then the result is not needed.
                    let _ = reply.send(plan.load(segment, &mut file, &mut loader, data));
                }
            }
        };
        // If no thread can be started, the reader does the work itself.
        let _ = std::thread::Builder::new().name(format!("recording-{number}")).spawn(work);
    }
    sender
}
