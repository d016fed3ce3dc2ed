//! Makes nodes of registered key frames, and inserts them into the active submaps.

use std::sync::Arc;

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::{Point3f, Quaternion, Rigid3, Time, to_f32};
use portolan_issue::IssueLog;
use portolan_lidar_odometry::{Later, PlaneMap, is_worth_a_thread};
use portolan_matching::rotational_histogram;
use portolan_motion::Observability;
use portolan_sensor::{PointCloud, RangeData};
use portolan_submaps::{Inserter3d, Scan3d, Submap3d};

use crate::{ActiveSubmaps, filtered};
use crate::{InsertedNode, InsertionSubmap, MatchingResult, NodeData, Space3d};

/// A registered sweep that is a key frame.
pub(super) struct KeyframeScan {
    pub time: Time,
    pub local_from_tracking: Rigid3,
    /// From the tracking frame to a gravity-aligned one.
    pub gravity_from_tracking: Quaternion,
    /// In the tracking frame, down-sampled.
    pub scan: RangeData,
    /// The fine and the coarse cloud, if they were needed for matching.
    pub clouds: Option<[PointCloud; 2]>,
    /// Directions of motion that it constrains.
    pub open: Observability,
    /// The planar voxel map that it completed, together with the older submap.
    pub completed_map: Option<PlaneMap>,
}

/// Ratio of the time for a point of a histogram to that for inserting a point into a voxel.
const WORK_PER_POINT: usize = 4;

/// Makes nodes and fills submaps.
pub(super) struct KeyframeInsertion {
    options: TrajectoryBuilder3dOptions,
    inserter: Arc<Inserter3d>,
    pub submaps: ActiveSubmaps<Space3d>,
    /// Issues of submaps of earlier pieces of map.
    issues: IssueLog,
}

impl KeyframeInsertion {
    pub fn new(options: &TrajectoryBuilder3dOptions, inserter: Inserter3d) -> Self {
        Self {
            submaps: ActiveSubmaps::new(keyframes_per_half(options)),
            inserter: Arc::new(inserter),
            options: options.clone(),
            issues: IssueLog::default(),
        }
    }

    /// Whether there is a submap yet.
    pub fn has_submap(&self) -> bool {
        self.submaps.matching_submap().is_some()
    }

    /// Makes a node of a key frame and inserts it.
    pub fn insert(&mut self, keyframe: KeyframeScan) -> MatchingResult<Space3d> {
        let KeyframeScan { time, local_from_tracking, scan, open, .. } = keyframe;
        let gravity = keyframe.gravity_from_tracking;
        let scan = Arc::new(scan);
        let histogram = self.histogram(&scan, gravity);
        let [high, low] = keyframe.clouds.unwrap_or_else(|| self.clouds(&scan.returns));
        let data = NodeData {
            time,
            gravity_alignment: gravity,
            filtered_gravity_aligned_point_cloud: PointCloud::default(),
            high_resolution_point_cloud: high,
            low_resolution_point_cloud: low,
            rotational_scan_matcher_histogram: std::mem::take(&mut *histogram.now()),
            local_from_tracking,
            scan: None,
        };
        let range_data_in_local = scan.transformed(&to_f32(&local_from_tracking));
        let submaps = self.insert_into_submaps(&range_data_in_local, &data, keyframe.completed_map);
        MatchingResult {
            time,
            local_from_tracking,
            range_data_in_local,
            measured: Vec::new(),
            inserted: Some(InsertedNode { open, ..InsertedNode::new(Arc::new(data), submaps) }),
            lost: None,
        }
    }

    fn insert_into_submaps(
        &mut self,
        range_data_in_local: &RangeData,
        data: &NodeData,
        completed_map: Option<PlaneMap>,
    ) -> Vec<InsertionSubmap<Space3d>> {
        // Normalised: with grids the next poses follow from that of the submap, and an error would double
        // with each.
        let rotation = data.local_from_tracking.rotation * data.gravity_alignment.inverse();
        let local_from_gravity_aligned = Quaternion::new_normalize(rotation.into_inner());
        let scan = Scan3d {
            range_data_in_local: range_data_in_local.clone(),
            rotational_histogram: data.rotational_scan_matcher_histogram.clone(),
            local_from_gravity_aligned,
        };
        if let (Some(planes), Some(oldest)) = (completed_map, self.submaps.matching_submap_mut()) {
            oldest.planes = Some(planes);
        }
        let inserter = &self.inserter;
        self.submaps
            .insert(&scan, |origin: Point3f| Submap3d::new(origin, local_from_gravity_aligned, inserter).ok())
    }

    /// The fine and the coarse cloud of a scan.
    pub fn clouds(&self, returns: &PointCloud) -> [PointCloud; 2] {
        clouds(returns, &self.options)
    }

    /// The histogram of a scan in the tracking frame, computed in another thread if there is enough work.
    fn histogram(&self, scan: &Arc<RangeData>, gravity_alignment: Quaternion) -> Later<Vec<f32>> {
        let (scan, size) = (Arc::clone(scan), self.options.rotational_histogram_size);
        let work = WORK_PER_POINT * scan.returns.len();
        let count = move |histogram: &mut Vec<f32>| {
            let level = Rigid3::from_parts(Default::default(), gravity_alignment);
            *histogram = rotational_histogram(&scan.returns.transformed(&to_f32(&level)), size);
        };
        let histogram = Later::new(Vec::new());
        match is_worth_a_thread(work) {
            true => histogram.change(count),
            false => count(&mut histogram.now()),
        }
        histogram
    }

    /// Ends a piece of map as [`Self::finish`] does, and begins a new one.
    pub fn restart(&mut self, maps: impl Iterator<Item = PlaneMap>) -> Vec<InsertionSubmap<Space3d>> {
        let remaining = self.finish(maps);
        self.submaps.count_into(&mut self.issues);
        self.submaps = ActiveSubmaps::new(keyframes_per_half(&self.options));
        remaining
    }

    /// Adds the issues of scans that could not be inserted.
    pub fn count_into(&self, issues: &mut IssueLog) {
        issues.append(&self.issues);
        self.submaps.count_into(issues);
    }

    /// Ends the trajectory. `maps` are the planar voxel maps of the active submaps, oldest first.
    pub fn finish(&mut self, maps: impl Iterator<Item = PlaneMap>) -> Vec<InsertionSubmap<Space3d>> {
        self.submaps.iter_mut().zip(maps).for_each(|(submap, planes)| submap.planes = Some(planes));
        self.submaps.finish()
    }
}

/// Number of key frames after which a submap is half full.
pub(super) fn keyframes_per_half(options: &TrajectoryBuilder3dOptions) -> u32 {
    u32::try_from(options.submaps.num_range_data).unwrap_or(1)
}

/// The fine and the coarse cloud of a scan.
pub(super) fn clouds(returns: &PointCloud, options: &TrajectoryBuilder3dOptions) -> [PointCloud; 2] {
    [
        filtered(returns, &options.high_resolution_adaptive_voxel_filter),
        filtered(returns, &options.low_resolution_adaptive_voxel_filter),
    ]
}
