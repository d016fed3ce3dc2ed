//! The mapper: measurements in, a map out.
//!
//! Local SLAM runs on the thread that calls [`Mapper::add`]; the pose graph runs behind it on a thread of its
//! own, with more threads for searching. The result does not depend on the number of threads: the pose graph
//! takes its work in the order in which local SLAM made it.

mod work;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

pub use work::MapperWork;

use portolan_config::{Options, TrajectoryBuilderOptions};
use portolan_geometry::{GeodeticPosition, Time};
use portolan_issue::IssueLog;
use portolan_motion::MotionFilter;
use portolan_numeric::LatencyHistogram;
use portolan_recall::Memory;
use portolan_sensor::{Measurement, SensorId};
use portolan_spool::Spool;

use crate::backend::{Backend, BackendProgress, MapperError};
use crate::collation::SensorCollation;
use crate::map::{Map, ScanPose};
use crate::stop::Stop;
use crate::{DegenerateInterval, InitialTrajectoryPose, PoseGraph, Space, TrajectoryId};
use portolan_local_slam::MatchingResult;

/// Settings of the mapper that do not concern the map.
#[derive(Clone, Copy, Debug)]
pub struct MapperSettings {
    /// Threads for searching and optimising; with one, everything runs on the thread of the caller.
    pub threads: usize,
    /// Work that may wait behind local SLAM before [`Mapper::add`] waits.
    pub max_backlog: usize,
    /// Maximum time that [`Mapper::add`] waits: for ever when reading a file, zero when live.
    pub max_wait: Duration,
}

impl Default for MapperSettings {
    fn default() -> Self {
        Self { threads: 2, max_backlog: 400, max_wait: Duration::from_secs(3600) }
    }
}

/// A trajectory being mapped.
struct ActiveTrajectory<S: Space> {
    options: TrajectoryBuilderOptions,
    sensors: BTreeSet<SensorId>,
    local_slam: S::LocalSlam,
    odometry_filter: Option<MotionFilter>,
    scans: Spool<ScanPose>,
    last_node: Option<u32>,
    next_node: u32,
    /// Its present trajectory in the pose graph: one for each piece of map.
    piece: TrajectoryId,
}

/// A loss of the pose of a trajectory: scans after it form a piece of map of their own, until a loop closure
/// ties it to the rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Time of the first scan that did not fit, or of the last one before a gap.
    pub since: Time,
    /// Time of the first scan of the new piece, or of the last one of all.
    pub until: Time,
    /// The trajectory of the new piece in the map; none if no scan fitted any more until the end.
    pub piece: Option<TrajectoryId>,
    /// Whether it is a gap without scans in which odometry measured the motion.
    pub is_gap: bool,
}

impl Loss {
    /// Whether the pose of a scan with this time is unknown: it fitted nowhere.
    pub fn leaves_open(&self, time: Time) -> bool {
        let is_before_end = time < self.until || self.piece.is_none();
        !self.is_gap && self.since <= time && is_before_end
    }
}

/// Builds a map of any number of trajectories.
pub struct Mapper<S: Space> {
    options: Options,
    settings: MapperSettings,
    backend: Backend<S>,
    collation: SensorCollation,
    active: BTreeMap<TrajectoryId, ActiveTrajectory<S>>,
    ended: BTreeMap<TrajectoryId, EndedTrajectory>,
    next_trajectory: u32,
    issues: IssueLog,
    scan_times: LatencyHistogram,
    degenerate_intervals: Vec<DegenerateInterval>,
    losses: Vec<Loss>,
    memory: Memory,
    stop: Stop,
    /// Folder for data that grow with time; none: they stay in memory.
    spool_folder: Option<PathBuf>,
}

/// Data of a trajectory that are kept for the map.
#[derive(Clone, Debug)]
pub struct EndedTrajectory {
    /// Its options.
    pub options: TrajectoryBuilderOptions,
    /// Its sensors.
    pub sensors: BTreeSet<SensorId>,
    /// Every scan.
    pub scans: Spool<ScanPose>,
    /// Origin of its fixed frame on the Earth, if that was measured: the first satellite fix.
    pub fixed_frame_on_earth: Option<GeodeticPosition>,
}

