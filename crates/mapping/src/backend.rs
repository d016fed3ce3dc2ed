//! Runs the pose graph behind the mapper, in the order in which work was enqueued.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam::channel::{Sender, bounded, unbounded};
use rayon::ThreadPool;

use portolan_local_slam::LocalSlamError;
use portolan_optimization::OptimizationSummary;

use crate::{PoseGraph, SearchCounts, Space};

/// Error that ends mapping.
#[derive(Debug, thiserror::Error)]
pub enum MapperError {
    /// Threads could not be started.
    #[error("cannot start threads for mapping: {0}")]
    Threads(String),
    /// The pose graph has stopped because of an internal fault.
    #[error("the pose graph has stopped because of an internal fault; please report it with the recording")]
    PoseGraphStopped,
    /// Options that contradict each other.
    #[error(transparent)]
    Options(#[from] LocalSlamError),
    /// A trajectory that does not exist or has ended.
    #[error("trajectory {0} does not exist or has ended")]
    NoSuchTrajectory(crate::TrajectoryId),
}

/// Progress of the pose graph.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BackendProgress {
    /// Nodes in the graph.
    pub nodes: usize,
    /// Submaps in the graph.
    pub submaps: usize,
    /// Constraints in the graph.
    pub constraints: usize,
    /// Loop closures among them that were found in this run.
    pub searches: SearchCounts,
    /// Optimisations so far.
    pub optimizations: u64,
    /// Result of the last one.
    pub last_optimization: OptimizationSummary,
    /// Number of waiting tasks.
    pub backlog: usize,
}

type Work<S> = Box<dyn FnOnce(&mut PoseGraph<S>) + Send>;

struct Shared {
    backlog: AtomicUsize,
    progress: Mutex<BackendProgress>,
}

/// Interval at which a caller that waits for the end gets the progress.
const WATCH: Duration = Duration::from_millis(20);

impl Shared {
    fn progress(&self) -> BackendProgress {
        let mut progress = *self.progress.lock().unwrap_or_else(PoisonError::into_inner);
        progress.backlog = self.backlog.load(Ordering::Acquire);
        progress
    }

    /// Waits for the end.
    fn watch(&self, is_finished: impl Fn() -> bool, watch: &mut dyn FnMut(BackendProgress)) {
        while !is_finished() {
            watch(self.progress());
            std::thread::sleep(WATCH);
        }
    }
}

/// Runs the pose graph: inline with one thread, else on a thread of its own.
pub struct Backend<S: Space> {
    place: Place<S>,
    shared: Arc<Shared>,
    /// Small tasks that run with the next one enqueued.
    along: Vec<Work<S>>,
}

/// Maximum number of small tasks that wait for the next one: an IMU brings hundreds a second, and waking a
/// thread for each would take longer than the work.
const MAX_ALONG: usize = 256;

enum Place<S: Space> {
    Inline { graph: Box<PoseGraph<S>>, pool: ThreadPool },
    Thread { sender: Option<Sender<Work<S>>>, handle: Option<JoinHandle<PoseGraph<S>>> },
}

