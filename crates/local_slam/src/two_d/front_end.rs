//! Front end of one trajectory: predicts, matches and inserts its scans (`slam2d.md` §5), from a given
//! initial motion.

mod degeneracy;
mod deskew;
mod one_scan;
mod pieces;

use std::collections::VecDeque;
use std::sync::Arc;

use portolan_config::TrajectoryBuilder2dOptions;
use portolan_geometry::{Duration, Rigid2, Rigid3, Time};
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_lidar_odometry::OdometrySettings;
use portolan_motion::{DegenerateInterval, DegenerateIntervals, MotionFilter, PoseExtrapolator};
use portolan_recall::Memory;
use portolan_sensor::{ImuData, OdometryData, SynchronizedRanges};
use portolan_submaps::{Inserter2d, Submap2d};

use super::LocalSlamExtras;
use super::co_moving::CoMoving;
use super::dead_reckoning::DeadReckoning;
use super::gather::{Accumulation, deskew_into, gravity_aligned};
use super::level::LevelFilter;
use super::pose_status::PoseStatus;
use super::start::{NEAR, Role, Velocity};
use super::tracking::Tracker;
use super::unmeasured_travel::UnmeasuredTravel;
use crate::{
    ActiveSubmaps, GatheredVariance, InsertionSubmap, LocalSlamError, MOST_GATHERED_POINTS, MatchingResult,
    Space2d, count_extrapolated, first_point_time, motion_filter, note_corrected_odometry, take_odometry,
};

/// Maximum silence of an odometry source that is still waited for.
const ODOMETRY_TIMEOUT: Duration = Duration::from_ticks(50_000_000);

/// Time constant of gravity in the extrapolator where the level filter provides it, seconds: accelerations
/// are not averaged.
const LEVEL_AT_ONCE: f64 = 1e-6;

/// Maximum time by which the newest scan may be newer than one that still waits for odometry.
const LONGEST_WAIT: Duration = Duration::from_ticks(20_000_000);

/// Matches scans one after the other and builds submaps of them.
pub(super) struct FrontEnd {
    options: TrajectoryBuilder2dOptions,
    extrapolator: Option<PoseExtrapolator>,
    level: LevelFilter,
    extras: LocalSlamExtras,
    tracker: Tracker,
    status: PoseStatus,
    co_moving: CoMoving,
    /// The last accepted pose, in the local map.
    last_confirmed: Rigid2,
    /// Dead reckoning by odometry from there.
    reckoned: DeadReckoning,
    inserter: Arc<Inserter2d>,
    active_submaps: ActiveSubmaps<Space2d>,
    motion_filter: MotionFilter,
    accumulated: Accumulation,
    /// Odometry that came before the first scan.
    waiting_odometry: VecDeque<OdometryData>,
    last_odometry_time: Option<Time>,
    /// Scans that wait for the next odometry pose.
    waiting_ranges: VecDeque<SynchronizedRanges>,
    /// Velocity of the scanner at the start.
    start_velocity: Velocity,
    /// Whether a piece of map was begun that no measurement connects to the one before.
    has_restarted: bool,
    degenerate: DegenerateIntervals,
    /// Variance accumulated where scans did not constrain the position or the heading.
    gathered: GatheredVariance,
    unmeasured_travel: UnmeasuredTravel,
    /// Its tasks besides mapping.
    pub(super) role: Role,
    issues: IssueLog,
}

