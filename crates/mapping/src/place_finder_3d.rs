//! Finds path segments in a 3D map: searches all submaps at once, projected onto the ground plane.

use portolan_geometry::{NearFrame, Point3f, Rigid3, to_f32};
use portolan_submaps::Submap3d;

use crate::from_above::{SeenFromAbove, columns_of_scans};
use crate::space_3d::solid_cells;
use crate::{NodeData, PlaceFinder, ProposedPlaces, SubmapInMap};

/// Maximum distance of points from the scanner, metres; only single beams hit what is farther away.
const REACH: f32 = 30.0;

/// Finds path segments in a 3D map.
pub(crate) struct PlaceFinder3d {
    /// Frame of the projected map.
    frame: NearFrame,
    above: SeenFromAbove,
}

impl PlaceFinder3d {
    /// For submaps with planes; none if others are among them, or nothing can be searched.
    pub fn new(submaps: &[SubmapInMap<'_, Submap3d>]) -> Option<Self> {
        if submaps.iter().any(|part| part.submap.planes_to_match().is_none()) {
            return None;
        }
        let frame = NearFrame::around(submaps.iter().map(|part| part.map_from_submap.translation.vector));
        let solid = submaps.iter().flat_map(|part| {
            let near_from_submap = to_f32(&frame.near(&part.map_from_submap));
            solid_cells(part.submap).into_iter().map(move |cell| near_from_submap * cell)
        });
        let near = |place: &portolan_geometry::Vector3| {
            frame.near(&Rigid3::from_parts((*place).into(), Default::default())).translation.vector
        };
        let nodes = submaps.iter().flat_map(|part| part.nodes.iter().map(near)).collect();
        Some(Self { above: SeenFromAbove::new(solid, nodes).ok()?, frame })
    }
}

impl PlaceFinder for PlaceFinder3d {
    fn find(&self, scans: &[(Rigid3, &NodeData)], most_lookups: u64) -> ProposedPlaces {
        let Some((_, first)) = scans.first().filter(|_| most_lookups > 0) else {
            return ProposedPlaces::default();
        };
        let level_from_first = Rigid3::from_parts(Default::default(), first.gravity_alignment);
        let points = scans.iter().flat_map(|(first_from_scan, node)| {
            let level_from_scan = to_f32(&(level_from_first * first_from_scan));
            let clouds = [&node.high_resolution_point_cloud, &node.low_resolution_point_cloud];
            clouds.into_iter().flat_map(|cloud| &cloud.points).map(move |p| level_from_scan * p)
        });
        let near: Vec<Point3f> = points.filter(|p| p.coords.norm() < REACH).collect();
        let found = self.above.find(&columns_of_scans(near.into_iter()), None);
        let poses = found.poses.iter().map(|place| self.frame.in_map(&(place * level_from_first))).collect();
        ProposedPlaces { poses, ..found }
    }
}
