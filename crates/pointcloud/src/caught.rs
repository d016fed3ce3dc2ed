//! Catches panics of libraries on damaged files.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

thread_local! {
    static CATCHING: Cell<bool> = const { Cell::new(false) };
}

/// Whether a panic of this thread would be caught and reported as damage of a file, so that the panic hook of
/// a program need not print it.
pub fn is_panic_caught() -> bool {
    CATCHING.get()
}

/// Result of a call; none if it panics.
pub(crate) fn unpanicked<T>(call: impl FnOnce() -> T) -> Option<T> {
    let before = CATCHING.replace(true);
    let result = catch_unwind(AssertUnwindSafe(call));
    CATCHING.set(before);
    result.ok()
}
