//! Makes planes of submaps loaded from files, which do not keep them, and calibrates what fraction of a scan
//! they explain.

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

/// Minimum number of nodes of a submap for its planes to be made of their points.
const MIN_NODES: usize = 8;
/// One in this number of scans is left out to measure how well the remade planes explain scans.
const LEFT_OUT: usize = 8;
/// Maximum number of scans that are put at wrong places, evenly chosen from all.
const MISPLACED: usize = 24;
/// Rotation of each of these scans against the one before, radians.
const GOLDEN_ANGLE: f64 = 2.399_963;
/// Minimum difference between the explained fractions at right and wrong places.
const LEAST_DIFFERENCE: f32 = 0.05;

/// A node with points, and its pose in the submap.
type Placed<'a> = (&'a NodeData, Rigid3);

/// Makes the planes of a submap from a file that keeps none. Sources are the points of its nodes, which are
/// exact but few, and the centres of its occupied cells, which represent more points within half an edge; if
/// nodes have no points, the cells alone. Also determines the fraction of scans that such planes explain,
/// where there are enough scans.
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

/// Fractions of scans that remade planes explain: of scans that are left out of the planes, at their poses,
/// and of all scans at wrong places.
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

/// Converts a fraction explained by planes that sweeps were registered to into the equivalent fraction for
/// the remade planes of a submap.
pub(crate) fn as_on_made_planes(submap: &Submap3d, fraction: f32) -> f32 {
    let Some((by_chance, difference)) = made(submap) else { return fraction };
    (by_chance + (fraction - AT_WRONG_PLACES.explained) * difference / usual_difference()).clamp(0.0, 1.0)
}

/// The inverse of [`as_on_made_planes`].
pub(crate) fn as_on_planes_of_sweeps(submap: &Submap3d, fraction: f32) -> f32 {
    let Some((by_chance, difference)) = made(submap) else { return fraction };
    (AT_WRONG_PLACES.explained + (fraction - by_chance) * usual_difference() / difference).clamp(0.0, 1.0)
}

fn usual_difference() -> f32 {
    AT_RIGHT_PLACES.explained - AT_WRONG_PLACES.explained
}

/// The fraction that remade planes explain by chance, and how much more they explain of a scan at its place.
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
