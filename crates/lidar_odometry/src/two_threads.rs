//! Two pieces of work side by side, where that is worth waking a second thread.

/// Fewer points are done with before a second thread has woken.
const WORTHWHILE_POINTS: usize = 20_000;

/// Whether work on so many points is worth another thread.
pub fn is_worth_a_thread(points: usize) -> bool {
    points >= WORTHWHILE_POINTS
}

/// Does both, on two threads if they are about many points. What comes out does not depend on it. The first is done here: a
/// thread outside of the pool would hand both over and wait.
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
