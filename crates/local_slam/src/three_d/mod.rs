//! Local SLAM in 3D: assembles messages to sweeps, estimates their poses by one of two engines, and
//! inserts key frames into submaps as nodes.
//!
//! Unlike Cartographer it also works without an IMU: if no IMU sample has come within a second of range
//! data, the trajectory starts with a level tracking frame, and only lidar measures rotations.

use std::collections::VecDeque;

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_motion::{DegenerateInterval, WaitingSweeps};
use portolan_recall::Memory;
use portolan_sensor::{
    ImuData, OdometryData, RangeDataCollator, SensorId, SynchronizedRanges, TimedPointCloudData,
};
use portolan_submaps::{Inserter3d, Submap3d};

use super::{LocalSlam, MatchingResult, count_collated, count_extrapolated, first_point_time};
use crate::{InsertionSubmap, LocalSlamError, Space3d, note_corrected_odometry};

mod deskew;
mod grid_matcher;
mod grids;
mod keyframe_insertion;
mod planes;
mod sweep_assembly;

use grid_matcher::GridMatcher;
use grids::GridEngine;
use keyframe_insertion::KeyframeInsertion;
use planes::PlaneEngine;
use sweep_assembly::SweepAssembly;

/// Settings of local SLAM in 3D beyond Cartographer's options.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LocalSlam3dSettings {
    /// Predict from all odometry and gyroscope data of the gap between sweeps.
    pub use_all_odometry: bool,
    /// Register to planes in voxels of at most this size, metres, instead of to grids.
    pub plane_voxel_size: Option<f64>,
    /// Minimum duration of an accumulated scan, approximately, seconds.
    pub min_scan_duration: f64,
}

/// Local SLAM of one trajectory in 3D.
pub struct LocalSlam3d {
    collator: RangeDataCollator,
    wants_intensities: bool,
    /// Messages received before the trajectory began.
    waiting: VecDeque<SynchronizedRanges>,
    assembly: SweepAssembly,
    engine: Engine,
    insertion: KeyframeInsertion,
    issues: IssueLog,
}

/// Estimator of the poses of sweeps.
enum Engine {
    /// Registration to planar voxel maps.
    Planes(Box<PlaneEngine>),
    /// Matching to hybrid grids, as Cartographer.
    Grids(Box<GridEngine>),
}

impl LocalSlam3d {
    /// Local SLAM for a trajectory with these range sensors.
    ///
    /// # Errors
    /// If an option of grids or matchers is not valid.
    pub fn new(
        options: &TrajectoryBuilder3dOptions,
        range_sensors: &[SensorId],
        settings: LocalSlam3dSettings,
    ) -> Result<Self, LocalSlamError> {
        let inserter =
            Inserter3d::new(&options.submaps, options.rotational_histogram_size, options.use_intensities)
                .map_err(|e| LocalSlamError(e.to_string()))?;
        let matcher = GridMatcher::new(options)?;
        let (engine, inserter) = match settings.plane_voxel_size {
            Some(size) => {
                let engine = PlaneEngine::new(options, &settings, size, matcher);
                (Engine::Planes(Box::new(engine)), inserter.drawing_late())
            }
            None => (Engine::Grids(Box::new(GridEngine::new(options, &settings, matcher))), inserter),
        };
        Ok(Self {
            collator: RangeDataCollator::new(range_sensors.iter().map(|s| s.id.clone())),
            wants_intensities: options.use_intensities,
            waiting: VecDeque::new(),
            assembly: SweepAssembly::new(options, settings.min_scan_duration),
            engine,
            insertion: KeyframeInsertion::new(options, inserter),
            issues: IssueLog::default(),
        })
    }

    fn count(&mut self, kind: IssueKind, time: Time) {
        self.issues.add(Issue::new(kind).at(time));
    }

    /// Begins the trajectory if the data suffices. Gives whether it has begun.
    fn begin_if_ready(&mut self) -> bool {
        let waiting = waiting_sweeps(&self.waiting);
        match &mut self.engine {
            Engine::Planes(engine) => engine.begin_if_ready(waiting.as_ref()),
            Engine::Grids(engine) => engine.begin_if_ready(waiting.as_ref(), &mut self.issues),
        }
    }

    /// Registers the messages that waited for the start.
    fn register_waiting(&mut self) -> Vec<MatchingResult<Space3d>> {
        if !self.begin_if_ready() {
            return Vec::new();
        }
        let waiting = std::mem::take(&mut self.waiting);
        waiting.iter().flat_map(|ranges| self.add_synchronized(ranges)).collect()
    }

