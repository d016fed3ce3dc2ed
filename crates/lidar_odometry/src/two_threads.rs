//! Runs two tasks in parallel, where that is worth waking a second thread.

/// Number of points below which the work is done before a second thread has woken.
const WORTHWHILE_POINTS: usize = 20_000;

/// Whether work on this number of points is worth another thread.
pub fn is_worth_a_thread(points: usize) -> bool {
    points >= WORTHWHILE_POINTS
}

/// Runs both tasks, on two threads if they process enough points. The results do not depend on it. The
/// first one runs here: a thread outside of the pool would hand both over and wait.
pub fn both<A, B: Default + Send>(
    points: usize,
    first: impl FnOnce() -> A,
    second: impl FnOnce() -> B + Send,
) -> (A, B) {
    if !is_worth_a_thread(points) {
        return (first(), second());
    }
    let mut of_second = B::default();
    let of_first = rayon::in_place_scope(|scope| {
        scope.spawn(|_| of_second = second());
        first()
    });
    (of_first, of_second)
}
