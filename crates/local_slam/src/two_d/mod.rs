//! Local SLAM in 2D (`slam2d.md` §5).

mod catching_up;
mod co_moving;
mod dead_reckoning;
mod degeneracy;
mod front_end;
mod gather;
mod hypotheses;
mod independent_measurements;
mod level;
mod motion;
mod occlusion;
mod odometry_failure;
mod odometry_scale;
mod pose_status;
mod posterior;
mod prediction_error;
mod scan;
mod start;
mod tracking;
mod unknown_motion;
mod unmeasured_travel;

use portolan_config::TrajectoryBuilder2dOptions;
use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_motion::DegenerateInterval;
use portolan_recall::Memory;
use portolan_sensor::{ImuData, OdometryData, RangeDataCollator, SensorId, TimedPointCloudData};
use portolan_submaps::Submap2d;

use crate::{InsertionSubmap, LocalSlam, LocalSlamError, MatchingResult, Space2d, count_collated};
use front_end::FrontEnd;
pub use pose_status::refutes_place;
use start::{FirstMotion, Held, Role, Start, Velocity};

/// Settings of local SLAM in 2D beyond Cartographer's options.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LocalSlamExtras {
    /// Predict from all odometry and gyroscope data of the gap between scans.
    pub use_all_odometry: bool,
    /// Largest fraction by which the prediction lowers the score of a match.
    pub search_penalty_limit: f64,
    /// Gap without any sensor data, seconds, after which the scan is searched over a wide window; 0
    /// disables it.
    pub wide_search_after_gap: f64,
    /// Adapt the search window to recent prediction errors, and search wider where a scan contradicts the
    /// map.
    pub adaptive_search: bool,
    /// Distance travelled after which a submap is full, too, metres; 0 counts only scans.
    pub submap_length: f64,
    /// Nodes keep their scans, so that submaps can be rasterised again.
    pub keep_scans: bool,
    /// Submaps fill the space between neighbouring returns of one surface.
    pub join_surfaces: bool,
}

/// Local SLAM of one trajectory in 2D.
pub struct LocalSlam2d {
    collator: RangeDataCollator,
    start: Start,
    front_end: FrontEnd,
    issues: IssueLog,
}

impl LocalSlam2d {
    /// Local SLAM for a trajectory with these range sensors.
    ///
    /// # Errors
    /// If an option of grids or matchers is not valid.
    pub fn new(
        options: &TrajectoryBuilder2dOptions,
        range_sensors: &[SensorId],
        extras: LocalSlamExtras,
    ) -> Result<Self, LocalSlamError> {
        let front_end = FrontEnd::new(options, extras, Velocity::default(), Role::Mapping)?;
        Ok(Self {
            collator: RangeDataCollator::new(range_sensors.iter().map(|s| s.id.clone())),
            start: Start::new(options, extras, front_end.is_adaptive()),
            front_end,
            issues: IssueLog::default(),
        })
    }

    /// Processes the measurements that were held back, with the initial motion that explains them best.
    fn begin(&mut self) -> Vec<MatchingResult<Space2d>> {
        let (motion, held) = self.start.decided();
        match motion {
            FirstMotion::Odometry => {}
            FirstMotion::Velocity(velocity) => self.front_end.set_velocity(velocity),
            FirstMotion::AgainstOdometry(velocity) => self.front_end.set_velocity_against_odometry(velocity),
        }
        let results = self.process(held);
        self.watch();
        results
    }

    fn process(&mut self, held: Vec<Held>) -> Vec<MatchingResult<Space2d>> {
        held.into_iter().flat_map(|measurement| measurement.add_to(&mut self.front_end)).collect()
    }

    /// Holds measurements back again where a new piece of map was begun and no sensor measures the motion.
    fn watch(&mut self) {
        if self.front_end.take_restarted() {
            self.start.reopen();
        }
    }
}

impl LocalSlam<Space2d> for LocalSlam2d {
    fn add_range_data(
        &mut self,
        sensor_id: &SensorId,
        data: TimedPointCloudData,
    ) -> Vec<MatchingResult<Space2d>> {
        let Some(ranges) = self.collator.add(&sensor_id.id, data) else { return Vec::new() };
        // While the initial motion is being determined, every scan has to constrain it.
        if ranges.points.is_empty() && (self.start.is_open() || !self.front_end.is_adaptive()) {
            self.issues.add(Issue::new(IssueKind::ScanWithoutPoints).at(ranges.time));
            return Vec::new();
        }
        if self.start.is_open() {
            self.start.hold(Held::Ranges(ranges));
            return if self.start.is_ready() { self.begin() } else { Vec::new() };
        }
        let results = self.front_end.add_ranges(ranges);
        self.watch();
        results
    }

    fn add_imu_data(&mut self, data: &ImuData) {
        match self.start.is_open() {
            true => self.start.hold(Held::Imu(*data)),
            false => self.front_end.add_imu(data),
        }
    }

    fn add_odometry_data(&mut self, data: &OdometryData) -> Vec<MatchingResult<Space2d>> {
        if self.start.is_open() {
            self.start.hold(Held::Odometry(*data));
            return Vec::new();
        }
        let results = self.front_end.add_odometry(data);
        self.watch();
        results
    }

    fn flush(&mut self) -> Vec<MatchingResult<Space2d>> {
        let mut results = if self.start.is_open() { self.begin() } else { Vec::new() };
        results.extend(self.front_end.flush());
        results
    }

    fn remember_with(&mut self, memory: &Memory) {
        self.front_end.remember_with(memory);
    }

    fn finish(&mut self) -> Vec<InsertionSubmap<Space2d>> {
        self.front_end.finish()
    }

    fn active_submaps(&self) -> Vec<(u32, Submap2d)> {
        self.front_end.active_submaps()
    }

    fn lost_since(&self) -> Option<Time> {
        self.front_end.lost_since()
    }

    fn degenerate_intervals(&self) -> Vec<DegenerateInterval> {
        self.front_end.degenerate_intervals().to_vec()
    }

    fn issues(&self) -> IssueLog {
        let mut issues = self.issues.clone();
        issues.append(&self.front_end.issues());
        count_collated(self.collator.counts(), &mut issues);
        issues
    }
}
