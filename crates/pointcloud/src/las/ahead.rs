//! Reading on a thread with much stack: on damaged times of points the decompressor of the library calls itself once for
//! every few bits of the file, and a stack that overflows ends the process. So reading fails well before that.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use portolan_issue::Issue;

use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::format::CloudReader;

use super::{open_here, shallow};

/// Only what is used of it is ever taken.
const STACK: usize = 64 << 20;
/// Reading fails when so much of it is used. Between two bytes of the file the decompressor takes far less than the rest.
pub(super) const DEEPEST: usize = 24 << 20;

/// What the thread sends.
enum ReaderMessage {
    /// The file is open: what its points have, and how many there are.
    Opened(Attributes, Option<u64>),
    /// Points, none at the end, and all issues so far.
    Points(PointCloud, Vec<Issue>),
    Failed(CloudError),
}

/// A file that is read on the thread.
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

/// Sends everything of a file; ends early when nobody listens any more.
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
