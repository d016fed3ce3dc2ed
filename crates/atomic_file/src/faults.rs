//! A disk that fails when a test wants it to. Nothing of this is in the program.

use std::io;
use std::sync::{Mutex, PoisonError};

/// How a disk fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No space is left, from this operation on.
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

/// Lets the disk of the whole process fail at the `at`-th write, from 0.
pub fn fail_at(at: u64, fault: Fault) {
    *PLAN.lock().unwrap_or_else(PoisonError::into_inner) = Some(Plan { fault, at, seen: 0 });
}

/// Mends the disk; returns how many operations there were since it was to fail.
pub fn mend() -> u64 {
    PLAN.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(0, |plan| plan.seen)
}

/// What of these bytes may be written.
pub(crate) fn before_write(bytes: &[u8]) -> io::Result<&[u8]> {
    const ENOSPC: i32 = 28;
    const EIO: i32 = 5;
    let mut guard = PLAN.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(plan) = guard.as_mut() else { return Ok(bytes) };
    let number = plan.seen;
    plan.seen += 1;
    match plan.fault {
        _ if number < plan.at => Ok(bytes),
        Fault::Full => Err(io::Error::from_raw_os_error(ENOSPC)),
        Fault::Broken => Err(io::Error::from_raw_os_error(EIO)),
        Fault::BrokenOnce if number == plan.at => Err(io::Error::from_raw_os_error(EIO)),
        Fault::BrokenOnce => Ok(bytes),
        // What is asked for without bytes is no write: it is not tried again.
        Fault::InterruptedAndShort if bytes.is_empty() => Ok(bytes),
        Fault::InterruptedAndShort if number.is_multiple_of(2) => Err(io::ErrorKind::Interrupted.into()),
        Fault::InterruptedAndShort => Ok(bytes.get(..1).unwrap_or(bytes)),
    }
}
