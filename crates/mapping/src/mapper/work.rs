//! The work of a mapper, compiled in this crate once for each space.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Instant;

use portolan_config::Options;
use portolan_geometry::Time;
use portolan_issue::IssueLog;
use portolan_numeric::LatencyHistogram;
use portolan_recall::Memory;
use portolan_sensor::{Measurement, SensorId, SensorKind};
use portolan_spool::Spool;

use super::{ActiveTrajectory, EndedTrajectory, Loss, Mapper, MapperSettings};
use crate::backend::{Backend, BackendProgress, MapperError};
use crate::collation::SensorCollation;
use crate::map::{Map, ScanPose};
use crate::{InitialTrajectoryPose, PoseGraph, PoseGraphPolicy, Space, TrajectoryId, Trimmer};
use portolan_local_slam::{LocalSlam, Lost, MatchingResult, motion_filter};

/// The functions behind the methods of [`Mapper`], by their names.
///
/// A generic function is compiled and optimised again by every crate and program that calls it, with all that
/// it calls; for a mapper that takes half a minute. [`Space::mapper_work`] returns them as compiled here.
#[allow(clippy::type_complexity)]
pub struct MapperWork<S: Space> {
    pub(super) with_graph: fn(
        &Options,
        MapperSettings,
        PoseGraph<S>,
        BTreeMap<TrajectoryId, EndedTrajectory>,
    ) -> Result<Mapper<S>, MapperError>,
    pub(super) remember_with: fn(&mut Mapper<S>, &Memory) -> Result<(), MapperError>,
    pub(super) spool_in: fn(&mut Mapper<S>, &Path) -> Result<(), MapperError>,
    pub(super) add_trajectory: fn(
        &mut Mapper<S>,
        &BTreeSet<SensorId>,
        Option<InitialTrajectoryPose>,
    ) -> Result<TrajectoryId, MapperError>,
    pub(super) add: fn(
        &mut Mapper<S>,
        TrajectoryId,
        &SensorId,
        Measurement,
    ) -> Result<Vec<MatchingResult<S>>, MapperError>,
    pub(super) finish_trajectory:
        fn(&mut Mapper<S>, TrajectoryId) -> Result<Vec<MatchingResult<S>>, MapperError>,
    pub(super) issues: fn(&Mapper<S>) -> IssueLog,
    pub(super) finish_while:
        fn(Mapper<S>, &mut dyn FnMut(BackendProgress) -> bool) -> Result<(Map<S>, IssueLog), MapperError>,
}

impl<S: Space> MapperWork<S> {
    /// For a static item of the space.
    pub(crate) const fn compiled() -> Self {
        Self {
            with_graph: Mapper::with_graph_here,
            remember_with: Mapper::remember_with_here,
            spool_in: Mapper::spool_in_here,
            add_trajectory: Mapper::add_trajectory_here,
            add: Mapper::add_here,
            finish_trajectory: Mapper::finish_trajectory_here,
            issues: Mapper::issues_here,
            finish_while: Mapper::finish_while_here,
        }
    }
}

impl<S: Space> Mapper<S> {
    fn with_graph_here(
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

    fn remember_with_here(&mut self, memory: &Memory) -> Result<(), MapperError> {
        self.memory = memory.clone();
        let memory = memory.clone();
        self.backend.enqueue(move |graph| graph.remember_with(memory))
    }

    fn spool_in_here(&mut self, folder: &Path) -> Result<(), MapperError> {
        self.spool_folder = Some(folder.to_owned());
        let folder = folder.to_owned();
        self.backend.enqueue(move |graph| graph.spool_in(&folder))
    }

    fn scan_poses(&self) -> Spool<ScanPose> {
        self.spool_folder.as_deref().map_or_else(Spool::default, Spool::in_folder)
    }

    fn add_trajectory_here(
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

    fn add_here(
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

    /// Passes a measurement, in order of time, to local SLAM and to the pose graph.
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

    /// Stores the poses of scans and passes the inserted ones to the pose graph.
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

    /// Ends the current piece of map, and begins another one, which is not connected with the rest yet.
    fn begin_piece(&mut self, id: TrajectoryId, lost: &Lost<S>, time: Time) -> Result<(), MapperError> {
        let piece = TrajectoryId(self.next_trajectory);
        let begun = self.scan_poses();
        let Some(trajectory) = self.active.get_mut(&id) else { return Ok(()) };
        self.next_trajectory += 1;
        self.losses.push(Loss { since: lost.since, until: time, piece: Some(piece), is_gap: lost.is_gap() });
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
        let (since, old_from_new, bridge) = (lost.since, lost.old_from_new, lost.bridge);
        self.backend.enqueue(move |graph| {
            graph.begin_piece(before, remaining, piece, &old_from_new, bridge);
            graph.copy_measurements(before, piece, since);
        })
    }

    fn finish_trajectory_here(&mut self, id: TrajectoryId) -> Result<Vec<MatchingResult<S>>, MapperError> {
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
        if let (Some(since), Some(last)) = (trajectory.local_slam.lost_since(), trajectory.scans.last()) {
            self.losses.push(Loss { since, until: last.time, piece: None, is_gap: false });
        }
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

    fn issues_here(&self) -> IssueLog {
        let mut issues = self.issues.clone();
        issues.append(&self.collation.issues());
        for trajectory in self.active.values() {
            issues.append(&trajectory.local_slam.issues());
        }
        issues
    }

    fn finish_while_here(
        mut self,
        continues: &mut dyn FnMut(BackendProgress) -> bool,
    ) -> Result<(Map<S>, IssueLog), MapperError> {
        let active: Vec<TrajectoryId> = self.active.keys().copied().collect();
        for id in active {
            self.finish_trajectory_here(id)?;
        }
        let (issues, stop) = (self.issues_here(), self.stop.clone());
        let graph = self.backend.finish(PoseGraph::run_final_optimization, &mut |progress| {
            if !stop.is_requested() && !continues(progress) {
                stop.request();
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
