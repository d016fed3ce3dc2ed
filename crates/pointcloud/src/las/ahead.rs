//! Reads on a thread with a large stack. On damaged times of points the decompressor of the library recurses
//! once for every few bits of the file, and a stack overflow would abort the process. Reading therefore fails
//! well before.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use portolan_issue::Issue;

use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::format::CloudReader;

use super::{open_here, shallow};

/// Size of the stack of the thread, bytes. Only the used part takes memory.
const STACK: usize = 64 << 20;
/// Stack depth at which reading fails, bytes. Between two bytes of the file the decompressor uses far less
/// than the rest.
pub(super) const DEEPEST: usize = 24 << 20;

/// Messages of the thread.
enum ReaderMessage {
    /// The file is open: attributes and number of its points.
    Opened(Attributes, Option<u64>),
    /// A batch of points, empty at the end, and all issues so far.
    Points(PointCloud, Vec<Issue>),
    Failed(CloudError),
}

/// Reads a file on the thread.
struct LasPoints {
    path: PathBuf,
    attributes: Attributes,
    count: Option<u64>,
    messages: Receiver<ReaderMessage>,
    issues: Vec<Issue>,
}

/// Opens a LAS or LAZ file.
pub(crate) fn open(path: &Path) -> Result<Box<dyn CloudReader>, CloudError> {
    let (sender, messages) = sync_channel(1);
    let path = path.to_owned();
    let read = {
        let path = path.clone();
        move || {
            shallow::begin();
            let _ = read(&path, &sender);
        }
    };
    let thread = std::thread::Builder::new().name("las".to_owned()).stack_size(STACK).spawn(read);
    thread.map_err(|error| CloudError::read(&path, error))?;
    match messages.recv() {
        Ok(ReaderMessage::Opened(attributes, count)) => {
            Ok(Box::new(LasPoints { path, attributes, count, messages, issues: Vec::new() }))
        }
        Ok(ReaderMessage::Failed(error)) => Err(error),
        _ => Err(CloudError::damaged(&path, "it cannot be decoded")),
    }
}

/// Sends all points of a file; ends early if the receiver was dropped.
fn read(path: &Path, sender: &SyncSender<ReaderMessage>) -> Option<()> {
    let send = |message: ReaderMessage| sender.send(message).ok();
    let mut reader = match open_here(path) {
        Ok(reader) => reader,
        Err(error) => return send(ReaderMessage::Failed(error)),
    };
    send(ReaderMessage::Opened(reader.attributes(), reader.count()))?;
    loop {
        let mut batch = PointCloud::default();
        match reader.next_batch(&mut batch) {
            Ok(goes_on) => send(ReaderMessage::Points(batch, reader.issues())).filter(|()| goes_on)?,
            Err(error) => return send(ReaderMessage::Failed(error)),
        }
    }
}

impl CloudReader for LasPoints {
    fn attributes(&self) -> Attributes {
        self.attributes
    }

    fn count(&self) -> Option<u64> {
        self.count
    }

    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError> {
        batch.reset(self.attributes);
        match self.messages.recv() {
            Ok(ReaderMessage::Points(points, issues)) => {
                self.issues = issues;
                *batch = points;
                Ok(!batch.is_empty())
            }
            Ok(ReaderMessage::Failed(error)) => Err(error),
            _ => Err(CloudError::damaged(&self.path, "its points cannot be decoded")),
        }
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.clone()
    }
}