impl FrontEnd {
    /// Front end of a scanner with this velocity at the start.
    pub fn new(
        options: &TrajectoryBuilder2dOptions,
        extras: LocalSlamExtras,
        start_velocity: Velocity,
        role: Role,
    ) -> Result<Self, LocalSlamError> {
        let contradiction = |e: &dyn std::error::Error| LocalSlamError(e.to_string());
        let mut tracker = Tracker::new(options, &extras).map_err(|e| contradiction(&e))?;
        if role.is_trial() {
            tracker.limit_to(NEAR);
        }
        Ok(Self {
            inserter: Arc::new(
                Inserter2d::new(&options.submaps, extras.join_surfaces).map_err(|e| contradiction(&e))?,
            ),
            extrapolator: None,
            level: LevelFilter::default(),
            extras,
            status: PoseStatus::default(),
            co_moving: CoMoving::default(),
            last_confirmed: Rigid2::identity(),
            reckoned: DeadReckoning::from(Rigid2::identity()),
            tracker,
            active_submaps: no_submaps(options, &extras),
            motion_filter: motion_filter(&options.motion_filter),
            accumulated: Accumulation::default(),
            waiting_odometry: VecDeque::new(),
            last_odometry_time: None,
            waiting_ranges: VecDeque::new(),
            start_velocity,
            has_restarted: false,
            degenerate: OdometrySettings::default().degenerate_intervals(),
            gathered: GatheredVariance::default(),
            unmeasured_travel: UnmeasuredTravel::default(),
            role,
            issues: IssueLog::default(),
            options: options.clone(),
        })
    }

    fn count(&mut self, kind: IssueKind, time: Time) {
        self.issues.add(Issue::new(kind).at(time));
    }

    fn start_extrapolator(&mut self, time: Time) -> &mut PoseExtrapolator {
        let options = &self.options.pose_extrapolator.constant_velocity;
        let use_all_odometry = self.extras.use_all_odometry;
        // The direction of gravity from the level filter holds at once.
        let gravity_time_constant = match use_all_odometry {
            true => LEVEL_AT_ONCE,
            false => options.imu_gravity_time_constant,
        };
        let waiting = &mut self.waiting_odometry;
        let velocity = self.start_velocity;
        self.extrapolator.get_or_insert_with(|| {
            let mut extrapolator =
                PoseExtrapolator::new(options.pose_queue_duration, gravity_time_constant, use_all_odometry);
            pieces::restart(&mut extrapolator, time, Rigid3::identity(), velocity);
            for odometry in waiting.drain(..) {
                let _ = extrapolator.add_odometry(&odometry);
            }
            extrapolator
        })
    }

    /// Whether a scan waits for odometry. Between two odometry poses the motion is measured; beyond the
    /// last one it can only be guessed. A source that has fallen silent is not waited for.
    fn waits_for_odometry(&self, time: Time) -> bool {
        self.extras.use_all_odometry
            && self.last_odometry_time.is_some_and(|last| last < time && time - last <= ODOMETRY_TIMEOUT)
    }

    /// Matches the scans whose odometry has arrived, and those that waited too long.
    fn match_waiting(&mut self, newest: Time) -> Vec<MatchingResult<Space2d>> {
        let mut results = Vec::new();
        while let Some(oldest) = self.waiting_ranges.front() {
            if self.waits_for_odometry(oldest.time) && newest - oldest.time <= LONGEST_WAIT {
                break;
            }
            let Some(ranges) = self.waiting_ranges.pop_front() else { break };
            results.extend(self.add_synchronized(&ranges));
        }
        results
    }

    /// De-skews and accumulates one synchronised set of ranges, and matches once enough are accumulated.
    fn add_synchronized(&mut self, ranges: &SynchronizedRanges) -> Option<MatchingResult<Space2d>> {
        if !self.options.use_imu_data {
            let first = first_point_time(ranges);
            self.start_extrapolator(first);
        }
        let oldest = first_point_time(ranges);
        let Some(extrapolator) = self.extrapolator.as_mut() else {
            self.count(IssueKind::ScanBeforeImu, ranges.time);
            return None;
        };
        if extrapolator.last_pose_time().is_some_and(|last| oldest < last) {
            self.count(IssueKind::ScanOverlapsLast, ranges.time);
            return None;
        }
        if ranges.points.is_empty() {
            let gravity = extrapolator.estimate_gravity_orientation(ranges.time);
            return self.carried_without_returns(ranges.time, gravity);
        }
        let last_pose = deskew_into(
            ranges,
            |time| extrapolator.extrapolate_pose(time),
            &self.options,
            &mut self.accumulated,
        );
        self.accumulated.messages += 1;
        let wanted = u32::try_from(self.options.num_accumulated_range_data).unwrap_or(1);
        if self.accumulated.messages < wanted {
            if self.accumulated.returns.len() + self.accumulated.misses.len() < MOST_GATHERED_POINTS {
                return None;
            }
            self.issues.add(Issue::new(IssueKind::ScanCutShort).at(ranges.time));
        }
        let accumulated = std::mem::take(&mut self.accumulated);
        let gravity = extrapolator.estimate_gravity_orientation(ranges.time);
        let scan = gravity_aligned(accumulated, &last_pose, &gravity, &self.options);
        let deskewed = if wanted <= 1 { self.deskewed(ranges, &scan, gravity) } else { None };
        self.add_accumulated(ranges.time, deskewed.as_ref().unwrap_or(&scan), gravity)
    }

