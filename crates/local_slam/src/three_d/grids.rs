//! The grid engine, as Cartographer's local SLAM (`slam3d.md` §1): sweeps are matched to the hybrid grids of the older
//! submap.

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::{Quaternion, Rigid3, Time, interpolate, is_valid_pose};
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_lidar_odometry::Issue as OdometryIssue;
use portolan_lidar_odometry::settings::{ExtrapolatorSettings, InitialisationSettings};
use portolan_motion::{
    Beginning, ExtrapolatorCounts, GravityInitialisation, MotionFilter, Observability, PoseExtrapolator,
    WaitingSweeps,
};
use portolan_recall::Memory;
use portolan_sensor::{ImuData, OdometryData, PointCloud, RangeData};

use super::LocalSlam3dSettings;
use super::deskew::{Deskewed, Gathered, deskew, raw_sweep};
use super::grid_matcher::GridMatcher;
use super::keyframe_insertion::{KeyframeInsertion, KeyframeScan};
use super::planes::extrapolator_settings;
use crate::motion_filter;
use crate::remembered_scans::RememberedScans;
use crate::{MatchingResult, Space3d};

/// Number of times that a scan without an IMU is de-skewed again with its matched pose.
const DESKEWING_PASSES: u32 = 2;

/// Local SLAM by matching to hybrid grids.
pub(super) struct GridEngine {
    options: TrajectoryBuilder3dOptions,
    extrapolator_settings: ExtrapolatorSettings,
    initialisation: GravityInitialisation,
    /// None before the trajectory begins.
    extrapolator: Option<PoseExtrapolator>,
    has_imu: bool,
    matcher: GridMatcher,
    motion_filter: MotionFilter,
    remembered: RememberedScans,
}

/// A scan that was matched.
struct MatchedScan {
    local_from_tracking: Rigid3,
    /// In the tracking frame, down-sampled.
    scan: RangeData,
    /// The fine and the coarse cloud.
    clouds: [PointCloud; 2],
}

impl GridEngine {
    pub fn new(
        options: &TrajectoryBuilder3dOptions,
        settings: &LocalSlam3dSettings,
        matcher: GridMatcher,
    ) -> Self {
        Self {
            extrapolator_settings: extrapolator_settings(options, settings),
            initialisation: GravityInitialisation::of_one_sample(
                InitialisationSettings::default().leveling_time,
            ),
            extrapolator: None,
            has_imu: false,
            matcher,
            motion_filter: motion_filter(&options.motion_filter),
            remembered: RememberedScans::default(),
            options: options.clone(),
        }
    }

    pub fn begin_if_ready(&mut self, waiting: Option<&WaitingSweeps>, issues: &mut IssueLog) -> bool {
        if self.extrapolator.is_none() && self.initialisation.is_ready(waiting) {
            self.begin(waiting, issues);
        }
        self.extrapolator.is_some()
    }

    pub fn begin(&mut self, waiting: Option<&WaitingSweeps>, issues: &mut IssueLog) {
        if self.extrapolator.is_some() {
            return;
        }
        let extrapolator = self.extrapolator_settings.extrapolator();
        let Some(Beginning { extrapolator, imu }) = self.initialisation.begin(extrapolator, waiting) else {
            return;
        };
        self.has_imu = !imu.is_empty();
        self.extrapolator = Some(extrapolator);
        imu.iter().skip(1).for_each(|data| self.add_imu(data, issues));
    }

    pub fn last_pose_time(&self) -> Option<Time> {
        self.extrapolator.as_ref().and_then(PoseExtrapolator::last_pose_time)
    }

    pub fn add_imu(&mut self, data: &ImuData, issues: &mut IssueLog) {
        let issue = match &mut self.extrapolator {
            None => self.initialisation.add_imu(data).err().map(OdometryIssue::of_imu_sample),
            Some(extrapolator) => match extrapolator.add_imu(data) {
                Err(_) => Some(OdometryIssue::ImuSampleTooOld),
                Ok(()) => (!self.has_imu).then_some(OdometryIssue::ImuAfterStart),
            },
        };
        issue.into_iter().for_each(|issue| count(issues, issue.kind(), data.time));
    }

    pub fn add_odometry(&mut self, data: &OdometryData, issues: &mut IssueLog) {
        match &mut self.extrapolator {
            None => self.initialisation.add_odometry(data),
            Some(extrapolator) => {
                if extrapolator.add_odometry(data).is_err() {
                    count(issues, IssueKind::OdometryTooOld, data.time);
                }
            }
        }
    }

