//! A disk that fails when a test wants it to. Nothing of this is in the program.

mod everywhere;

use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};

pub use everywhere::{Failure, Run, fail_at_every, fail_everywhere};

/// How a disk fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No space is left, from this operation on; what is there can be read.
    Full,
    /// The device is broken, from this operation on.
    Broken,
    /// The device fails this operation alone.
    BrokenOnce,
    /// Each operation from this one on is interrupted by a signal first, and takes one byte then.
    InterruptedAndShort,
}

#[derive(Clone, Copy)]
struct Plan {
    fault: Fault,
    /// Number of the first operation that fails.
    at: u64,
    /// Operations so far.
    seen: u64,
}

static PLAN: Mutex<Option<Plan>> = Mutex::new(None);

/// The disk of the process, for one test at a time: to be held from the first file on that a test writes.
pub fn whole_disk() -> MutexGuard<'static, ()> {
    static DISK: Mutex<()> = Mutex::new(());
    DISK.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Lets the disk of the whole process fail at the `at`-th operation, from 0: a file is made, written, read, made durable or
/// named.
pub fn fail_at(at: u64, fault: Fault) {
    *PLAN.lock().unwrap_or_else(PoisonError::into_inner) = Some(Plan { fault, at, seen: 0 });
}

/// Mends the disk; returns how many operations there were since it was to fail.
pub fn mend() -> u64 {
    PLAN.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(0, |plan| plan.seen)
}

/// Whether the disk fails now or is going to.
pub(crate) fn is_planned() -> bool {
    PLAN.lock().unwrap_or_else(PoisonError::into_inner).is_some()
}

/// What of these bytes may be written.
pub(crate) fn before_write(bytes: &[u8]) -> io::Result<&[u8]> {
    let taken = taken(bytes.len(), false)?;
    Ok(bytes.get(..taken).unwrap_or(bytes))
}

/// What of these bytes may be filled by reading.
pub(crate) fn before_read(bytes: &mut [u8]) -> io::Result<&mut [u8]> {
    let taken = taken(bytes.len(), true)?;
    Ok(bytes.get_mut(..taken).unwrap_or_default())
}

/// How many of so many bytes the next operation takes.
fn taken(length: usize, is_read: bool) -> io::Result<usize> {
    const ENOSPC: i32 = 28;
    const EIO: i32 = 5;
    let mut guard = PLAN.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(plan) = guard.as_mut() else { return Ok(length) };
    let number = plan.seen;
    plan.seen += 1;
    match plan.fault {
        _ if number < plan.at => Ok(length),
        Fault::Full if is_read => Ok(length),
        Fault::Full => Err(io::Error::from_raw_os_error(ENOSPC)),
        Fault::Broken => Err(io::Error::from_raw_os_error(EIO)),
        Fault::BrokenOnce if number == plan.at => Err(io::Error::from_raw_os_error(EIO)),
        Fault::BrokenOnce => Ok(length),
        // What is asked for without bytes is not tried again.
        Fault::InterruptedAndShort if length == 0 => Ok(0),
        Fault::InterruptedAndShort if number.is_multiple_of(2) => Err(io::ErrorKind::Interrupted.into()),
        Fault::InterruptedAndShort => Ok(1),
    }
}
