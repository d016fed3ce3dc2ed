//! One trajectory's scans, each predicted, matched and inserted (`slam2d.md` §5), from a motion at the start that is given.

mod deskew;

use std::collections::VecDeque;
use std::sync::Arc;

use portolan_config::TrajectoryBuilder2dOptions;
use portolan_geometry::{
    Duration, Quaternion, Rigid2, Rigid3, Time, embed_3d, is_valid_pose, project_2d, to_f32, yaw,
};
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_motion::{MotionFilter, PoseExtrapolator};
use portolan_recall::Memory;
use portolan_sensor::{ImuData, OdometryData, PointCloud, RangeData, SynchronizedRanges};
use portolan_submaps::{Inserter2d, PlanarScan, Submap2d, search_after_gap};

use super::LocalSlamExtras;
use super::belief::{Belief, Fit};
use super::co_moving::CoMoving;
use super::dead_reckoning::DeadReckoning;
use super::gather::{Accumulation, GatheredScan, gravity_aligned, unwarp};
use super::motion::{Measured, Motion};
use super::scan::Scan;
use super::start::{NEAR, Role, Velocity};
use super::tracking::{Found, Tracker};
use crate::{
    ActiveSubmaps, InsertedNode, InsertionSubmap, LocalSlamError, Lost, MOST_GATHERED_POINTS, MatchingResult,
    NodeData, OdometryBridge, Planar, UsualAgreement, count_extrapolated, filtered, first_point_time,
    motion_filter, take_odometry,
};

/// An odometry source that reported nothing for so long is not waited for.
const ODOMETRY_TIMEOUT: Duration = Duration::from_ticks(50_000_000);

/// A velocity is given to predictions as the motion of so many seconds.
const SHORTLY: f64 = 0.1;

/// How much newer the newest scan may be than one that still waits for odometry.
const LONGEST_WAIT: Duration = Duration::from_ticks(20_000_000);

/// Finds scans one after the other and draws submaps of them.
pub(super) struct FrontEnd {
    options: TrajectoryBuilder2dOptions,
    extrapolator: Option<PoseExtrapolator>,
    extras: LocalSlamExtras,
    tracker: Tracker,
    belief: Belief,
    /// How scans agree with the map where they were found.
    usual_agreement: UsualAgreement,
    co_moving: CoMoving,
    /// The last pose that was sure, in the local map.
    last_sure: Rigid2,
    /// Where odometry says that the scanner went from there.
    reckoned: DeadReckoning,
    inserter: Arc<Inserter2d>,
    active_submaps: ActiveSubmaps<Planar>,
    motion_filter: MotionFilter,
    accumulated: Accumulation,
    /// Odometry that came before the first scan.
    waiting_odometry: VecDeque<OdometryData>,
    last_odometry_time: Option<Time>,
    /// Scans that wait for the odometry pose after them.
    waiting_ranges: VecDeque<SynchronizedRanges>,
    /// How the scanner moves when it begins.
    start_velocity: Velocity,
    /// A piece of map was begun that nothing measured ties to the one before.
    has_begun_anew: bool,
    /// What it does besides mapping.
    pub(super) role: Role,
    issues: IssueLog,
}

