//! The mapper: measurements in, a map out.
//!
//! Local SLAM runs where [`Mapper::add`] is called; the pose graph runs behind it on a thread of its
//! own, with more threads for searching. What comes out does not depend on how many there are: the
//! pose graph takes its work in the order in which local SLAM made it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use portolan_config::{Options, TrajectoryBuilderOptions};
use portolan_geometry::{GeodeticPosition, Time};
use portolan_issue::IssueLog;
use portolan_motion::MotionFilter;
use portolan_numeric::LatencyHistogram;
use portolan_recall::Memory;
use portolan_sensor::{Measurement, SensorId, SensorKind};
use portolan_spool::Spool;

use crate::backend::{Backend, BackendProgress, MapperError};
use crate::collation::SensorCollation;
use crate::local_slam::motion_filter;
use crate::local_slam::{LocalSlam, Lost, MatchingResult};
use crate::map::{Map, ScanPose};
use crate::stop::Stop;
use crate::{
    DegenerateInterval, InitialTrajectoryPose, PoseGraph, PoseGraphPolicy, Space, TrajectoryId, Trimmer,
};

/// How the mapper works, apart from what it maps.
#[derive(Clone, Copy, Debug)]
pub struct MapperSettings {
    /// Threads for searching and optimising; with one everything happens where it is called.
    pub threads: usize,
    /// Work that may wait behind local SLAM before [`Mapper::add`] waits.
    pub max_backlog: usize,
    /// How long [`Mapper::add`] may wait: for ever when reading a file, zero when live.
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
    /// What it is in the pose graph now: a trajectory of its own for each piece of map.
    piece: TrajectoryId,
}

/// A time from which on a trajectory was lost: what came later is a piece of map of its own, until a loop closure
/// ties it to the rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Time of the first scan that did not fit any more, or of the last one before a gap.
    pub since: Time,
    /// Time of the first scan of the new piece.
    pub until: Time,
    /// The trajectory that the new piece is in the map.
    pub piece: TrajectoryId,
    /// It is a gap without scans in which odometry measured the motion.
    pub is_gap: bool,
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
    /// Where what grows with time waits; in memory if there is no such folder.
    spool_folder: Option<PathBuf>,
}

/// What stays of a trajectory for the map.
#[derive(Clone, Debug)]
pub struct EndedTrajectory {
    /// Its options.
    pub options: TrajectoryBuilderOptions,
    /// Its sensors.
    pub sensors: BTreeSet<SensorId>,
    /// Every scan.
    pub scans: Spool<ScanPose>,
    /// Where on the Earth its fixed frame begins, if that was measured: the first satellite fix.
    pub fixed_frame_on_earth: Option<GeodeticPosition>,
}

impl<S: Space> Mapper<S> {
    /// An empty map.
    pub fn new(options: &Options, settings: MapperSettings) -> Result<Self, MapperError> {
        let graph = PoseGraph::new(options.map_builder.pose_graph.clone());
        Self::with_graph(options, settings, graph, BTreeMap::new())
    }

    /// Continues a map: `graph` holds its trajectories, `ended` what else is known of them.
    pub fn with_graph(
        options: &Options,
        settings: MapperSettings,
        graph: PoseGraph<S>,
        ended: BTreeMap<TrajectoryId, EndedTrajectory>,
    ) -> Result<Self, MapperError> {
        let mut graph = graph;
        graph.set_policy(PoseGraphPolicy::new(&options.portolan));
        graph.complete_loaded_submaps(options);
        let next_trajectory = graph.state().trajectories.keys().last().map_or(0, |id| id.0 + 1);
        Ok(Self {
            stop: graph.stop().clone(),
            backend: Backend::start(graph, settings.threads)?,
            collation: SensorCollation::new(options.map_builder.collate_by_trajectory),
            options: options.clone(),
            settings,
            active: BTreeMap::new(),
            ended,
            next_trajectory,
            issues: IssueLog::default(),
            scan_times: LatencyHistogram::default(),
            degenerate_intervals: Vec::new(),
            losses: Vec::new(),
            memory: Memory::default(),
            spool_folder: None,
        })
    }

    /// Remembers what was matched, searched and optimised with this. To be called before anything is added.
    pub fn remember_with(&mut self, memory: &Memory) -> Result<(), MapperError> {
        self.memory = memory.clone();
        let memory = memory.clone();
        self.backend.enqueue(move |graph| graph.remember_with(memory))
    }

    /// Lets the poses of scans, and what stays of removed nodes, wait in nameless files in this folder instead of memory. To be
    /// called before anything is added.
    pub fn spool_in(&mut self, folder: &Path) -> Result<(), MapperError> {
        self.spool_folder = Some(folder.to_owned());
        let folder = folder.to_owned();
        self.backend.enqueue(move |graph| graph.spool_in(&folder))
    }

    fn scan_poses(&self) -> Spool<ScanPose> {
        self.spool_folder.as_deref().map_or_else(Spool::default, Spool::in_folder)
    }