impl<S: Space> Backend<S> {
    /// Moves the graph to the thread on which it will run. `threads` is the number used for searching.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn start(graph: PoseGraph<S>, threads: usize) -> Result<Self, MapperError> {
        let threads = threads.max(1);
        let pool = move || {
            rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("search-{i}"))
        };
        let shared = Arc::new(Shared {
            backlog: AtomicUsize::new(0),
            progress: Mutex::new(BackendProgress::default()),
        });
        if threads == 1 {
            let pool = pool().build().map_err(|e| failed_to_start(&e))?;
            return Ok(Self {
                place: Place::Inline { graph: Box::new(graph), pool },
                shared,
                along: Vec::new(),
            });
        }
        let (sender, receiver) = unbounded::<Work<S>>();
        let (started, has_started) = bounded(1);
        let worker_shared = Arc::clone(&shared);
        let handle = std::thread::Builder::new()
            .name("pose-graph".to_owned())
            .spawn(move || {
                // This is also one of the threads for searching: waking another one for each node takes
                // longer than its work.
                let pool = pool().use_current_thread().build();
                let _ = started.send(pool.as_ref().map(|_| ()).map_err(failed_to_start));
                let Ok(pool) = pool else { return graph };
                let mut graph = graph;
                for work in receiver {
                    pool.install(|| work(&mut graph));
                    worker_shared.backlog.fetch_sub(1, Ordering::AcqRel);
                    publish(&worker_shared, &graph);
                }
                graph
            })
            .map_err(|e| MapperError::Threads(e.to_string()))?;
        has_started.recv().map_err(|_| MapperError::PoseGraphStopped)??;
        let place = Place::Thread { sender: Some(sender), handle: Some(handle) };
        Ok(Self { place, shared, along: Vec::new() })
    }

    /// Enqueues work; it is done later, in order.
    ///
    /// # Errors
    /// If the pose graph has stopped because of an internal fault.
    pub fn enqueue(
        &mut self,
        work: impl FnOnce(&mut PoseGraph<S>) + Send + 'static,
    ) -> Result<(), MapperError> {
        self.enqueue_boxed(Box::new(work))
    }

    fn enqueue_boxed(&mut self, work: Work<S>) -> Result<(), MapperError> {
        match &mut self.place {
            Place::Inline { graph, pool } => {
                pool.install(|| work(graph));
                publish(&self.shared, graph);
                Ok(())
            }
            Place::Thread { sender, .. } => {
                let along = std::mem::take(&mut self.along);
                let work = move |graph: &mut PoseGraph<S>| {
                    along.into_iter().for_each(|earlier| earlier(graph));
                    work(graph);
                };
                self.shared.backlog.fetch_add(1, Ordering::AcqRel);
                let sent = sender.as_ref().is_some_and(|s| s.send(Box::new(work)).is_ok());
                if sent { Ok(()) } else { Err(MapperError::PoseGraphStopped) }
            }
        }
    }

    /// Enqueues work of microseconds; it is done in order, with the next work that is enqueued.
    ///
    /// # Errors
    /// As for [`Self::enqueue`].
    pub fn enqueue_along(
        &mut self,
        work: impl FnOnce(&mut PoseGraph<S>) + Send + 'static,
    ) -> Result<(), MapperError> {
        match &mut self.place {
            Place::Inline { graph, .. } => work(graph),
            Place::Thread { .. } => self.along.push(Box::new(work)),
        }
        if self.along.len() >= MAX_ALONG { self.enqueue(|_| {}) } else { Ok(()) }
    }

    /// Runs work after everything enqueued before, and waits for its result.
    ///
    /// # Errors
    /// As for [`Self::enqueue`].
    pub fn call<R: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut PoseGraph<S>) -> R + Send + 'static,
    ) -> Result<R, MapperError> {
        let (sender, receiver) = bounded(1);
        self.enqueue(move |graph| {
            // Sending fails only when the caller is gone.
            let _ = sender.send(work(graph));
        })?;
        receiver.recv().map_err(|_| MapperError::PoseGraphStopped)
    }

    /// Waits until at most `limit` tasks are waiting, or `longest` has passed.
    pub fn wait_for_backlog(&self, limit: usize, longest: Duration) {
        let start = Instant::now();
        while self.shared.backlog.load(Ordering::Acquire) > limit && start.elapsed() < longest {
            if let Place::Thread { handle: Some(handle), .. } = &self.place
                && handle.is_finished()
            {
                return;
            }
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    /// Progress.
    pub fn progress(&self) -> BackendProgress {
        self.shared.progress()
    }

    /// Finishes all work, with `last` at the end, and returns the graph. Meanwhile `watch` is called now and
    /// then.
    ///
    /// # Errors
    /// If the pose graph has stopped because of an internal fault.
    pub fn finish(
        mut self,
        last: impl FnOnce(&mut PoseGraph<S>) + Send + 'static,
        watch: &mut dyn FnMut(BackendProgress),
    ) -> Result<PoseGraph<S>, MapperError> {
        if matches!(self.place, Place::Thread { .. }) {
            self.enqueue(last)?;
            let shared = Arc::clone(&self.shared);
            let Place::Thread { sender, handle: Some(handle) } = self.place else {
                return Err(MapperError::PoseGraphStopped);
            };
            drop(sender);
            shared.watch(|| handle.is_finished(), watch);
            return handle.join().map_err(|_| MapperError::PoseGraphStopped);
        }
        let Place::Inline { mut graph, pool } = self.place else { return Err(MapperError::PoseGraphStopped) };
        std::thread::scope(|scope| {
            let worker = scope.spawn(|| pool.install(|| last(&mut graph)));
            self.shared.watch(|| worker.is_finished(), watch);
            worker.join().map_err(|_| MapperError::PoseGraphStopped)
        })?;
        Ok(*graph)
    }
}

fn failed_to_start(error: &rayon::ThreadPoolBuildError) -> MapperError {
    MapperError::Threads(error.to_string())
}

fn publish<S: Space>(shared: &Shared, graph: &PoseGraph<S>) {
    let (optimizations, last_optimization) = graph.optimizations();
    let progress = BackendProgress {
        nodes: graph.state().nodes.len(),
        submaps: graph.state().submaps.len(),
        constraints: graph.state().constraints.len(),
        searches: graph.search_counts(),
        optimizations,
        last_optimization,
        backlog: 0,
    };
    *shared.progress.lock().unwrap_or_else(PoisonError::into_inner) = progress;
}

#[cfg(test)]
mod tests {
    use portolan_config::Options;

    use super::*;
    use crate::Space2d;

    #[test]
    fn progress_is_reported_while_waiting_for_the_end() {
        for threads in [1, 2] {
            let graph = PoseGraph::<Space2d>::new(Options::for_2d().map_builder.pose_graph);
            let backend = Backend::start(graph, threads).unwrap();
            // The last work ends only after that.
            let (sender, receiver) = unbounded();
            let last =
                move |_: &mut PoseGraph<Space2d>| receiver.recv_timeout(Duration::from_secs(60)).unwrap();
            backend.finish(last, &mut |_| sender.send(()).unwrap_or_default()).unwrap();
        }
    }
}
