//! Processes one whole scan: prediction, matching, acceptance or rejection, insertion.

use std::sync::Arc;

use portolan_geometry::{Quaternion, Rigid2, Rigid3, Time, embed_3d, is_valid_pose, project_2d, to_f32, yaw};
use portolan_issue::IssueKind;
use portolan_sensor::{PointCloud, RangeData, voxel_filter};
use portolan_submaps::{KeptScan2d, Submap2d, search_after_gap};

use super::super::co_moving::Marked;
use super::super::dead_reckoning::DeadReckoning;
use super::super::gather::GatheredScan;
use super::super::motion::{Measured, Motion};
use super::super::occlusion::View;
use super::super::pose_status::{Fit, PoseStatus};
use super::super::scan::Scan;
use super::super::tracking::{Degeneracy, Found};
use super::FrontEnd;
use crate::{InsertedNode, Lost, MatchingResult, NodeData, Space2d, filtered};

/// A scan and its predicted pose.
pub(super) struct Expected<'a> {
    /// In the gravity-aligned tracking frame.
    scan: &'a RangeData,
    /// The returns that are matched, filtered.
    cloud: PointCloud,
    /// In the local map.
    pub prediction: Rigid2,
    /// Since the scan before.
    pub motion: Option<Motion>,
}

impl FrontEnd {
    /// Processes one whole scan in the gravity-aligned tracking frame.
    pub(super) fn add_accumulated(
        &mut self,
        time: Time,
        gathered: &GatheredScan,
        gravity: Quaternion,
    ) -> Option<MatchingResult<Space2d>> {
        // 1. Leave out returns of objects that move along with the scanner.
        let (marked, without) = self.without_co_moving(time, gathered, &gravity);
        let scan = without.as_ref().unwrap_or(&gathered.range_data);
        // 2. Predict.
        let expected = self.expected(time, scan, &gravity)?;
        // 3. Leave out returns that occlude the mapped surroundings.
        let (view, clear) = self.view(time, &expected);
        if view == View::Nothing {
            return self.carried_by_odometry(time, &expected, gravity);
        }
        let scan = clear.as_ref().unwrap_or(scan);
        let expected = match &clear {
            Some(clear) => Expected { scan, cloud: self.to_be_matched(&clear.returns), ..expected },
            None => expected,
        };
        // 4. Match.
        let found = self.find(time, &expected);
        self.note_for_role(&expected, &found);
        self.record_degeneracy(time, &expected, &found);
        // 5. Accept the match, or begin a new piece of map.
        let (pose, lost) = self.accepted_pose(time, &expected, &found, &gravity)?;
        if let (None, PoseStatus::Confirmed, Some(marked)) = (&lost, self.status, marked) {
            self.co_moving.learn(time, pose, marked);
        }
        let local_from_tracking = embed_3d(&pose) * gravity;
        self.extrapolator.as_mut()?.add_pose(time, local_from_tracking);
        let measures_position = found.measures_position && self.status == PoseStatus::Confirmed;
        self.level.add_pose(time, &local_from_tracking, measures_position);
        // 6. Insert.
        let range_data_in_local = scan.transformed(&to_f32(&embed_3d(&pose)));
        let inserted = if let PoseStatus::Suspect { .. } = self.status {
            self.count(IssueKind::ScanContradictsMap, time);
            None
        } else {
            found.agreement.iter().for_each(|agreement| self.tracker.record_agreement(agreement));
            (self.last_confirmed, self.reckoned) =
                (pose, DeadReckoning::from(project_2d(&local_from_tracking)));
            // On trial every motion hypothesis inserts the same number of scans.
            let is_drawn = self.role.is_trial() || !self.motion_filter.is_similar(time, &local_from_tracking);
            is_drawn.then(|| {
                let scans = [scan, &range_data_in_local];
                let inserted = self.insert(time, scans, expected.cloud, local_from_tracking, gravity);
                InsertedNode { agreement: found.agreement, ..inserted }
            })
        };
        let measured = Vec::new();
        Some(MatchingResult { time, local_from_tracking, range_data_in_local, measured, inserted, lost })
    }

    /// Marks the returns that move along with the scanner. Gives the scan without them, if there are any.
    fn without_co_moving(
        &mut self,
        time: Time,
        gathered: &GatheredScan,
        gravity: &Quaternion,
    ) -> (Option<Marked>, Option<RangeData>) {
        let scan = &gathered.range_data;
        let aligned_from_scanner = gathered.aligned_from_scanner(gravity);
        let marked = self.extras.adaptive_search.then(|| self.co_moving.mark(scan, aligned_from_scanner));
        let without = marked.as_ref().and_then(|marked| marked.without_co_moving(scan));
        if without.is_some() {
            self.count(IssueKind::ReturnsMoveAlong, time);
        }
        (marked, without)
    }