    /// Starts a trajectory with these sensors.
    pub fn add_trajectory(
        &mut self,
        sensors: &BTreeSet<SensorId>,
        initial_pose: Option<InitialTrajectoryPose>,
    ) -> Result<TrajectoryId, MapperError> {
        let id = TrajectoryId(self.next_trajectory);
        self.next_trajectory += 1;
        let options = self.options.trajectory_builder.clone();
        let range_sensors: Vec<SensorId> =
            sensors.iter().filter(|s| s.kind == SensorKind::Range).cloned().collect();
        let mut local_slam = S::new_local_slam(&self.options, &range_sensors)?;
        local_slam.remember_with(&self.memory);
        let trajectory = ActiveTrajectory {
            local_slam,
            odometry_filter: options.pose_graph_odometry_motion_filter.as_ref().map(motion_filter),
            sensors: sensors.clone(),
            scans: self.scan_poses(),
            last_node: None,
            next_node: 0,
            piece: id,
            options,
        };
        self.collation.add_trajectory(id, sensors, &trajectory.options);
        let keep = trajectory.options.pure_localization_trimmer.as_ref().map(|t| t.max_submaps_to_keep);
        self.active.insert(id, trajectory);
        self.backend.enqueue(move |graph| {
            graph.add_trajectory(id, initial_pose);
            if let Some(keep) = keep {
                graph.add_trimmer(Trimmer::pure_localization(id, keep));
            }
        })?;
        Ok(id)
    }

    /// Takes a measurement. Returns what became of scans, this one or earlier ones that waited for
    /// other sensors. Waits for the pose graph no longer than the settings say.
    pub fn add(
        &mut self,
        id: TrajectoryId,
        sensor_id: &SensorId,
        measurement: Measurement,
    ) -> Result<Vec<MatchingResult<S>>, MapperError> {
        if !self.active.contains_key(&id) {
            return Err(MapperError::NoSuchTrajectory(id));
        }
        let ready = self.collation.add(id, sensor_id, measurement);
        let results = self.dispatch_all(ready)?;
        self.backend.wait_for_backlog(self.settings.max_backlog, self.settings.max_wait);
        Ok(results)
    }

    fn dispatch_all(
        &mut self,
        ready: Vec<(TrajectoryId, SensorId, Measurement)>,
    ) -> Result<Vec<MatchingResult<S>>, MapperError> {
        let mut results = Vec::new();
        for (id, sensor_id, measurement) in ready {
            results.extend(self.dispatch(id, &sensor_id, measurement)?);
        }
        Ok(results)
    }

    /// Gives a measurement, in its turn, to local SLAM and to the pose graph.
    fn dispatch(
        &mut self,
        id: TrajectoryId,
        sensor_id: &SensorId,
        measurement: Measurement,
    ) -> Result<Vec<MatchingResult<S>>, MapperError> {
        let Some(trajectory) = self.active.get_mut(&id) else { return Ok(Vec::new()) };
        let piece = trajectory.piece;
        let mut results = Vec::new();
        let start = Instant::now();
        match measurement {
            Measurement::Range(data) => results = trajectory.local_slam.add_range_data(sensor_id, data),
            Measurement::Imu(data) => {
                trajectory.local_slam.add_imu_data(&data);
                if S::OPTIMIZES_WITH_IMU {
                    self.backend.enqueue_along(move |graph| graph.add_imu_data(piece, data))?;
                }
            }
            Measurement::Odometry(data) => {
                results = trajectory.local_slam.add_odometry_data(&data);
                let similar = trajectory
                    .odometry_filter
                    .as_mut()
                    .is_some_and(|filter| filter.is_similar(data.time, &data.odom_from_tracking));
                if !similar {
                    self.backend.enqueue_along(move |graph| graph.add_odometry_data(piece, data))?;
                }
            }
            Measurement::FixedFramePose(data) => {
                self.backend.enqueue_along(move |graph| graph.add_fixed_frame_pose_data(piece, data))?;
            }
            Measurement::Landmark(data) => {
                self.backend.enqueue_along(move |graph| graph.add_landmark_data(piece, data))?;
            }
        }
        if let Ok(matched @ 1..) = u32::try_from(results.len()) {
            let each = start.elapsed() / matched;
            (0..matched).for_each(|_| self.scan_times.add(each));
        }
        self.pass_on(id, &results)?;
        Ok(results)
    }

    /// Remembers where scans were taken and gives the inserted ones to the pose graph.
    fn pass_on(&mut self, id: TrajectoryId, results: &[MatchingResult<S>]) -> Result<(), MapperError> {
        for result in results {
            if let Some(lost) = &result.lost {
                self.begin_piece(id, lost, result.time)?;
            }
            let Some(trajectory) = self.active.get_mut(&id) else { continue };
            trajectory.remember_scan(result);
            let piece = trajectory.piece;
            if let Some(inserted) = result.inserted.clone() {
                self.backend.enqueue(move |graph| {
                    graph.add_node(piece, inserted);
                })?;
            }
        }
        Ok(())
    }

