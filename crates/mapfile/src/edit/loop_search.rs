//! Searches for a node in a submap, to add a loop closure that mapping missed.

use portolan_config::ConstraintBuilderOptions;
use portolan_geometry::{Dimension, Rigid3, rotation_angle};
use portolan_grids::ScanAgreement;
use portolan_issue::IssueLog;
use portolan_mapping::{MatchAcceptance, NodeData, SearchRegion, Space, Space2d, Space3d};
use serde::Serialize;

use super::{EditError, MapDraft};
use crate::convert::{MapFileSpace, node_data};
use portolan_pbstream::MapReader;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::{IdInFile, node_id, submap_id, submap_poses};

/// A node found in a submap.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FoundLoop {
    /// Matching score, 0 to 1.
    pub score: f32,
    /// Position of the node in the submap, metres.
    pub position: [f64; 3],
    /// Difference from the pose in the map: metres and radians.
    pub off: (f64, f64),
    /// Pose of the node's tracking frame in the submap.
    #[serde(skip)]
    pub submap_from_node: Rigid3,
}

impl MapDraft {
    /// Searches for the scan of a node in the whole submap. Matches with a score below
    /// `options.global_localization_min_score` are rejected.
    ///
    /// # Errors
    /// If the submap or node is missing or cannot be used, or if no match is found.
    pub fn find_loop(
        &self,
        submap: IdInFile,
        node: IdInFile,
        options: &ConstraintBuilderOptions,
    ) -> Result<FoundLoop, EditError> {
        self.require_parts(submap, node)?;
        match self.dimension {
            Some(Dimension::ThreeD) => self.find_loop_in::<Space3d>(submap, node, options),
            _ => self.find_loop_in::<Space2d>(submap, node, options),
        }
    }

    fn find_loop_in<S: MapFileSpace>(
        &self,
        submap: IdInFile,
        node: IdInFile,
        options: &ConstraintBuilderOptions,
    ) -> Result<FoundLoop, EditError> {
        let not_found = |why: String| EditError::NotFound { submap, node, why };
        let (Some(grid), Some(scan)) = self.load_pair::<S>(submap, node)? else {
            return Err(not_found("its scan or the grid is not in the file".to_owned()));
        };
        let matcher = S::build_matcher(&grid, options)
            .ok_or_else(|| not_found("the submap is empty, or too large to be searched".to_owned()))?;
        // In 3D the search needs the direction of gravity: it is taken from the poses of the map.
        let guess = self.guess::<S>(submap, node, &scan);
        let search = |options: &ConstraintBuilderOptions| {
            let acceptance = MatchAcceptance::default();
            let region = SearchRegion::WholeSubmap { acceptance, around_guess: None };
            S::find_node(&matcher, &grid, &scan, &guess, region, options)
        };
        let needed = options.global_localization_min_score;
        let found = search(options).ok_or_else(|| {
            let lenient =
                ConstraintBuilderOptions { global_localization_min_score: LEAST_SCORE, ..options.clone() };
            not_found(match search(&lenient) {
                Some(best) => format!(
                    "its scan fits with a score of {:.2} at best, and {needed} is needed \
                     (constraint_builder.global_localization_min_score)",
                    best.score
                ),
                None => "its scan fits nowhere".to_owned(),
            })
        })?;
        let submap_from_node = S::tracking_pose(&found.submap_from_node, &scan.gravity_alignment);
        let t = submap_from_node.translation;
        let off = guess.inverse() * found.submap_from_node;
        let off = (off.translation.vector.norm(), rotation_angle(&off));
        Ok(FoundLoop { score: found.score, position: [t.x, t.y, t.z], off, submap_from_node })
    }

    /// Agreement of the scan of a node with a submap at a pose given by the user. None in 3D, and if the scan
    /// or the grid is not in the file.
    ///
    /// # Errors
    /// The submap or node is missing or cannot be read.
    pub fn judge_loop(
        &self,
        submap: IdInFile,
        node: IdInFile,
        submap_from_node: &Rigid3,
    ) -> Result<Option<ScanAgreement>, EditError> {
        self.require_parts(submap, node)?;
        if self.dimension == Some(Dimension::ThreeD) {
            return Ok(None);
        }
        let (Some(grid), Some(scan)) = self.load_pair::<Space2d>(submap, node)? else { return Ok(None) };
        let pose = Space2d::graph_pose(submap_from_node, &scan.gravity_alignment);
        let nothing = ScanAgreement { explained: 0.0, in_free_space: 0.0, through_solid: 0.0 };
        Ok(Some(Space2d::agreement(&grid, &scan, &pose).unwrap_or(nothing)))
    }

    /// Pose of the node in the submap by the poses of the map.
    fn guess<S: MapFileSpace>(&self, submap: IdInFile, node: IdInFile, scan: &NodeData) -> Rigid3 {
        let poses = (submap_poses(&self.graph), self.all_node_poses());
        match (poses.0.get(&submap), poses.1.get(&node)) {
            (Some(map_from_submap), Some(map_from_node)) => {
                map_from_submap.inverse() * S::graph_pose(map_from_node, &scan.gravity_alignment)
            }
            _ => Rigid3::identity(),
        }
    }

    /// Reads the grid and the scan from their files.
    fn load_pair<S: MapFileSpace>(
        &self,
        submap: IdInFile,
        node: IdInFile,
    ) -> Result<(Option<S::Submap>, Option<NodeData>), EditError> {
        let (mut grid, mut scan) = (None, None);
        for source in &self.sources {
            let failed = |error| EditError::File { path: source.path.clone(), source: error };
            let unusable = |error| EditError::Content { path: source.path.clone(), source: Box::new(error) };
            let here = |id: IdInFile| source.ids.get(&id.0).map(|t| (*t, id.1));
            let mut reader = MapReader::open_with(&source.path, self.limits).map_err(failed)?;
            while grid.is_none() || scan.is_none() {
                let Some(message) = reader.next_message().map_err(failed)? else { break };
                match message.data {
                    Data::Submap(m) if here(submap_id(m.submap_id.as_ref())) == Some(submap) => {
                        let mut issues = IssueLog::default();
                        grid = Some(S::submap_from_proto(m, submap, &mut issues).map_err(unusable)?.0);
                    }
                    Data::Node(m) if here(node_id(m.node_id.as_ref())) == Some(node) => {
                        let found = node_data(m, node).map_err(unusable)?;
                        check_size(&found).map_err(|reason| {
                            let reason = format!("node {},{} {reason}", node.0, node.1);
                            EditError::Broken { path: source.path.clone(), reason }
                        })?;
                        scan = Some(found);
                    }
                    _ => {}
                }
            }
        }
        Ok((grid, scan))
    }
}

/// Minimum score of the best match that is reported in the error, 0 to 1.
const LEAST_SCORE: f64 = 0.1;

/// Maximum number of points of a scan. Larger clouds are no scan of a node, and matching them would take
/// minutes.
const MAX_POINTS: usize = 1 << 20;

pub(super) fn check_size(node: &NodeData) -> Result<(), String> {
    let clouds = [
        &node.filtered_gravity_aligned_point_cloud,
        &node.high_resolution_point_cloud,
        &node.low_resolution_point_cloud,
    ];
    match clouds.iter().map(|cloud| cloud.points.len()).find(|n| *n > MAX_POINTS) {
        Some(points) => Err(format!("has {points} points, which cannot be one scan")),
        None => Ok(()),
    }
}
