//! A node looked for in a submap, to add a loop closure that mapping missed.

use portolan_config::ConstraintBuilderOptions;
use portolan_geometry::Rigid3;
use portolan_mapping::{NodeData, Planar, Repairs, SearchRegion, Space, Submap2d};
use serde::Serialize;

use super::{EditError, MapDimension, MapDraft};
use crate::convert::{MapSpace, node_data};
use crate::map_reader::MapReader;
use crate::pose::{IdInFile, node_id, submap_id};
use crate::proto::mapping::serialized_data::Data;

/// A node found in a submap.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FoundLoop {
    /// How well it fits, 0 to 1.
    pub score: f32,
    /// Position of the node in the submap, metres.
    pub position: [f64; 3],
    /// The node's tracking frame in the submap.
    #[serde(skip)]
    pub submap_from_node: Rigid3,
}

impl MapDraft {
    /// Looks for the scan of a node everywhere in a submap of a 2D map. Matches of a score below
    /// `options.global_localization_min_score` do not count.
    ///
    /// # Errors
    /// If either is not there or cannot be used, the map is 3D, or nothing was found.
    pub fn find_loop(
        &self,
        submap: IdInFile,
        node: IdInFile,
        options: &ConstraintBuilderOptions,
    ) -> Result<FoundLoop, EditError> {
        if self.dimension == Some(MapDimension::Spatial) {
            return Err(EditError::Dimension(
                "nodes are searched in 2D submaps only; give the pose of the node in the submap",
            ));
        }
        self.require_parts(submap, node)?;
        let (Some(grid), Some(scan)) = self.load_pair(submap, node)? else {
            return Err(EditError::NotFound { submap, node });
        };
        let matcher = Planar::build_matcher(&grid, options).ok_or(EditError::NotFound { submap, node })?;
        let guess = Rigid3::identity();
        let found = Planar::find_node(&matcher, &grid, &scan, &guess, SearchRegion::WholeSubmap, options)
            .ok_or(EditError::NotFound { submap, node })?;
        let submap_from_node = Planar::tracking_pose(&found.submap_from_node, &scan.gravity_alignment);
        let t = submap_from_node.translation;
        Ok(FoundLoop { score: found.score, position: [t.x, t.y, t.z], submap_from_node })
    }

    /// The grid and the scan from their files.
    fn load_pair(
        &self,
        submap: IdInFile,
        node: IdInFile,
    ) -> Result<(Option<Submap2d>, Option<NodeData>), EditError> {
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
                        let mut repairs = Repairs::default();
                        grid = Some(Planar::submap_from_proto(m, submap, &mut repairs).map_err(unusable)?.0);
                    }
                    Data::Node(m) if here(node_id(m.node_id.as_ref())) == Some(node) => {
                        scan = Some(node_data(m, node).map_err(unusable)?);
                    }
                    _ => {}
                }
            }
        }
        Ok((grid, scan))
    }
}