    /// The scan with its predicted pose; none before the first sensor that allows a prediction.
    fn expected<'a>(
        &mut self,
        time: Time,
        scan: &'a RangeData,
        gravity: &Quaternion,
    ) -> Option<Expected<'a>> {
        let extrapolator = self.extrapolator.as_mut()?;
        let last_pose = extrapolator.last_pose();
        let measured = Measured::since_last_pose(extrapolator, time);
        let predicted = extrapolator.extrapolate_pose(time);
        let between_readings = extrapolator.between_readings(time);
        let cloud = self.to_be_matched(&scan.returns);
        let pose_2d = |pose: Rigid3| project_2d(&(pose * gravity.inverse()));
        let motion = last_pose.map(|(last_time, last)| Motion {
            last: pose_2d(last),
            seconds: time.seconds_since(last_time),
            measured,
            between_readings: between_readings.map(pose_2d),
            tracking_yaw: yaw(gravity),
        });
        Some(Expected { scan, cloud, prediction: pose_2d(predicted), motion })
    }

    /// How much of the mapped surroundings a scan sees, and the scan without occluding returns if they
    /// hide a part. Occlusion is counted as an issue.
    fn view(&mut self, time: Time, expected: &Expected) -> (View, Option<RangeData>) {
        let Expected { scan, cloud, prediction, motion } = expected;
        if cloud.is_empty() {
            self.count(without_return(scan), time);
            return (View::Nothing, None);
        }
        // On trial the motion is a hypothesis that the scan may refute, and so is a pose that is not yet
        // accepted.
        let is_confirmed = !self.role.is_trial() && self.status == PoseStatus::Confirmed;
        let is_judged = self.tracker.is_adaptive() && is_confirmed;
        let (true, Some(motion), Some(submap)) = (is_judged, motion, self.active_submaps.matching_submap())
        else {
            return (View::Clear, None);
        };
        let (view, clear) = self.tracker.view(*prediction, *motion, &Scan::new(cloud, &scan.returns, submap));
        match view {
            View::Clear => {}
            View::Part => self.count(IssueKind::ReturnsOcclude, time),
            View::Nothing => self.count(IssueKind::ScanOccluded, time),
        }
        let RangeData { origin, misses, .. } = scan;
        (view, clear.map(|returns| RangeData { origin: *origin, returns, misses: misses.clone() }))
    }

    /// The pose of a scan without returns, from odometry; none where odometry does not measure it.
    pub(super) fn carried_without_returns(
        &mut self,
        time: Time,
        gravity: Quaternion,
    ) -> Option<MatchingResult<Space2d>> {
        let nothing = RangeData::default();
        let expected = self.expected(time, &nothing, &gravity)?;
        self.carried_by_odometry(time, &expected, gravity)
    }

    /// The pose of a scan that is occluded, from odometry; none where odometry does not measure it. The
    /// scan is not inserted, and the next scan is searched from the last one that was not occluded.
    fn carried_by_odometry(
        &self,
        time: Time,
        Expected { scan, prediction, motion, .. }: &Expected,
        gravity: Quaternion,
    ) -> Option<MatchingResult<Space2d>> {
        let motion = motion.filter(|motion| self.tracker.is_adaptive() && motion.is_measured())?;
        let pose = embed_3d(&self.tracker.pose_by_odometry(*prediction, &motion));
        let local_from_tracking = pose * gravity;
        let origin = to_f32(&pose) * scan.origin;
        let range_data_in_local = RangeData { origin, ..RangeData::default() };
        is_valid_pose(&local_from_tracking)
            .then(|| MatchingResult::not_inserted(time, local_from_tracking, range_data_in_local))
    }

    /// The returns of a scan that are matched. Returns in one cell of the map carry the same information,
    /// so only one of them counts. Otherwise a person close by, hit by a third of the beams, would
    /// outweigh all static surroundings.
    fn to_be_matched(&self, returns: &PointCloud) -> PointCloud {
        let options = &self.options.adaptive_voxel_filter;
        if !self.extras.adaptive_search {
            return filtered(returns, options);
        }
        filtered(&voxel_filter(returns, self.options.submaps.grid_options_2d.resolution), options)
    }

    /// The pose of the scan in the local map.
    fn find(&mut self, time: Time, expected: &Expected) -> Found {
        let Expected { cloud, prediction, motion, .. } = expected;
        let returns = &expected.scan.returns;
        self.tracker.note(time, prediction, [cloud, returns]);
        let submap = self.active_submaps.matching_submap();
        let scan = submap.map(|submap| Scan::new(cloud, returns, submap));
        if let (true, Some(motion), Some(scan)) = (self.tracker.is_adaptive(), motion, scan) {
            let found = self.tracker.find(*prediction, *motion, scan);
            if found.is_far {
                self.count(IssueKind::ScanFarFromPrediction, time);
            }
            if found.overrules_odometry {
                self.count(IssueKind::OdometryOverruled, time);
            }
            return found;
        }
        let unseen = motion.filter(|motion| !motion.is_rotation_measured());
        let prediction =
            unseen.and_then(|motion| self.found_after_gap(time, motion, cloud)).unwrap_or(*prediction);
        let submap = self.active_submaps.matching_submap();
        let scan = submap.map(|submap| Scan::new(cloud, returns, submap));
        let pose = self.tracker.match_scan(prediction, scan, cloud);
        Found {
            pose,
            is_far: false,
            overrules_odometry: false,
            measures_position: true,
            degeneracy: Degeneracy::None,
            agreement: None,
        }
    }

    /// The pose where the scan fits after a time without measurements, when the previous velocity is no
    /// longer valid.
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

    fn note_for_role(&mut self, expected: &Expected, found: &Found) {
        let Some(motion) = expected.motion else { return };
        let submap = self.active_submaps.matching_submap();
        let scan = submap.map(|submap| Scan::new(&expected.cloud, &expected.scan.returns, submap));
        self.role.note(&self.tracker, (expected.prediction, found), motion, scan);
    }

    /// The accepted pose in the local map, and the end of the piece of map if a new one begins; none if
    /// the pose is invalid.
    fn accepted_pose(
        &mut self,
        time: Time,
        Expected { prediction, motion, .. }: &Expected,
        found: &Found,
        gravity: &Quaternion,
    ) -> Option<(Rigid2, Option<Lost<Space2d>>)> {
        let fit = found.agreement.map(|agreement| Fit {
            agreement,
            is_measured: motion.is_some_and(|motion| motion.is_measured()),
            looks_wrong: self.tracker.looks_wrong(&agreement),
        });
        let is_refuted = found.is_far && fit.is_some_and(|fit| fit.is_measured && fit.looks_wrong);
        let pose = if found.pose.is_finite() && !is_refuted { found.pose } else { *prediction };
        let at = |pose: &Rigid2| embed_3d(pose) * *gravity;
        if !is_valid_pose(&at(&pose)) {
            self.count(IssueKind::ScanWithoutPose, time);
            return None;
        }
        let gap = motion.and_then(|motion| {
            Some((motion.seconds, self.tracker.bridge(motion, prediction, found.agreement)?))
        });
        let is_unknown = motion.is_some_and(|motion| motion.is_unknown());
        let is_guess = is_refuted || is_unknown && fit.is_some_and(|fit| fit.is_poor());
        self.status = match gap {
            Some(_) => PoseStatus::Confirmed,
            None if is_guess => self.status.after_guess(time),
            None => self.status.after(time, fit),
        };
        if let Some(motion) = motion {
            let step = motion.of_tracking(&motion.to(prediction));
            self.reckoned.add(motion, &step, self.tracker.sigmas(&step));
        }
        Some(match (gap, self.status) {
            (Some(gap), _) => (*prediction, Some(self.begin_after_gap(time, gap, at(prediction)))),
            (None, PoseStatus::Lost { since }) => self.begin_at_dead_reckoning(since, time, gravity),
            (None, PoseStatus::Confirmed | PoseStatus::Suspect { .. }) => (pose, None),
        })
    }

    fn insert(
        &mut self,
        time: Time,
        [scan, range_data_in_local]: [&RangeData; 2],
        matching_cloud: PointCloud,
        local_from_tracking: Rigid3,
        gravity_alignment: Quaternion,
    ) -> InsertedNode<Space2d> {
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
            scan: self.extras.keep_scans.then(|| KeptScan2d::new(scan)),
        });
        InsertedNode { gathered: self.gathered, ..InsertedNode::new(data, submaps) }
    }
}

/// Issue to report for a scan of which nothing can be matched.
fn without_return(scan: &RangeData) -> IssueKind {
    if scan.returns.is_empty() { IssueKind::ScanWithoutReturn } else { IssueKind::ScanWithoutReturnInRange }
}