    /// Adds one synchronised set of ranges, and registers the sweep if it completes one.
    fn add_synchronized(&mut self, ranges: &SynchronizedRanges) -> Vec<MatchingResult<Space3d>> {
        if self.last_pose_time().is_some_and(|last| first_point_time(ranges) < last) {
            let kind = match self.insertion.has_submap() {
                true => IssueKind::ScanOverlapsLast,
                false => IssueKind::ScanBeforeImu,
            };
            self.count(kind, ranges.time);
            return Vec::new();
        }
        let Some(gathered) = self.assembly.add(ranges, &mut self.issues) else { return Vec::new() };
        let insertion = &mut self.insertion;
        match &mut self.engine {
            Engine::Planes(engine) => engine.add_sweep(ranges.time, &gathered, insertion),
            Engine::Grids(engine) => {
                let result = engine.add_sweep(ranges.time, &gathered, insertion, &mut self.issues);
                result.into_iter().collect()
            }
        }
    }

    fn last_pose_time(&self) -> Option<Time> {
        match &self.engine {
            Engine::Planes(engine) => engine.last_pose_time(),
            Engine::Grids(engine) => engine.last_pose_time(),
        }
    }
}

fn waiting_sweeps(waiting: &VecDeque<SynchronizedRanges>) -> Option<WaitingSweeps> {
    let (first, last) = (waiting.front()?, waiting.back()?);
    Some(WaitingSweeps { first_point: first_point_time(first), first_end: first.time, last_end: last.time })
}

impl LocalSlam<Space3d> for LocalSlam3d {
    fn add_range_data(
        &mut self,
        sensor_id: &SensorId,
        data: TimedPointCloudData,
    ) -> Vec<MatchingResult<Space3d>> {
        let Some(ranges) = self.collator.add(&sensor_id.id, data) else { return Vec::new() };
        if ranges.points.is_empty() {
            self.count(IssueKind::ScanWithoutPoints, ranges.time);
            return Vec::new();
        }
        if self.wants_intensities && ranges.intensities.is_empty() {
            self.count(IssueKind::ScanWithoutIntensities, ranges.time);
        }
        self.waiting.push_back(ranges);
        self.register_waiting()
    }

    fn add_imu_data(&mut self, data: &ImuData) {
        match &mut self.engine {
            Engine::Planes(engine) => engine.add_imu(data),
            Engine::Grids(engine) => engine.add_imu(data, &mut self.issues),
        }
        self.begin_if_ready();
    }

    fn add_odometry_data(&mut self, data: &OdometryData) -> Vec<MatchingResult<Space3d>> {
        match &mut self.engine {
            Engine::Planes(engine) => engine.add_odometry(data),
            Engine::Grids(engine) => engine.add_odometry(data, &mut self.issues),
        }
        Vec::new()
    }

    fn flush(&mut self) -> Vec<MatchingResult<Space3d>> {
        let waiting = waiting_sweeps(&self.waiting);
        match &mut self.engine {
            Engine::Planes(engine) => engine.begin(waiting.as_ref()),
            Engine::Grids(engine) => engine.begin(waiting.as_ref(), &mut self.issues),
        }
        let mut results = self.register_waiting();
        if let Engine::Planes(engine) = &mut self.engine {
            results.extend(engine.flush(&mut self.insertion));
        }
        results
    }

    fn remember_with(&mut self, memory: &Memory) {
        match &mut self.engine {
            Engine::Planes(engine) => engine.remember_with(memory),
            Engine::Grids(engine) => engine.remember_with(memory),
        }
    }

    fn finish(&mut self) -> Vec<InsertionSubmap<Space3d>> {
        match &self.engine {
            Engine::Planes(engine) => self.insertion.finish(engine.growing_maps()),
            Engine::Grids(_) => self.insertion.finish(std::iter::empty()),
        }
    }

    fn active_submaps(&self) -> Vec<(u32, Submap3d)> {
        let drawn = |submap: &Submap3d| {
            let mut submap = submap.clone();
            submap.draw_grids();
            submap
        };
        self.insertion.submaps.iter().map(|(index, submap)| (index, drawn(submap))).collect()
    }

    fn lost_since(&self) -> Option<Time> {
        match &self.engine {
            Engine::Planes(engine) => engine.lost_since(),
            Engine::Grids(_) => None,
        }
    }

    fn issues(&self) -> IssueLog {
        let mut issues = self.issues.clone();
        self.insertion.count_into(&mut issues);
        count_collated(self.collator.counts(), &mut issues);
        let counts = match &self.engine {
            Engine::Planes(engine) => {
                issues.append(engine.issues());
                note_corrected_odometry(engine.odometry_factor(), &mut issues);
                engine.extrapolator_counts()
            }
            Engine::Grids(engine) => engine.extrapolator_counts(),
        };
        count_extrapolated(&counts, &mut issues);
        issues
    }

    fn degenerate_intervals(&self) -> Vec<DegenerateInterval> {
        match &self.engine {
            Engine::Planes(engine) => engine.degenerate_intervals(),
            Engine::Grids(_) => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests;
