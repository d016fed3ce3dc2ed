//! Planes of submaps from files, which keep none: made again of what they keep, and what that is worth.

use portolan_geometry::{Point3f, Rigid3, rotation_from_roll_pitch_yaw, to_f32};
use portolan_lidar_odometry::PlaneMap;
use portolan_local_slam::{AT_RIGHT_PLACES, AT_WRONG_PLACES};
use portolan_numeric::median;
use portolan_sensor::PointCloud;
use portolan_submaps::{ExplainedByPlanes, MadePlanes, Submap3d};
use rayon::prelude::*;

use crate::NodeData;
use crate::plane_search::{explained_at, explained_near};
use crate::space_3d::{solid_cells, to_find};

/// Fewer nodes than this do not show the planes of a submap.
const MIN_NODES: usize = 8;
/// One in so many scans is left out to learn how well planes that are made again explain scans.
const LEFT_OUT: usize = 8;
/// So many scans are put to wrong places, evenly from all, each turned by the golden angle against the one before, radians.
const MISPLACED: usize = 24;
const GOLDEN_ANGLE: f64 = 2.399_963;
/// Right places stand out from wrong ones by no less than this.
const LEAST_DIFFERENCE: f32 = 0.05;

/// A node with points, and its pose in the submap.
type Placed<'a> = (&'a NodeData, Rigid3);

/// The planes of a submap from a file that keeps none: from the points of its nodes, which are where they were measured but few, and
/// the centres of its solid cells, which are where more points were, within half an edge; where nodes have no points, from these alone.
/// And what such planes explain of scans, where there are enough.
pub(crate) fn planes_of_loaded(
    submap: &Submap3d,
    nodes: &mut dyn Iterator<Item = &NodeData>,
    voxel_size: f32,
) -> MadePlanes {
    let submap_from_local = submap.local_from_submap.inverse();
    let nodes: Vec<Placed> = nodes
        .filter(|node| !clouds(node).iter().all(|cloud| cloud.is_empty()))
        .map(|node| (node, submap_from_local * node.local_from_tracking))
        .collect();
    let cells = solid_cells(submap);
    if nodes.len() < MIN_NODES {
        return MadePlanes { planes: planes_of(&[], &cells, voxel_size), explained: None };
    }
    let planes = planes_of(&nodes, &cells, voxel_size);
    let explained = explained_by(&planes, &nodes, &cells);
    MadePlanes { planes, explained }
}

fn clouds(node: &NodeData) -> [&PointCloud; 2] {
    [&node.high_resolution_point_cloud, &node.low_resolution_point_cloud]
}

fn planes_of(nodes: &[Placed], cells: &[Point3f], voxel_size: f32) -> PlaneMap {
    let mut planes = PlaneMap::new(voxel_size);
    for (node, submap_from_node) in nodes {
        let pose = to_f32(submap_from_node);
        let origin = Point3f::from(pose.translation.vector);
        let points = clouds(node).into_iter().flat_map(|cloud| &cloud.points).map(|point| pose * point);
        planes.insert_all(points, &origin);
    }
    cells.iter().for_each(|cell| planes.insert(cell));
    planes.compacted()
}

/// What planes that nodes made explain of scans: of those that are left out of them where they were taken, and of all at wrong places.
fn explained_by(planes: &PlaneMap, nodes: &[Placed], cells: &[Point3f]) -> Option<ExplainedByPlanes> {
    let is_left_out = |index: usize| index % LEFT_OUT == LEFT_OUT / 2;
    let kept = nodes.iter().enumerate().filter(|(index, _)| !is_left_out(*index));
    let kept: Vec<Placed> = kept.map(|(_, node)| *node).collect();
    let others = planes_of(&kept, cells, planes.edge());
    let left_out: Vec<&Placed> = nodes.iter().skip(LEFT_OUT / 2).step_by(LEFT_OUT).collect();
    let where_taken = left_out.par_iter().map(|(node, pose)| explained_at(&others, &to_find(node), pose));
    let count = MISPLACED.min(nodes.len());
    let by_chance = (0..count).into_par_iter().filter_map(|k| {
        let (node, pose) = nodes.get(k * nodes.len() / count)?;
        // Half of the submap away.
        let (_, other) = nodes.get((k * nodes.len() / count + nodes.len() / 2) % nodes.len())?;
        let turn = rotation_from_roll_pitch_yaw(0.0, 0.0, 1.0 + GOLDEN_ANGLE * k as f64);
        let elsewhere = Rigid3::from_parts(other.translation, turn * pose.rotation);
        Some(explained_near(planes, &to_find(node), &elsewhere))
    });
    let median_of = |shares: Vec<f32>| median(&mut shares.into_iter().map(f64::from).collect::<Vec<_>>());
    let (where_taken, by_chance) = (median_of(where_taken.collect())?, median_of(by_chance.collect())?);
    Some(ExplainedByPlanes { where_taken: where_taken as f32, by_chance: by_chance as f32 })
}

/// The fraction of a scan on the planes of a submap that is as much as a fraction on planes which sweeps were registered to.
pub(crate) fn as_on_made_planes(submap: &Submap3d, fraction: f32) -> f32 {
    let Some((by_chance, difference)) = made(submap) else { return fraction };
    (by_chance + (fraction - AT_WRONG_PLACES.explained) * difference / usual_difference()).clamp(0.0, 1.0)
}

/// And the reverse.
pub(crate) fn as_on_planes_of_sweeps(submap: &Submap3d, fraction: f32) -> f32 {
    let Some((by_chance, difference)) = made(submap) else { return fraction };
    (AT_WRONG_PLACES.explained + (fraction - by_chance) * usual_difference() / difference).clamp(0.0, 1.0)
}

fn usual_difference() -> f32 {
    AT_RIGHT_PLACES.explained - AT_WRONG_PLACES.explained
}

/// What made planes explain by chance, and how much more of a scan at its place.
fn made(submap: &Submap3d) -> Option<(f32, f32)> {
    let ExplainedByPlanes { where_taken, by_chance } = submap.made_planes.as_ref()?.explained?;
    Some((by_chance, (where_taken - by_chance).max(LEAST_DIFFERENCE)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_from_files_have_planes_too() {
        let cells = (-20..20)
            .flat_map(|x| (-20..20).map(move |y| Point3f::new(0.1 * x as f32, 0.1 * y as f32, -0.7)));
        let planes = planes_of(&[], &cells.collect::<Vec<_>>(), 1.0);
        let floor = planes.plane_near(&Point3f::new(0.4, 0.4, -0.68)).unwrap();
        assert!(floor.normal.z.abs() > 0.999 && (floor.point.z + 0.7).abs() < 1e-3);
    }
}
