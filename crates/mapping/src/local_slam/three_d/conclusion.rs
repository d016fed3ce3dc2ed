//! What becomes of a scan that was matched: a node, and more in the active submaps.

use std::sync::Arc;

use portolan_geometry::{Point3f, Quaternion, Rigid3, Time, to_f32};
use portolan_matching::rotational_histogram;
use portolan_sensor::{PointCloud, RangeData, voxel_filter};

use super::{LocalSlam3d, MatchedScan};
use crate::local_slam::two_d::filtered;
use crate::submap_3d::{Scan3d, Submap3d};
use crate::{InsertedNode, MatchingResult, NodeData, OpenDirections, Spatial};

/// Seconds from one scan that is inserted to the next while it stands: at first, doubled with each, at most.
const STANDING_INTERVAL: f64 = 2.0;
const LONGEST_STANDING_INTERVAL: f64 = 16.0;

/// Whether a scan is inserted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    Yes,
    /// If the scanner moved or time passed since the last one.
    IfMoved,
    No,
}

impl LocalSlam3d {
    /// Makes a node of a matched scan and inserts it, if it is different enough from the last one.
    pub(super) fn conclude(
        &mut self,
        time: Time,
        matched: MatchedScan,
        measured_gravity: Option<Quaternion>,
    ) -> MatchingResult<Spatial> {
        self.conclude_as(Wanted::IfMoved, time, matched, measured_gravity)
    }

    /// Whether a scan was inserted so short a time ago that one from where it stands tells nothing new yet: the
    /// longer it stands the longer that is.
    pub(super) fn stands_since_inserted(&self, time: Time) -> bool {
        let interval =
            (STANDING_INTERVAL * 2_f64.powi(self.inserted_standing.min(8))).min(LONGEST_STANDING_INTERVAL);
        self.last_inserted.is_some_and(|last| time.seconds_since(last) < interval)
    }

    /// The same for a scan that is wanted more or less.
    pub(super) fn conclude_as(
        &mut self,
        wanted: Wanted,
        time: Time,
        matched: MatchedScan,
        measured_gravity: Option<Quaternion>,
    ) -> MatchingResult<Spatial> {
        let MatchedScan { local_from_tracking, scan, clouds, open } = matched;
        let local = to_f32(&local_from_tracking);
        let is_inserted = wanted != Wanted::No
            && (!self.motion_filter.is_similar(time, &local_from_tracking) || wanted == Wanted::Yes);
        if !is_inserted {
            let range_data_in_local = scan.transformed(&local);
            if wanted != Wanted::No {
                self.insert_surfaces(&range_data_in_local);
            }
            return MatchingResult {
                time,
                local_from_tracking,
                range_data_in_local,
                measured: Vec::new(),
                inserted: None,
                lost: None,
            };
        }
        self.last_inserted = Some(time);
        let surface_points: Vec<Point3f> = match self.by_surfaces {
            Some(_) => scan.returns.transformed(&local).points,
            None => Vec::new(),
        };
        let scan = self.thinned(scan);
        let [high, low] = clouds.unwrap_or_else(|| self.clouds(&scan.returns));
        // Without an IMU: the first pose was level, and z of the local map has pointed up ever since.
        let gravity = measured_gravity.unwrap_or(local_from_tracking.rotation);
        let data = NodeData {
            time,
            gravity_alignment: gravity,
            filtered_gravity_aligned_point_cloud: PointCloud::default(),
            high_resolution_point_cloud: high,
            low_resolution_point_cloud: low,
            rotational_scan_matcher_histogram: self.histogram(&scan.returns, &gravity),
            local_from_tracking,
        };
        let range_data_in_local = scan.transformed(&local);
        let inserted = InsertedNode { open, ..self.insert(&range_data_in_local, surface_points, data) };
        MatchingResult {
            time,
            local_from_tracking,
            range_data_in_local,
            measured: Vec::new(),
            inserted: Some(inserted),
            lost: None,
        }
    }

    /// Shows the surfaces of the active submaps what a sweep that is no node saw, given in the local map.
    fn insert_surfaces(&mut self, range_data_in_local: &RangeData) {
        if self.by_surfaces.is_some() {
            for submap in self.active_submaps.iter_mut() {
                submap.insert_surfaces(&range_data_in_local.returns.points, &range_data_in_local.origin);
            }
        }
    }

    /// A scan as grids take it.
    fn thinned(&self, scan: RangeData) -> RangeData {
        match self.by_surfaces {
            Some(_) => {
                RangeData { returns: voxel_filter(&scan.returns, self.options.voxel_filter_size), ..scan }
            }
            None => scan,
        }
    }

    /// The fine and the coarse cloud of a scan.
    pub(super) fn clouds(&self, returns: &PointCloud) -> [PointCloud; 2] {
        [
            filtered(returns, &self.options.high_resolution_adaptive_voxel_filter),
            filtered(returns, &self.options.low_resolution_adaptive_voxel_filter),
        ]
    }

    fn histogram(&self, returns_in_tracking: &PointCloud, gravity_alignment: &Quaternion) -> Vec<f32> {
        let level = Rigid3::from_parts(Default::default(), *gravity_alignment);
        let aligned = returns_in_tracking.transformed(&to_f32(&level));
        rotational_histogram(&aligned, self.options.rotational_histogram_size)
    }

    fn insert(
        &mut self,
        range_data_in_local: &RangeData,
        surface_points_in_local: Vec<Point3f>,
        data: NodeData,
    ) -> InsertedNode<Spatial> {
        let local_from_gravity_aligned = data.local_from_tracking.rotation * data.gravity_alignment.inverse();
        let scan = Scan3d {
            range_data_in_local: range_data_in_local.clone(),
            surface_points_in_local,
            rotational_histogram: data.rotational_scan_matcher_histogram.clone(),
            local_from_gravity_aligned,
        };
        let inserter = &self.inserter;
        let submaps = self.active_submaps.insert(&scan, |origin: Point3f| {
            Submap3d::new(origin, local_from_gravity_aligned, inserter).ok()
        });
        InsertedNode { data: Arc::new(data), submaps, open: OpenDirections::default() }
    }
}
