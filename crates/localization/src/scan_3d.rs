//! A 3D scan in the form in which it is matched to the map, and the joint cloud of several.

use std::collections::BTreeMap;

use portolan_geometry::{Point3f, to_f32};
use portolan_mapping::columns_of_scans;
use portolan_sensor::{PointCloud, voxel_filter_points};

use crate::recent::RecentScans;
use crate::settings::scans::{
    JOINT_RANGE_3D, JUDGED_RANGE, JUDGED_SLICE, MOST_JOINT_POINTS_3D, MOST_JUDGED_POINTS, MOST_POINTS_3D,
    MOST_THINNED_JOINT_POINTS, VOXEL_3D,
};

/// A scan in its own level frame.
#[derive(Clone, Debug)]
pub struct Scan3d {
    /// Points for registration, metres.
    pub points: Vec<Point3f>,
    /// Points by which a place is judged.
    pub judged: Vec<Point3f>,
    /// All points, thinned.
    pub thinned: Vec<Point3f>,
}

impl Scan3d {
    /// From all returns, in the level frame of the scanner.
    pub fn new(returns: &PointCloud) -> Self {
        let thinned = voxel_filter_points(&returns.points, VOXEL_3D);
        let near: Vec<Point3f> = thinned.iter().filter(|p| p.coords.norm() < JUDGED_RANGE).copied().collect();
        Self { points: evenly(&thinned, MOST_POINTS_3D), judged: over_heights(&near), thinned }
    }
}

/// At most this number of points, evenly taken from all.
fn evenly(points: &[Point3f], most: usize) -> Vec<Point3f> {
    points.iter().step_by(points.len().div_ceil(most).max(1)).copied().collect()
}

/// Chooses points evenly over heights.
fn over_heights(points: &[Point3f]) -> Vec<Point3f> {
    let mut slices: BTreeMap<i32, Vec<Point3f>> = BTreeMap::new();
    for point in points {
        slices.entry((point.z / JUDGED_SLICE).floor() as i32).or_default().push(*point);
    }
    let mut by_size: Vec<&Vec<Point3f>> = slices.values().collect();
    by_size.sort_by_key(|slice| slice.len());
    let (mut left, mut chosen) = (MOST_JUDGED_POINTS, Vec::new());
    for (i, slice) in by_size.iter().enumerate() {
        let share = left / (by_size.len() - i);
        let count = slice.len().min(share);
        chosen.extend((0..count).filter_map(|k| slice.get(k * slice.len() / count)));
        left -= count;
    }
    chosen
}

/// Several scans as one cloud in the frame of the newest.
#[derive(Clone, Debug)]
pub struct JointScan3d {
    /// Points for registration, metres.
    pub points: Vec<Point3f>,
    /// A larger part of the points.
    pub thinned: Vec<Point3f>,
    /// Upright structures, seen from above.
    pub columns: PointCloud,
}

impl JointScan3d {
    /// From all kept scans.
    pub fn of(recent: &RecentScans<Scan3d>) -> Self {
        let mut points: Vec<Point3f> = Vec::new();
        for (newest_from_scan, scan) in recent.seen_from_newest() {
            let pose = to_f32(&newest_from_scan);
            points.extend(scan.thinned.iter().map(|p| pose * p).filter(|p| p.coords.norm() < JOINT_RANGE_3D));
        }
        let columns = columns_of_scans(points.iter().copied());
        let thinned = voxel_filter_points(&points, VOXEL_3D);
        Self {
            points: evenly(&thinned, MOST_JOINT_POINTS_3D),
            columns,
            thinned: evenly(&thinned, MOST_THINNED_JOINT_POINTS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_judged_points_are_not_on_the_floor() {
        let floor = (-40..40)
            .flat_map(|x| (-40..40).map(move |y| Point3f::new(0.3 * x as f32, 0.3 * y as f32, -1.0)));
        let wall = (-40..40)
            .flat_map(|x| (0..8).map(move |z| Point3f::new(0.3 * x as f32, 5.05, 0.3 * z as f32 - 0.9)));
        let points: Vec<Point3f> = floor.chain(wall).collect();
        let scan = Scan3d::new(&PointCloud::new(points));
        let of_wall = scan.judged.iter().filter(|p| p.z > -0.95).count();
        assert!(scan.judged.len() <= MOST_JUDGED_POINTS && of_wall * 10 > scan.judged.len() * 7, "{of_wall}");
    }
}