    /// Takes scans of all sensors at one time. Gives the results of the scans that are now processed.
    pub fn add_ranges(&mut self, ranges: SynchronizedRanges) -> Vec<MatchingResult<Space2d>> {
        let newest = ranges.time;
        self.waiting_ranges.push_back(ranges);
        self.match_waiting(newest)
    }

    /// Takes an IMU sample.
    pub fn add_imu(&mut self, data: &ImuData) {
        if !self.options.use_imu_data {
            return;
        }
        let levelled = if self.extras.use_all_odometry { self.level.add_imu(data) } else { *data };
        let extrapolator = self.start_extrapolator(data.time);
        if extrapolator.add_imu(&levelled).is_err() {
            self.count(IssueKind::ImuSampleTooOld, data.time);
        }
    }

    /// Takes an odometry pose. Gives the results of scans that waited for it.
    pub fn add_odometry(&mut self, data: &OdometryData) -> Vec<MatchingResult<Space2d>> {
        if !take_odometry(data, self.extrapolator.as_mut(), &mut self.waiting_odometry) {
            self.count(IssueKind::OdometryTooOld, data.time);
        }
        self.last_odometry_time = self.last_odometry_time.max(Some(data.time));
        self.match_waiting(data.time)
    }

    /// Matches scans that still wait for odometry that will not come.
    pub fn flush(&mut self) -> Vec<MatchingResult<Space2d>> {
        self.last_odometry_time = None;
        self.match_waiting(Time::MAX)
    }

    /// Intervals so far in which scans did not constrain the motion.
    pub fn degenerate_intervals(&self) -> &[DegenerateInterval] {
        self.degenerate.all()
    }

    /// Sets the memory in which matched poses are remembered.
    pub fn remember_with(&mut self, memory: &Memory) {
        self.tracker.remember_with(memory);
    }

    /// Hands over the submaps that were being filled.
    pub fn finish(&mut self) -> Vec<InsertionSubmap<Space2d>> {
        self.active_submaps.finish()
    }

    /// Copies of the submaps that are being filled, with their indices.
    pub fn active_submaps(&self) -> Vec<(u32, Submap2d)> {
        self.active_submaps.iter().map(|(index, submap)| (index, submap.clone())).collect()
    }

    /// Data that was dropped or repaired so far.
    pub fn issues(&self) -> IssueLog {
        let mut issues = self.issues.clone();
        self.active_submaps.count_into(&mut issues);
        if let Some(extrapolator) = &self.extrapolator {
            count_extrapolated(&extrapolator.counts(), &mut issues);
        }
        note_corrected_odometry(self.tracker.odometry_factor(), &mut issues);
        issues
    }

    /// Whether the search window adapts to recent prediction errors.
    pub fn is_adaptive(&self) -> bool {
        self.tracker.is_adaptive()
    }
}

fn no_submaps(options: &TrajectoryBuilder2dOptions, extras: &LocalSlamExtras) -> ActiveSubmaps<Space2d> {
    let scans_per_half = u32::try_from(options.submaps.num_range_data).unwrap_or(1);
    ActiveSubmaps::new(scans_per_half).with_length(extras.submap_length)
}

#[cfg(test)]
mod tests;
