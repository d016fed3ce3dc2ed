//! Values that are changed in the background; access to a value waits until it has been changed.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

type Work<T> = Box<dyn FnOnce(&mut T) + Send>;

/// A value, and at most one pending change for an idle thread. The first access makes the change if no
/// thread has, so that results depend neither on threads nor on time, and no thread waits for another that
/// may never run.
pub struct Later<T> {
    shared: Arc<Shared<T>>,
}

struct Shared<T> {
    value: Mutex<T>,
    /// Taken only by the thread that holds the value.
    work: Mutex<Option<Work<T>>>,
}

impl<T: Send + 'static> Later<T> {
    /// A value without pending change.
    pub fn new(value: T) -> Self {
        Self { shared: Arc::new(Shared { value: Mutex::new(value), work: Mutex::new(None) }) }
    }

    /// The value after all changes. (Release the guard before the next access.)
    pub fn now(&self) -> MutexGuard<'_, T> {
        let mut value = held(&self.shared.value);
        self.shared.change(&mut value);
        value
    }

    /// Lets another thread change the value, once the previous change is made.
    pub fn change(&self, work: impl FnOnce(&mut T) + Send + 'static) {
        rayon::spawn(self.leave(work));
    }

    /// Leaves a change of the value, once the previous change is made, to the caller of the returned
    /// function.
    pub fn leave(&self, work: impl FnOnce(&mut T) + Send + 'static) -> Box<dyn FnOnce() + Send> {
        let value = self.now();
        *held(&self.shared.work) = Some(Box::new(work));
        drop(value);
        let shared = Arc::clone(&self.shared);
        Box::new(move || {
            // A locked value is being changed by a thread that needs it.
            if let Ok(mut value) = shared.value.try_lock() {
                shared.change(&mut value);
            }
        })
    }
}

impl<T> Shared<T> {
    fn change(&self, value: &mut T) {
        let work = held(&self.work).take();
        if let Some(work) = work {
            work(value);
        }
    }
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<T: Clone + Send + 'static> Clone for Later<T> {
    fn clone(&self) -> Self {
        Self::new(self.now().clone())
    }
}

impl<T: fmt::Debug + Send + 'static> fmt::Debug for Later<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Later").field(&*self.now()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_applied_in_order() {
        let (later, mut expected) = (Later::new(Vec::new()), Vec::new());
        for i in 0..1000 {
            later.change(move |all: &mut Vec<i32>| all.push(i));
            expected.push(i);
            if i % 7 == 0 {
                assert_eq!(*later.now(), expected);
            }
        }
        let copy = later.clone();
        later.change(|all| all.clear());
        assert_eq!(*copy.now(), expected);
        assert!(later.now().is_empty());
    }

    #[test]
    fn changes_are_applied_while_the_thread_pool_is_busy() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let sum = pool.install(|| {
            let later = Later::new(0);
            (0..100).for_each(|i| later.change(move |sum| *sum += i));
            *later.now()
        });
        assert_eq!(sum, 4950);
    }
}
