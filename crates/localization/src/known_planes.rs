//! Fits the planes of a saved 3D map.

use portolan_geometry::{Point3f, to_f32};
use portolan_grids::SOLID_VOXEL;
use portolan_lidar_odometry::PlaneMap;
use portolan_mapping::{GraphState, Node, Space3d};

use crate::submap_cells::SubmapCells;

/// Adds the solid cells of a submap to planes, if its nodes keep no points. Otherwise the cells add no
/// information about planes, and they are biased: all points of a surface along the lattice are moved to the
/// middles of the same cells, by up to half an edge, and no number of them reduces this
/// (docs/experiments/2026-11-along-streets.md).
pub(crate) fn add_cells(planes: &mut PlaneMap, submap: &SubmapCells, state: &GraphState<Space3d>) {
    if has_points(submap, state) {
        return;
    }
    let mut nodes = submap.entry.node_ids.iter().filter_map(|node| state.nodes.get(node));
    let seen_from = nodes.next().map(|node| node.map_from_tracking.translation.vector.cast::<f32>());
    let origin = seen_from.map_or(submap.origin, Point3f::from);
    let solid = submap.cells.iter().filter(|(_, probability)| *probability > SOLID_VOXEL);
    planes.insert_all(solid.map(|(place, _)| *place), &origin);
}

/// Whether any node of a submap keeps points.
fn has_points(submap: &SubmapCells, state: &GraphState<Space3d>) -> bool {
    let mut nodes = submap.entry.node_ids.iter().filter_map(|node| state.nodes.get(node));
    nodes.any(|node| {
        let clouds = [&node.data.high_resolution_point_cloud, &node.data.low_resolution_point_cloud];
        clouds.iter().any(|cloud| !cloud.points.is_empty())
    })
}

/// Adds the points that these nodes saw, at their poses in the pose graph.
pub(crate) fn with_nodes<'a>(planes: PlaneMap, nodes: impl Iterator<Item = &'a Node>) -> PlaneMap {
    let mut planes = planes;
    for node in nodes {
        let pose = to_f32(&node.map_from_tracking);
        let clouds = [&node.data.high_resolution_point_cloud, &node.data.low_resolution_point_cloud];
        let points = clouds.into_iter().flat_map(|cloud| &cloud.points).map(|p| pose * p);
        planes.insert_all(points, &Point3f::from(pose.translation.vector));
    }
    planes.compacted()
}

/// The planes of the first node, the third and so on, to which the scans of the others are matched.
pub(crate) fn planes_of_every_other_node(state: &GraphState<Space3d>, edge: f32) -> PlaneMap {
    with_nodes(PlaneMap::new(edge), state.nodes.values().step_by(2))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use portolan_geometry::{Quaternion, Rigid3, Time};
    use portolan_mapping::{NodeData, NodeId, SubmapEntry, TrajectoryId};
    use portolan_sensor::PointCloud;

    use super::*;

    /// Edge of the cells of the submap.
    const EDGE: f32 = 0.1;
    /// Just above the border of two cells.
    const FLOOR: f32 = 0.301;

    fn floor() -> impl Iterator<Item = Point3f> {
        (-30..30).flat_map(|x| {
            (-30..30).map(move |y| Point3f::new(0.1 * x as f32 + 0.02, 0.1 * y as f32 + 0.07, FLOOR))
        })
    }

    /// A node that looked at a floor, and keeps these points, and the height of the plane in which the map has the floor.
    fn height_of_floor(points: Vec<Point3f>) -> f32 {
        let id = NodeId::new(TrajectoryId(0), 0);
        let map_from_tracking = Rigid3::translation(0.0, 0.0, 2.0);
        let in_tracking = points.into_iter().map(|p| Point3f::new(p.x, p.y, p.z - 2.0)).collect();
        let data = NodeData {
            time: Time::from_ticks(0),
            gravity_alignment: Quaternion::identity(),
            filtered_gravity_aligned_point_cloud: PointCloud::default(),
            high_resolution_point_cloud: PointCloud::new(in_tracking),
            low_resolution_point_cloud: PointCloud::default(),
            rotational_scan_matcher_histogram: Vec::new(),
            local_from_tracking: map_from_tracking,
            scan: None,
        };
        let mut state = GraphState::<Space3d>::default();
        state.nodes.insert(id, Node { data: Arc::new(data), map_from_tracking });
        let entry = SubmapEntry {
            submap: None,
            local_from_submap: Rigid3::identity(),
            searchable: true,
            insertion_finished: true,
            node_ids: [id].into(),
        };
        let middle = |v: f32| ((v / EDGE).floor() + 0.5) * EDGE;
        let cells = floor().map(|p| (Point3f::from(p.coords.map(middle)), 0.9)).collect();
        let mut planes = PlaneMap::new(1.0);
        add_cells(&mut planes, &SubmapCells { entry: &entry, origin: Point3f::origin(), cells }, &state);
        let planes = with_nodes(planes, state.nodes.values());
        let plane = planes.plane_near(&Point3f::new(0.4, 0.4, FLOOR)).unwrap();
        assert!(plane.normal.z > 0.99, "{plane:?}");
        plane.point.z
    }

    #[test]
    fn a_plane_near_the_border_of_two_cells_keeps_its_height() {
        let of_points = height_of_floor(floor().collect());
        assert!((of_points - FLOOR).abs() < 0.002, "{of_points} m");
        let of_cells = height_of_floor(Vec::new());
        assert!((of_cells - 0.35).abs() < 0.002, "where there are no points the cells tell: {of_cells} m");
    }
}