    /// Ends the piece of map that was being drawn, and begins another one, which has no place in the rest yet.
    fn begin_piece(&mut self, id: TrajectoryId, lost: &Lost<S>, time: Time) -> Result<(), MapperError> {
        let piece = TrajectoryId(self.next_trajectory);
        let begun = self.scan_poses();
        let Some(trajectory) = self.active.get_mut(&id) else { return Ok(()) };
        self.next_trajectory += 1;
        self.losses.push(Loss { since: lost.since, until: time, piece, is_gap: lost.is_gap() });
        let before = std::mem::replace(&mut trajectory.piece, piece);
        let ended = EndedTrajectory {
            options: trajectory.options.clone(),
            sensors: trajectory.sensors.clone(),
            scans: std::mem::replace(&mut trajectory.scans, begun),
            fixed_frame_on_earth: None,
        };
        (trajectory.last_node, trajectory.next_node) = (None, 0);
        self.ended.insert(before, ended);
        let remaining = lost.remaining.clone();
        let (since, ended_from_begun, bridge) = (lost.since, lost.ended_from_begun, lost.bridge);
        self.backend.enqueue(move |graph| {
            graph.begin_piece(before, remaining, piece, &ended_from_begun, bridge);
            graph.copy_measurements(before, piece, since);
        })
    }

    /// Ends a trajectory: what waits is used, its submaps are completed.
    pub fn finish_trajectory(&mut self, id: TrajectoryId) -> Result<Vec<MatchingResult<S>>, MapperError> {
        let ready = self.collation.finish_trajectory(id);
        let mut results = self.dispatch_all(ready)?;
        if let Some(trajectory) = self.active.get_mut(&id) {
            let late = trajectory.local_slam.flush();
            self.pass_on(id, &late)?;
            results.extend(late);
        }
        let Some(mut trajectory) = self.active.remove(&id) else {
            return Err(MapperError::NoSuchTrajectory(id));
        };
        let remaining = trajectory.local_slam.finish();
        self.issues.append(&trajectory.local_slam.issues());
        self.degenerate_intervals.extend(trajectory.local_slam.degenerate_intervals());
        let piece = trajectory.piece;
        self.ended.insert(
            piece,
            EndedTrajectory {
                options: trajectory.options,
                sensors: trajectory.sensors,
                scans: trajectory.scans,
                fixed_frame_on_earth: None,
            },
        );
        self.backend.enqueue(move |graph| graph.finish_trajectory(piece, remaining))?;
        Ok(results)
    }

    /// How long local SLAM took for each scan that it matched.
    pub fn scan_times(&self) -> &LatencyHistogram {
        &self.scan_times
    }

    /// Where scans of ended trajectories left directions open.
    pub fn degenerate_intervals(&self) -> &[DegenerateInterval] {
        &self.degenerate_intervals
    }

    /// When trajectories were lost, in order of time.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// How far the pose graph is.
    pub fn progress(&self) -> BackendProgress {
        self.backend.progress()
    }

    /// Gives access to the pose graph after everything given so far; waits for the answer.
    pub fn with_pose_graph<R: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut PoseGraph<S>) -> R + Send + 'static,
    ) -> Result<R, MapperError> {
        self.backend.call(work)
    }

    /// What was dropped or repaired in ended trajectories and in ordering the sensors.
    pub fn issues(&self) -> IssueLog {
        let mut issues = self.issues.clone();
        issues.append(&self.collation.issues());
        for trajectory in self.active.values() {
            issues.append(&trajectory.local_slam.issues());
        }
        issues
    }

    /// From now on nothing is searched any more, and the map is optimised only once, at the end: it is wanted as it is.
    pub fn stop(&self) {
        self.stop.ask();
    }

    /// Ends all trajectories, optimises for the last time, and gives the map.
    pub fn finish(self) -> Result<(Map<S>, IssueLog), MapperError> {
        self.finish_while(&mut |_| true)
    }

    /// As [`Self::finish`]; `goes_on` is told now and then how far it is, and with false it does as [`Self::stop`].
    pub fn finish_while(
        mut self,
        goes_on: &mut dyn FnMut(BackendProgress) -> bool,
    ) -> Result<(Map<S>, IssueLog), MapperError> {
        let active: Vec<TrajectoryId> = self.active.keys().copied().collect();
        for id in active {
            self.finish_trajectory(id)?;
        }
        let (issues, stop) = (self.issues(), self.stop.clone());
        let graph = self.backend.finish(PoseGraph::run_final_optimization, &mut |progress| {
            if !stop.is_asked() && !goes_on(progress) {
                stop.ask();
            }
        })?;
        Ok((Map::new(self.options, graph, self.ended), issues))
    }
}

impl<S: Space> ActiveTrajectory<S> {
    fn remember_scan(&mut self, result: &MatchingResult<S>) {
        if result.inserted.is_some() {
            self.last_node = Some(self.next_node);
            self.next_node += 1;
        }
        self.scans.push(ScanPose {
            time: result.time,
            local_from_tracking: result.local_from_tracking,
            last_node_index: self.last_node,
        });
    }
}
