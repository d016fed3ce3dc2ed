//! Two pieces of work side by side, where that is worth waking a second thread.

/// Fewer points are done with before a second thread has woken.
const WORTHWHILE_POINTS: usize = 20_000;

/// Does both, on two threads if they are about many points. What comes out does not depend on it.
pub fn both<A: Send, B: Send>(
    points: usize,
    first: impl FnOnce() -> A + Send,
    second: impl FnOnce() -> B + Send,
) -> (A, B) {
    if points < WORTHWHILE_POINTS { (first(), second()) } else { rayon::join(first, second) }
}
