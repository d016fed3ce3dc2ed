//! Finds path segments in a 2D map: searches all submaps at once.

use portolan_geometry::{NearFrame, Rigid3, embed_3d, project_2d};
use portolan_matching::{PlaceIndex2d, WantedPlaces, joint_cloud_2d};
use portolan_submaps::Submap2d;

use crate::{NodeData, PlaceFinder, ProposedPlaces, SubmapInMap};

/// Edge of a cell of the index, metres: walls of rooms and corridors are apart by several of them.
const CELL: f64 = 0.2;
/// Parameters of the proposals for a path segment, chosen in docs/experiments/2026-11-place-index.md.
const WANTED: WantedPlaces = WantedPlaces {
    min_score: 0.5,
    share_of_best: 0.75,
    separation: (0.8, 0.26),
    most: 12,
    most_points: 160,
    beam: 128,
    lookups: 2_000_000_000,
};

/// Finds path segments in a 2D map.
pub(crate) struct PlaceFinder2d {
    /// Frame of the index.
    frame: NearFrame,
    index: PlaceIndex2d,
}

impl PlaceFinder2d {
    /// For submaps; none if nothing can be searched.
    pub fn new(submaps: &[SubmapInMap<'_, Submap2d>]) -> Option<Self> {
        let frame = NearFrame::around(submaps.iter().map(|part| part.map_from_submap.translation.vector));
        let grids: Vec<_> = submaps
            .iter()
            .map(|SubmapInMap { map_from_submap, submap, .. }| {
                let grid_from_submap = project_2d(&submap.local_from_submap);
                (&submap.grid, project_2d(&frame.near(map_from_submap)) * grid_from_submap.inverse())
            })
            .collect();
        let index = PlaceIndex2d::new(&grids, CELL).ok().flatten()?;
        Some(Self { frame, index })
    }
}

impl PlaceFinder for PlaceFinder2d {
    fn find(&self, scans: &[(Rigid3, &NodeData)], most_lookups: u64) -> ProposedPlaces {
        let clouds = scans.iter().map(|(first_from_scan, node)| {
            (project_2d(first_from_scan), &node.filtered_gravity_aligned_point_cloud)
        });
        let wanted = WantedPlaces { lookups: WANTED.lookups.min(most_lookups), ..WANTED };
        let found = self.index.find(&joint_cloud_2d(clouds, CELL), &wanted);
        let poses = found.places.iter().map(|place| self.frame.in_map(&embed_3d(&place.pose))).collect();
        ProposedPlaces { poses, lookups: found.lookups }
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::{Vector3, moved};

    use super::*;
    use crate::made_rooms::{node, submap};

    fn in_map((map_from_submap, submap): (Rigid3, &Submap2d)) -> SubmapInMap<'_, Submap2d> {
        SubmapInMap { map_from_submap, submap, nodes: Vec::new() }
    }

    #[test]
    fn a_section_of_path_is_found_in_its_submap() {
        let (large, small) = ((9.0, 7.0), (6.0, 5.0));
        let pose = Rigid3::new(Vector3::new(30.0, -5.0, 0.0), Vector3::z() * 2.0);
        let submaps = [submap(large), submap(small), submap(large)];
        let poses = [Rigid3::translation(-20.0, 0.0, 0.0), pose, Rigid3::translation(0.0, 25.0, 0.0)];
        let placed: Vec<_> = poses.into_iter().zip(&submaps).map(in_map).collect();
        let places = PlaceFinder2d::new(&placed).unwrap();
        let (here, there) = (node(small, (0.5, -0.8)), node(small, (-1.0, 0.2)));
        let step = Rigid3::translation(-1.5, 1.0, 0.0);
        let found = places.find(&[(Rigid3::identity(), &here), (step, &there)], u64::MAX).poses;
        let truth = pose * Rigid3::translation(0.5, -0.8, 0.0);
        let off = truth.inverse() * found[0];
        assert!(off.translation.vector.norm() < 0.3 && off.rotation.angle() < 0.06, "{off:?}");
        assert!(PlaceFinder2d::new(&[]).is_none());
    }

    #[test]
    fn search_does_not_depend_on_the_distance_from_the_origin() {
        let (large, small) = ((9.0, 7.0), (6.0, 5.0));
        let submaps = [submap(large), submap(small)];
        let here = node(small, (0.5, -0.8));
        let found = |origin: Vector3| {
            let poses =
                [Rigid3::translation(-20.0, 0.0, 0.0), Rigid3::new(Vector3::x() * 30.0, Vector3::z())];
            let placed: Vec<_> =
                poses.iter().map(|pose| moved(pose, &origin)).zip(&submaps).map(in_map).collect();
            let found = PlaceFinder2d::new(&placed).unwrap().find(&[(Rigid3::identity(), &here)], u64::MAX);
            found.poses.iter().map(|pose| moved(pose, &-origin)).collect::<Vec<_>>()
        };
        let (near, far) = (found(Vector3::zeros()), found(Vector3::new(499_712.0, 5_400_576.0, 0.0)));
        assert!(!near.is_empty() && near.len() == far.len(), "{near:?} {far:?}");
        for (a, b) in near.iter().zip(&far) {
            assert!((a.to_homogeneous() - b.to_homogeneous()).norm() < 1e-6, "{a} {b}");
        }
    }

    #[test]
    fn identical_rooms_are_both_proposed() {
        let size = (9.0, 7.0);
        let submaps = [submap(size), submap(size)];
        let poses = [Rigid3::identity(), Rigid3::translation(25.0, 3.0, 0.0)];
        let placed: Vec<_> = poses.into_iter().zip(&submaps).map(in_map).collect();
        let here = node(size, (1.0, 1.0));
        let found = PlaceFinder2d::new(&placed).unwrap().find(&[(Rigid3::identity(), &here)], u64::MAX).poses;
        for pose in poses {
            let truth = pose * Rigid3::translation(1.0, 1.0, 0.0);
            let off = |place: &Rigid3| (place.translation.vector - truth.translation.vector).norm();
            assert!(found.iter().any(|place| off(place) < 0.3), "{pose:?}: {found:?}");
        }
    }
}