impl FrontEnd {
    /// Of a scanner that moves like this when it begins.
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
            inserter: Arc::new(Inserter2d::new(&options.submaps).map_err(|e| contradiction(&e))?),
            extrapolator: None,
            extras,
            belief: Belief::default(),
            usual_agreement: UsualAgreement::default(),
            co_moving: CoMoving::default(),
            last_sure: Rigid2::identity(),
            reckoned: DeadReckoning::from(Rigid2::identity()),
            tracker,
            active_submaps: no_submaps(options, &extras),
            motion_filter: motion_filter(&options.motion_filter),
            accumulated: Accumulation::default(),
            waiting_odometry: VecDeque::new(),
            last_odometry_time: None,
            waiting_ranges: VecDeque::new(),
            start_velocity,
            has_begun_anew: false,
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
        let waiting = &mut self.waiting_odometry;
        let velocity = self.start_velocity;
        self.extrapolator.get_or_insert_with(|| {
            let mut extrapolator = PoseExtrapolator::new(
                options.pose_queue_duration,
                options.imu_gravity_time_constant,
                use_all_odometry,
            );
            begin_anew(&mut extrapolator, time, Rigid3::identity(), velocity);
            for odometry in waiting.drain(..) {
                let _ = extrapolator.add_odometry(&odometry);
            }
            extrapolator
        })
    }

    /// Whether a scan had better wait: between two odometry poses the motion is known, beyond the last
    /// one it can only be guessed. A source that has fallen silent is not waited for.
    fn waits_for_odometry(&self, time: Time) -> bool {
        self.extras.use_all_odometry
            && self.last_odometry_time.is_some_and(|last| last < time && time - last <= ODOMETRY_TIMEOUT)
    }

    /// Matches the scans whose odometry has come, and those that waited too long.
    fn match_waiting(&mut self, newest: Time) -> Vec<MatchingResult<Planar>> {
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

    /// One synchronised set of ranges: unwarp, gather, and match when enough is together.
    fn add_synchronized(&mut self, ranges: &SynchronizedRanges) -> Option<MatchingResult<Planar>> {
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
        let last_pose =
            unwarp(ranges, |time| extrapolator.extrapolate_pose(time), &self.options, &mut self.accumulated);
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

    /// One whole scan in the gravity-aligned tracking frame: predict, match, insert.
    fn add_accumulated(
        &mut self,
        time: Time,
        gathered: &GatheredScan,
        gravity: Quaternion,
    ) -> Option<MatchingResult<Planar>> {
        let scan = &gathered.range_data;
        let aligned_from_scanner = gathered.aligned_from_scanner(&gravity);
        let marked = self.extras.adaptive_search.then(|| self.co_moving.mark(scan, aligned_from_scanner));
        let without = marked.as_ref().and_then(|marked| marked.without_co_moving(scan));
        if without.is_some() {
            self.count(IssueKind::ReturnsMoveAlong, time);
        }
        let scan = without.as_ref().unwrap_or(scan);
        if scan.returns.is_empty() {
            self.count(IssueKind::ScanWithoutReturn, time);
            return None;
        }
        let extrapolator = self.extrapolator.as_mut()?;
        let last_pose = extrapolator.last_pose();
        let measured = Measured::since_last_pose(extrapolator, time);
        let predicted = extrapolator.extrapolate_pose(time);
        let between_readings = extrapolator.between_readings(time);
        let matching_cloud = filtered(&scan.returns, &self.options.adaptive_voxel_filter);
        if matching_cloud.is_empty() {
            self.count(IssueKind::ScanWithoutReturnInRange, time);
            return None;
        }
        let prediction = project_2d(&(predicted * gravity.inverse()));
        let motion = last_pose.map(|(last_time, last)| Motion {
            last: project_2d(&(last * gravity.inverse())),
            seconds: time.seconds_since(last_time),
            measured,
            between_readings: between_readings.map(|pose| project_2d(&(pose * gravity.inverse()))),
            tracking_yaw: yaw(&gravity),
        });
        let found = self.find(time, prediction, motion, &matching_cloud, &scan.returns);
        if let Some(motion) = motion {
            let submap = self.active_submaps.matching_submap();
            let scan = submap.map(|submap| Scan::new(&matching_cloud, &scan.returns, submap));
            self.role.note(&self.tracker, (prediction, &found), motion, scan);
        }
        let fit = found.agreement.map(|agreement| Fit {
            agreement,
            is_measured: measured == Measured::Whole,
            looks_wrong: self.usual_agreement.looks_wrong(&agreement),
        });
        let is_refuted = found.is_far && fit.is_some_and(|fit| fit.is_measured && fit.looks_wrong);
        let pose = if found.pose.is_finite() && !is_refuted { found.pose } else { prediction };
        if !is_valid_pose(&(embed_3d(&pose) * gravity)) {
            self.count(IssueKind::ScanWithoutPose, time);
            return None;
        }
        let gap = motion.and_then(|motion| {
            Some((motion.seconds, self.tracker.bridge(motion, &prediction, found.agreement)?))
        });
        let is_unknown = motion.is_some_and(|motion| motion.is_unknown());
        self.belief = match gap {
            Some(_) => Belief::Sure,
            None if is_refuted || is_unknown && fit.is_some_and(|fit| fit.is_poor()) => {
                self.belief.after_guess(time)
            }
            None => self.belief.after(time, fit),
        };
        if let Some(motion) = &motion {
            let step = motion.of_tracking(&motion.to(&prediction));
            self.reckoned.add(motion, &step, self.tracker.sigmas(&step));
        }
        let at = |pose: &Rigid2| embed_3d(pose) * gravity;
        let (pose, lost) = match (gap, self.belief) {
            (Some(gap), _) => (prediction, Some(self.begin_after_gap(time, gap, at(&prediction)))),
            (None, Belief::Lost { since }) => self.begin_where_reckoned(since, time, &gravity),
            (None, Belief::Sure | Belief::Doubtful { .. }) => (pose, None),
        };
        if let (None, Belief::Sure, Some(marked)) = (&lost, self.belief, marked) {
            self.co_moving.learn(time, pose, marked);
        }
        let local_from_tracking = at(&pose);
        self.extrapolator.as_mut()?.add_pose(time, local_from_tracking);
        let range_data_in_local = scan.transformed(&to_f32(&embed_3d(&pose)));
        let inserted = if let Belief::Doubtful { .. } = self.belief {
            self.count(IssueKind::ScanContradictsMap, time);
            None
        } else {
            found.agreement.iter().for_each(|agreement| self.usual_agreement.add(agreement));
            (self.last_sure, self.reckoned) = (pose, DeadReckoning::from(project_2d(&local_from_tracking)));
            // On trial all motions draw as much.
            let is_drawn = self.role.is_trial() || !self.motion_filter.is_similar(time, &local_from_tracking);
            is_drawn.then(|| {
                let scans = [scan, &range_data_in_local];
                let inserted = self.insert(time, scans, matching_cloud, local_from_tracking, gravity);
                InsertedNode { agreement: found.agreement, ..inserted }
            })
        };
        let measured = Vec::new();
        Some(MatchingResult { time, local_from_tracking, range_data_in_local, measured, inserted, lost })
    }

    /// Ends the piece of map that nothing ties to what comes: the scanner is believed to stand at this pose of the tracking
    /// frame, and new submaps are drawn from there.
    fn begin_anew(&mut self, since: Time, time: Time, local_from_tracking: Rigid3) -> Lost<Planar> {
        let remaining = self.active_submaps.finish();
        self.active_submaps = no_submaps(&self.options, &self.extras);
        self.motion_filter = motion_filter(&self.options.motion_filter);
        self.co_moving = CoMoving::default();
        let nothing_tells = |e: &&mut PoseExtrapolator| !e.odometry_since_last_pose(time);
        if let Some(extrapolator) = self.extrapolator.as_mut().filter(nothing_tells) {
            begin_anew(extrapolator, time, local_from_tracking, Velocity::default());
            self.has_begun_anew = true;
            self.tracker.begin_anew();
        }
        Lost { since, remaining, ended_from_begun: Rigid3::identity(), bridge: None }
    }

    /// Ends the piece of map that scans do not fit any more: new submaps are drawn from where odometry says that the scanner is,
    /// or, where it says nothing, from where it was last seen.
    fn begin_where_reckoned(
        &mut self,
        since: Time,
        time: Time,
        gravity: &Quaternion,
    ) -> (Rigid2, Option<Lost<Planar>>) {
        let reckoned = self.reckoned.bridge();
        let pose = reckoned.map_or(self.last_sure, |(tracking, _)| Rigid2 {
            angle: tracking.angle - yaw(gravity),
            ..tracking
        });
        let lost = self.begin_anew(since, time, embed_3d(&pose) * *gravity);
        (pose, Some(Lost { bridge: reckoned.map(|(_, bridge)| bridge), ..lost }))
    }

    /// Ends the piece of map that odometry alone ties to what comes: new submaps are drawn from where it says that the
    /// scanner is.
    fn begin_after_gap(
        &mut self,
        time: Time,
        (seconds, bridge): (f64, OdometryBridge),
        local_from_tracking: Rigid3,
    ) -> Lost<Planar> {
        let since = time - Duration::from_seconds(seconds);
        Lost { bridge: Some(bridge), ..self.begin_anew(since, time, local_from_tracking) }
    }

    /// The pose of the scan in the local map.
    fn find(
        &mut self,
        time: Time,
        prediction: Rigid2,
        motion: Option<Motion>,
        cloud: &PointCloud,
        returns: &PointCloud,
    ) -> Found {
        self.tracker.note(time, &prediction, [cloud, returns]);
        let submap = self.active_submaps.matching_submap();
        let scan = submap.map(|submap| Scan::new(cloud, returns, submap));
        if let (true, Some(motion), Some(scan)) = (self.tracker.is_adaptive(), motion, scan) {
            let found = self.tracker.find(prediction, motion, scan);
            if found.is_far {
                self.count(IssueKind::ScanFarFromPrediction, time);
            }
            return found;
        }
        let unseen = motion.filter(|motion| !motion.is_rotation_measured());
        let prediction =
            unseen.and_then(|motion| self.found_after_gap(time, motion, cloud)).unwrap_or(prediction);
        let submap = self.active_submaps.matching_submap();
        let scan = submap.map(|submap| Scan::new(cloud, returns, submap));
        Found { pose: self.tracker.match_scan(prediction, scan, cloud), is_far: false, agreement: None }
    }

    /// Where the scan fits when time has passed with nothing measured: the old velocity tells nothing then.
    fn found_after_gap(&mut self, time: Time, motion: Motion, cloud: &PointCloud) -> Option<Rigid2> {
        if self.extras.wide_search_after_gap <= 0.0 || motion.seconds < self.extras.wide_search_after_gap {
            return None;
        }
        let submap = self.active_submaps.matching_submap()?;
        let found = search_after_gap(motion.last, motion.seconds, cloud, submap);
        let kind = match found {
            Some(_) => IssueKind::ScanAfterGapFound,
            None => IssueKind::ScanAfterGapNotFound,
        };
        self.count(kind, time);
        found
    }

    fn insert(
        &mut self,
        time: Time,
        [scan, range_data_in_local]: [&RangeData; 2],
        matching_cloud: PointCloud,
        local_from_tracking: Rigid3,
        gravity_alignment: Quaternion,
    ) -> InsertedNode<Planar> {
        let resolution = f64::from(self.options.submaps.grid_options_2d.resolution);
        let inserter = &self.inserter;
        let submaps = self
            .active_submaps
            .insert(range_data_in_local, |origin| Submap2d::new(origin, resolution, inserter).ok());
        let data = Arc::new(NodeData {
            time,
            gravity_alignment,
            filtered_gravity_aligned_point_cloud: matching_cloud,
            high_resolution_point_cloud: PointCloud::default(),
            low_resolution_point_cloud: PointCloud::default(),
            rotational_scan_matcher_histogram: Vec::new(),
            local_from_tracking,
            scan: self.extras.keep_scans.then(|| PlanarScan::new(scan)),
        });
        InsertedNode { data, submaps, open: Default::default(), agreement: None }
    }

    /// Takes scans of all sensors at one time. Gives what became of scans whose turn has come.
    pub fn add_ranges(&mut self, ranges: SynchronizedRanges) -> Vec<MatchingResult<Planar>> {
        let newest = ranges.time;
        self.waiting_ranges.push_back(ranges);
        self.match_waiting(newest)
    }

    /// Takes an IMU sample.
    pub fn add_imu(&mut self, data: &ImuData) {
        if !self.options.use_imu_data {
            return;
        }
        let extrapolator = self.start_extrapolator(data.time);
        if extrapolator.add_imu(data).is_err() {
            self.count(IssueKind::ImuSampleTooOld, data.time);
        }
    }

    /// Takes an odometry pose. Gives what became of scans that waited for it.
    pub fn add_odometry(&mut self, data: &OdometryData) -> Vec<MatchingResult<Planar>> {
        if !take_odometry(data, self.extrapolator.as_mut(), &mut self.waiting_odometry) {
            self.count(IssueKind::OdometryTooOld, data.time);
        }
        self.last_odometry_time = self.last_odometry_time.max(Some(data.time));
        self.match_waiting(data.time)
    }

    /// Matches what still waits for odometry that will not come.
    pub fn flush(&mut self) -> Vec<MatchingResult<Planar>> {
        self.last_odometry_time = None;
        self.match_waiting(Time::MAX)
    }

    /// Remembers where scans were found with this.
    pub fn remember_with(&mut self, memory: &Memory) {
        self.tracker.remember_with(memory);
    }

    /// Hands over the submaps that were being filled.
    pub fn finish(&mut self) -> Vec<InsertionSubmap<Planar>> {
        self.active_submaps.finish()
    }

    /// Copies of the submaps that are being filled, with their indices.
    pub fn active_submaps(&self) -> Vec<(u32, Submap2d)> {
        self.active_submaps.iter().map(|(index, submap)| (index, submap.clone())).collect()
    }

    /// Since when scans have fitted nothing where they were looked for, if the last ones do not and it is a guess.
    pub fn lost_since(&self) -> Option<Time> {
        match self.belief {
            Belief::Doubtful { since, is_elsewhere: true, .. } => Some(since),
            Belief::Sure | Belief::Doubtful { .. } | Belief::Lost { .. } => None,
        }
    }

    /// What was dropped or repaired so far.
    pub fn issues(&self) -> IssueLog {
        let mut issues = self.issues.clone();
        self.active_submaps.count_into(&mut issues);
        if let Some(extrapolator) = &self.extrapolator {
            count_extrapolated(&extrapolator.counts(), &mut issues);
        }
        issues
    }

    /// Whether scans are searched as far as predictions were wrong lately.
    pub fn is_adaptive(&self) -> bool {
        self.tracker.is_adaptive()
    }

    /// Whether, since this was asked last, a piece of map was begun that nothing measured ties to the one before.
    pub fn take_begun_anew(&mut self) -> bool {
        std::mem::take(&mut self.has_begun_anew)
    }

    /// Says how the scanner moves when it begins, seen from where it begins, or, where it has, from the last pose.
    pub fn set_velocity(&mut self, velocity: Velocity) {
        self.start_velocity = velocity;
        if let Some(extrapolator) = &mut self.extrapolator
            && let Some((time, pose)) = extrapolator.last_pose()
        {
            begin_anew(extrapolator, time, pose, velocity);
        }
    }
}

/// Predictions go on from a pose with this velocity, seen from there.
fn begin_anew(
    extrapolator: &mut PoseExtrapolator,
    time: Time,
    local_from_tracking: Rigid3,
    velocity: Velocity,
) {
    let motion = embed_3d(&velocity.motion(SHORTLY));
    extrapolator.begin_anew(time, local_from_tracking, &motion, SHORTLY);
}

fn no_submaps(options: &TrajectoryBuilder2dOptions, extras: &LocalSlamExtras) -> ActiveSubmaps<Planar> {
    let scans_per_half = u32::try_from(options.submaps.num_range_data).unwrap_or(1);
    ActiveSubmaps::new(scans_per_half).with_length(extras.submap_length)
}

#[cfg(test)]
mod tests;
