//! A 2D scan in the form in which it is matched to the map, and the joint cloud of several.

use portolan_geometry::{Point3f, Vector2, project_2d};
use portolan_matching::{joint_cloud_2d, surface_tangents};
use portolan_sensor::{PointCloud, voxel_filter_indices};

use crate::recent::RecentScans;
use crate::settings::maps::COARSE_CELL;
use crate::settings::scans::{MOST_JOINT_POINTS_2D, MOST_POINTS_2D, VOXEL_2D};

/// A scan in its own level frame.
#[derive(Clone, Debug)]
pub struct Scan2d {
    /// A part of its points, metres.
    pub cloud: PointCloud,
    /// The same without heights.
    pub points: Vec<Vector2>,
    /// Direction of the surface at each of them, where it is known.
    pub tangents: Vec<Option<Vector2>>,
}

impl Scan2d {
    /// From all returns in the order in which they were measured, in the level frame of the scanner.
    pub fn new(returns: &PointCloud) -> Self {
        let tangents = surface_tangents(returns);
        let kept = voxel_filter_indices(&returns.points, |p| *p, VOXEL_2D);
        let stride = kept.len().div_ceil(MOST_POINTS_2D).max(1);
        let all = |i: usize| Some((returns.points.get(i)?, tangents.get(i).copied()?));
        let kept = kept.into_iter().step_by(stride).filter_map(|i| all(i as usize));
        let (flat, tangents) = kept.map(|(p, tangent)| (Point3f::new(p.x, p.y, 0.0), tangent)).unzip();
        let cloud = PointCloud::new(flat);
        let points = cloud.points.iter().map(plane).collect();
        Self { cloud, points, tangents }
    }
}

pub(crate) fn plane(p: &Point3f) -> Vector2 {
    Vector2::new(f64::from(p.x), f64::from(p.y))
}

/// Several scans as one cloud in the frame of the newest.
#[derive(Clone, Debug, Default)]
pub struct JointScan2d {
    /// Metres, at height 0.
    pub cloud: PointCloud,
    /// The same without heights.
    pub points: Vec<Vector2>,
}

impl JointScan2d {
    /// From all kept scans.
    pub fn of(recent: &RecentScans<Scan2d>) -> Self {
        let scans = recent.seen_from_newest();
        let clouds = scans.map(|(newest_from_scan, scan)| (project_2d(&newest_from_scan), &scan.cloud));
        let cells = joint_cloud_2d(clouds, COARSE_CELL);
        let stride = cells.points.len().div_ceil(MOST_JOINT_POINTS_2D).max(1);
        let cloud = PointCloud::new(cells.points.into_iter().step_by(stride).collect());
        let points = cloud.points.iter().map(plane).collect();
        Self { cloud, points }
    }
}
