//! Runs jobs on other cores and returns their results in the order in which the jobs were added.

use std::collections::VecDeque;
use std::mem;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

/// A queue of jobs. Free threads of the rayon pool take jobs. A caller that asks for a result whose job has
/// not been started does the job itself. So there is no deadlock when the pool is busy or the caller is one
/// of its threads, and the results do not depend on the number of threads.
pub struct OrderedWorkers<I, O> {
    jobs: VecDeque<Arc<Job<I, O>>>,
    work: Arc<dyn Fn(I) -> O + Send + Sync>,
}

struct Job<I, O> {
    state: Mutex<State<I, O>>,
    finished: Condvar,
}

enum State<I, O> {
    Waiting(I),
    Running,
    Done(O),
    Taken,
}

impl<I: Send + 'static, O: Send + 'static> OrderedWorkers<I, O> {
    /// Workers that turn inputs into outputs with `work`.
    pub fn new(work: impl Fn(I) -> O + Send + Sync + 'static) -> Self {
        Self { jobs: VecDeque::new(), work: Arc::new(work) }
    }

    /// Adds a job. The caller bounds the number of jobs in flight.
    pub fn push(&mut self, input: I) {
        let job = Arc::new(Job { state: Mutex::new(State::Waiting(input)), finished: Condvar::new() });
        self.jobs.push_back(Arc::clone(&job));
        let work = Arc::clone(&self.work);
        rayon::spawn(move || job.run(&*work));
    }

    /// Number of jobs whose results were not taken yet.
    pub fn len(&self) -> usize {
        self.jobs.len()
    }

    /// The result of the oldest job; waits for the job or does it.
    pub fn pop(&mut self) -> Option<O> {
        let job = self.jobs.pop_front()?;
        job.run(&*self.work);
        let mut state = job.lock();
        loop {
            match mem::replace(&mut *state, State::Taken) {
                State::Done(output) => return Some(output),
                other => *state = other,
            }
            state = job.finished.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl<I, O> Job<I, O> {
    fn lock(&self) -> MutexGuard<'_, State<I, O>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does the job unless another thread has started it.
    fn run(&self, work: &(dyn Fn(I) -> O + Send + Sync)) {
        let input = {
            let mut state = self.lock();
            match mem::replace(&mut *state, State::Running) {
                State::Waiting(input) => input,
                other => {
                    *state = other;
                    return;
                }
            }
        };
        let output = work(input);
        *self.lock() = State::Done(output);
        self.finished.notify_all();
    }
}

impl<I, O> Drop for OrderedWorkers<I, O> {
    /// Jobs that were not started are cancelled.
    fn drop(&mut self) {
        for job in &self.jobs {
            let mut state = job.lock();
            if matches!(*state, State::Waiting(_)) {
                *state = State::Taken;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_on_any_pool() {
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let squares: Vec<u64> = pool.install(|| {
                let mut workers = OrderedWorkers::new(|i: u64| i * i);
                (0..100).for_each(|i| workers.push(i));
                std::iter::from_fn(|| workers.pop()).collect()
            });
            assert_eq!(squares, (0..100).map(|i| i * i).collect::<Vec<_>>());
        }
    }

    #[test]
    fn unfinished_work_is_dropped() {
        let mut workers = OrderedWorkers::new(|i: u64| i);
        (0..1000).for_each(|i| workers.push(i));
        assert_eq!(workers.pop(), Some(0));
        drop(workers);
    }
}
