//! Injects faults of the disk in tests. It is not compiled into the program.

mod everywhere;

use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};

pub use everywhere::{Failure, Run, fail_at_every, fail_everywhere};

/// Kind of fault of the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No space is left from this operation on; reading still works.
    Full,
    /// Every operation from this one on fails with an I/O error.
    Broken,
    /// Only this operation fails with an I/O error.
    BrokenOnce,
    /// From this operation on, each read or write is first interrupted by a signal and then transfers a single byte.
    InterruptedAndShort,
}

#[derive(Clone, Copy)]
struct Plan {
    fault: Fault,
    /// Number of the first operation that fails.
    at: u64,
    /// Number of operations so far.
    seen: u64,
}

static PLAN: Mutex<Option<Plan>> = Mutex::new(None);

/// Lock on the disk of the process, for one test at a time. A test must hold it from the first file that it writes.
pub fn whole_disk() -> MutexGuard<'static, ()> {
    static DISK: Mutex<()> = Mutex::new(());
    DISK.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Lets the disk of the whole process fail at the `at`-th operation, counted from 0. Operations are creating, writing,
/// reading, truncating, synchronising and renaming a file.
pub fn fail_at(at: u64, fault: Fault) {
    *PLAN.lock().unwrap_or_else(PoisonError::into_inner) = Some(Plan { fault, at, seen: 0 });
}

/// Ends the fault; returns the number of operations since [`fail_at`].
pub fn mend() -> u64 {
    PLAN.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(0, |plan| plan.seen)
}

/// Whether a fault is planned or active.
pub(crate) fn is_planned() -> bool {
    PLAN.lock().unwrap_or_else(PoisonError::into_inner).is_some()
}

/// The part of these bytes that may be written.
pub(crate) fn before_write(bytes: &[u8]) -> io::Result<&[u8]> {
    let taken = taken(bytes.len(), false)?;
    Ok(bytes.get(..taken).unwrap_or(bytes))
}

/// The part of this buffer that may be filled by reading.
pub(crate) fn before_read(bytes: &mut [u8]) -> io::Result<&mut [u8]> {
    let taken = taken(bytes.len(), true)?;
    Ok(bytes.get_mut(..taken).unwrap_or_default())
}

/// Number of bytes, out of `length`, that the next operation transfers.
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
        // An operation without bytes (create, synchronise, rename) is not retried by its caller.
        Fault::InterruptedAndShort if length == 0 => Ok(0),
        Fault::InterruptedAndShort if number.is_multiple_of(2) => Err(io::ErrorKind::Interrupted.into()),
        Fault::InterruptedAndShort => Ok(1),
    }
}
