//! Joins the scans along a path segment into one 2D cloud, to be found in a whole map.

use portolan_geometry::{Point3f, Rigid2, Vector2};
use portolan_sensor::{PointCloud, voxel_filter_points};

/// Maximum range of points in a joint cloud, metres. Farther ones would need more headings, and the far end
/// of a path segment is bent relative to the frame of the cloud.
const REACH: f32 = 25.0;

/// Scans in the frame in which their poses are given, at height 0, one point in each cell of this edge, metres.
pub fn joint_cloud_2d<'a>(
    scans: impl IntoIterator<Item = (Rigid2, &'a PointCloud)>,
    cell: f64,
) -> PointCloud {
    let mut points: Vec<Point3f> = Vec::new();
    for (joint_from_scan, scan) in scans {
        let moved = scan.points.iter().map(|p| {
            joint_from_scan.transform_point(&Vector2::new(f64::from(p.x), f64::from(p.y))).cast::<f32>()
        });
        points.extend(moved.filter(|p| p.norm() < REACH).map(|p| Point3f::new(p.x, p.y, 0.0)));
    }
    PointCloud::new(voxel_filter_points(&points, cell as f32))
}