impl<S: Space> Mapper<S> {
    /// An empty map.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn new(options: &Options, settings: MapperSettings) -> Result<Self, MapperError> {
        let graph = PoseGraph::new(options.map_builder.pose_graph.clone());
        Self::with_graph(options, settings, graph, BTreeMap::new())
    }

    /// Continues a map: `graph` holds its trajectories, `ended` the other data of these.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn with_graph(
        options: &Options,
        settings: MapperSettings,
        graph: PoseGraph<S>,
        ended: BTreeMap<TrajectoryId, EndedTrajectory>,
    ) -> Result<Self, MapperError> {
        (S::mapper_work().with_graph)(options, settings, graph, ended)
    }

    /// Caches the results of matching, searching and optimising in this memory. To be called before anything
    /// is added.
    ///
    /// # Errors
    /// If the pose graph has stopped because of an internal fault.
    pub fn remember_with(&mut self, memory: &Memory) -> Result<(), MapperError> {
        (S::mapper_work().remember_with)(self, memory)
    }

    /// Keeps the poses of scans and of removed nodes in nameless files in this folder instead of memory. To
    /// be called before anything is added.
    ///
    /// # Errors
    /// If the pose graph has stopped because of an internal fault.
    pub fn spool_in(&mut self, folder: &Path) -> Result<(), MapperError> {
        (S::mapper_work().spool_in)(self, folder)
    }

    /// Starts a trajectory with these sensors.
    ///
    /// # Errors
    /// If options contradict each other, or the pose graph has stopped because of an internal fault.
    pub fn add_trajectory(
        &mut self,
        sensors: &BTreeSet<SensorId>,
        initial_pose: Option<InitialTrajectoryPose>,
    ) -> Result<TrajectoryId, MapperError> {
        (S::mapper_work().add_trajectory)(self, sensors, initial_pose)
    }

    /// Adds a measurement. Returns the results of scans, this one or earlier ones that waited for other
    /// sensors. Waits for the pose graph no longer than `max_wait` of the settings.
    ///
    /// # Errors
    /// If the trajectory does not exist or has ended, or the pose graph has stopped because of an internal fault.
    pub fn add(
        &mut self,
        id: TrajectoryId,
        sensor_id: &SensorId,
        measurement: Measurement,
    ) -> Result<Vec<MatchingResult<S>>, MapperError> {
        (S::mapper_work().add)(self, id, sensor_id, measurement)
    }

    /// Ends a trajectory: waiting measurements are used, its submaps are completed.
    ///
    /// # Errors
    /// If the trajectory does not exist or has ended, or the pose graph has stopped because of an internal fault.
    pub fn finish_trajectory(&mut self, id: TrajectoryId) -> Result<Vec<MatchingResult<S>>, MapperError> {
        (S::mapper_work().finish_trajectory)(self, id)
    }

    /// Times that local SLAM took for each scan that it matched.
    pub fn scan_times(&self) -> &LatencyHistogram {
        &self.scan_times
    }

    /// Intervals in which scans of ended trajectories had degenerate directions.
    pub fn degenerate_intervals(&self) -> &[DegenerateInterval] {
        &self.degenerate_intervals
    }

    /// Losses of pose, in order of time.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// Progress of the pose graph.
    pub fn progress(&self) -> BackendProgress {
        self.backend.progress()
    }

    /// Runs work on the pose graph after everything enqueued so far; waits for the result.
    ///
    /// # Errors
    /// If the pose graph has stopped because of an internal fault.
    pub fn with_pose_graph<R: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut PoseGraph<S>) -> R + Send + 'static,
    ) -> Result<R, MapperError> {
        self.backend.call(work)
    }

    /// As [`Self::with_pose_graph`], without waiting.
    ///
    /// # Errors
    /// If the pose graph has stopped because of an internal fault.
    pub fn enqueue_pose_graph_work(
        &mut self,
        work: impl FnOnce(&mut PoseGraph<S>) + Send + 'static,
    ) -> Result<(), MapperError> {
        self.backend.enqueue(work)
    }

    /// Issues: data dropped or repaired in ended trajectories and in ordering the sensors.
    pub fn issues(&self) -> IssueLog {
        (S::mapper_work().issues)(self)
    }

    /// Finishes with the map as it is: from now on nothing is searched any more, and the map is optimised
    /// only once, at the end.
    pub fn stop(&self) {
        self.stop.request();
    }

    /// Ends all trajectories, runs the final optimisation, and returns the map.
    ///
    /// # Errors
    /// If the pose graph has stopped because of an internal fault.
    pub fn finish(self) -> Result<(Map<S>, IssueLog), MapperError> {
        self.finish_while(&mut |_| true)
    }

    /// As [`Self::finish`]; `continues` receives the progress now and then; if it returns false, the effect
    /// is that of [`Self::stop`].
    ///
    /// # Errors
    /// As for [`Self::finish`].
    pub fn finish_while(
        self,
        continues: &mut dyn FnMut(BackendProgress) -> bool,
    ) -> Result<(Map<S>, IssueLog), MapperError> {
        (S::mapper_work().finish_while)(self, continues)
    }
}