    pub fn remember_with(&mut self, memory: &Memory) {
        self.remembered = RememberedScans::new(memory);
    }

    pub fn extrapolator_counts(&self) -> ExtrapolatorCounts {
        self.extrapolator.as_ref().map(PoseExtrapolator::counts).unwrap_or_default()
    }

    /// Processes one whole sweep: de-skews, down-samples, matches and inserts it.
    pub fn add_sweep(
        &mut self,
        end: Time,
        gathered: &[Gathered],
        insertion: &mut KeyframeInsertion,
        issues: &mut IssueLog,
    ) -> Option<MatchingResult<Space3d>> {
        let extrapolator = self.extrapolator.as_mut()?;
        extrapolator.prepare(end);
        let last = extrapolator.last_pose();
        let start = extrapolator.last_extrapolated_time().unwrap_or(Time::MIN);
        let deskewed = deskew(gathered, start, |t| extrapolator.extrapolate_pose(t), &self.options);
        let prediction = extrapolator.extrapolate_pose(end);
        let measured_gravity = self.has_imu.then(|| extrapolator.estimate_gravity_orientation(end));
        if deskewed.times_raised > 0 {
            count(issues, IssueKind::ScanPointsTooOld, end);
        }
        let mut matched = self.match_deskewed((end, &deskewed), &prediction, insertion, issues)?;
        if let Some((last_time, last_pose)) = last.filter(|_| !self.has_imu && insertion.has_submap()) {
            // The motion during the sweep is known only after matching.
            for _ in 0..DESKEWING_PASSES {
                let found = matched.local_from_tracking;
                let interpolated =
                    |t: Time| interpolate(last_time, &last_pose, end, &found, t.clamp(last_time, end));
                let deskewed = deskew(gathered, last_time, interpolated, &self.options);
                matched = self.match_deskewed((end, &deskewed), &found, insertion, issues).unwrap_or(matched);
            }
        }
        self.extrapolator.as_mut()?.add_pose(end, matched.local_from_tracking);
        let result = self.insert(end, matched, measured_gravity, insertion);
        Some(MatchingResult { measured: raw_sweep(gathered, end, &self.options).points, ..result })
    }

    /// Down-samples a de-skewed sweep and matches it near a predicted pose.
    fn match_deskewed(
        &mut self,
        (end, deskewed): (Time, &Deskewed),
        prediction: &Rigid3,
        insertion: &KeyframeInsertion,
        issues: &mut IssueLog,
    ) -> Option<MatchedScan> {
        let scan = deskewed.in_tracking(prediction, self.options.voxel_filter_size);
        if scan.returns.is_empty() {
            count(issues, IssueKind::ScanWithoutReturn, end);
            return None;
        }
        let [high, low] = insertion.clouds(&scan.returns);
        if high.is_empty() || low.is_empty() {
            count(issues, IssueKind::ScanWithoutReturnInRange, end);
            return None;
        }
        let (submap, matcher) = (insertion.submaps.matching_submap(), self.matcher.with_imu(self.has_imu));
        self.remembered.note(end, prediction, [&high, &low]);
        let matched =
            self.remembered.answer(*prediction, || matcher.match_scan(prediction, [&high, &low], submap).0);
        let local_from_tracking = if is_valid_pose(&matched) { matched } else { *prediction };
        if !is_valid_pose(&local_from_tracking) {
            count(issues, IssueKind::ScanWithoutPose, end);
            return None;
        }
        Some(MatchedScan { local_from_tracking, scan, clouds: [high, low] })
    }

    /// Inserts the scan as a node if it is different enough from the last one.
    fn insert(
        &mut self,
        time: Time,
        matched: MatchedScan,
        measured_gravity: Option<Quaternion>,
        insertion: &mut KeyframeInsertion,
    ) -> MatchingResult<Space3d> {
        let MatchedScan { local_from_tracking, scan, clouds } = matched;
        if self.motion_filter.is_similar(time, &local_from_tracking) {
            let local = portolan_geometry::to_f32(&local_from_tracking);
            return MatchingResult::not_inserted(time, local_from_tracking, scan.transformed(&local));
        }
        insertion.insert(KeyframeScan {
            time,
            local_from_tracking,
            // Without an IMU the first pose was level, and z of the local map has pointed up ever since.
            gravity_from_tracking: measured_gravity.unwrap_or(local_from_tracking.rotation),
            scan,
            clouds: Some(clouds),
            open: Observability::default(),
            completed_map: None,
        })
    }
}

fn count(issues: &mut IssueLog, kind: IssueKind, time: Time) {
    issues.add(Issue::new(kind).at(time));
}
