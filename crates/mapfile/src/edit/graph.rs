//! Exports the constraints of a map as a pose graph for other programs, and imports the resulting poses.

use std::collections::BTreeMap;

use portolan_geometry::{Dimension, Quaternion, Rigid2, Rigid3, embed_3d, project_2d, yaw};
use portolan_mapping::{Space, Space2d};
use portolan_solver::g2o::{Edge, Graph, GraphPose, PoseGraph, Vertex};

use super::optimize::Collected;
use super::{EditError, MapDraft};
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, submap_id, submap_poses};

impl MapDraft {
    /// The map as a pose graph. Its submaps, ascending by id, are the vertices from 0 on, followed by its
    /// nodes. Its constraints are the edges, in their order, with the squares of their weights as information
    /// (per metre and per radian). The first submap is fixed. In 2D nodes are levelled: the tracking frame
    /// without its roll and pitch, heading kept.
    ///
    /// # Errors
    /// If the files cannot be read or a node lacks its poses.
    pub fn to_graph(&self) -> Result<Graph, EditError> {
        let gravity = Collected::read(self)?.gravity_alignments();
        if self.dimension == Some(Dimension::ThreeD) {
            return Ok(Graph::ThreeD(self.build_graph(|pose, _| *pose, information_3d)));
        }
        let pose_2d = |pose: &Rigid3, id: Option<IdInFile>| {
            let gravity = id.and_then(|id| gravity.get(&id)).copied().unwrap_or_else(Quaternion::identity);
            let levelled = project_2d(&Space2d::graph_pose(pose, &gravity)) * heading_of(&gravity);
            Rigid2 { angle: levelled.normalized_angle(), ..levelled }
        };
        Ok(Graph::TwoD(self.build_graph(pose_2d, information_2d)))
    }

    fn build_graph<P: GraphPose>(
        &self,
        graph_pose: impl Fn(&Rigid3, Option<IdInFile>) -> P,
        information: impl Fn(f64, f64) -> Option<P::Information>,
    ) -> PoseGraph<P> {
        let (submaps, nodes) = (submap_poses(&self.graph), self.all_node_poses());
        let mut graph = PoseGraph::default();
        let mut submap_index = BTreeMap::new();
        let mut node_index = BTreeMap::new();
        let mut add = |pose: P| {
            let index = graph.vertices.len();
            graph.vertices.push(Vertex { id: index as i64, pose, fixed: index == 0 });
            index as u32
        };
        for (id, pose) in &submaps {
            submap_index.insert(*id, add(graph_pose(pose, None)));
        }
        for (id, pose) in &nodes {
            node_index.insert(*id, add(graph_pose(pose, Some(*id))));
        }
        for constraint in &self.graph.constraint {
            let node = node_id(constraint.node_id.as_ref());
            let (Some(from), Some(to), Some(pose), Some(information)) = (
                submap_index.get(&submap_id(constraint.submap_id.as_ref())),
                node_index.get(&node),
                pose_from_proto(constraint.relative_pose.as_ref()),
                information(constraint.translation_weight, constraint.rotation_weight),
            ) else {
                continue;
            };
            let measurement = graph_pose(&pose, Some(node));
            graph.edges.push(Edge { from: *from, to: *to, measurement, information });
        }
        graph
    }

    /// Imports the poses of a graph made by [`MapDraft::to_graph`]. Heights of a 2D map stay.
    ///
    /// # Errors
    /// If the graph is of another dimension or does not have the vertices of this map.
    pub fn take_graph_poses(&mut self, graph: &Graph) -> Result<(), EditError> {
        let (submaps, nodes) = (submap_poses(&self.graph), self.all_node_poses());
        let is_3d = self.dimension == Some(Dimension::ThreeD);
        let poses: BTreeMap<i64, Rigid3> = match graph {
            Graph::ThreeD(g) if is_3d => g.vertices.iter().map(|v| (v.id, v.pose)).collect(),
            Graph::TwoD(g) if !is_3d => g.vertices.iter().map(|v| (v.id, embed_3d(&v.pose))).collect(),
            _ => {
                return Err(EditError::Poses("the graph and the map are of different dimensions".to_owned()));
            }
        };
        let wanted = submaps.len() + nodes.len();
        if poses.len() != wanted || !(0..wanted as i64).all(|id| poses.contains_key(&id)) {
            return Err(EditError::Poses(format!(
                "the graph has {} vertices, the map {} submaps and {} nodes: convert this very map to g2o first",
                poses.len(),
                submaps.len(),
                nodes.len()
            )));
        }
        let gravity = Collected::read(self)?.gravity_alignments();
        let mut ordered = poses.into_values();
        let new_submaps = submaps.keys().copied().zip(ordered.by_ref()).collect();
        let new_nodes = nodes.keys().copied().zip(ordered).map(|(id, pose)| match gravity.get(&id) {
            Some(gravity) if !is_3d => {
                let aligned = pose * embed_3d(&heading_of(gravity).inverse());
                (id, Space2d::tracking_pose(&aligned, gravity))
            }
            _ => (id, pose),
        });
        let new_nodes = new_nodes.collect();
        self.set_poses(&new_submaps, &new_nodes);
        Ok(())
    }
}

/// Rotation about the vertical from a gravity-aligned node of the pose graph to its tracking frame. The
/// gravity alignment of a node includes a yaw, because local SLAM integrates it from the first scan on.
fn heading_of(gravity_alignment: &Quaternion) -> Rigid2 {
    Rigid2::new(0.0, 0.0, yaw(gravity_alignment))
}

fn squared(weight: f64) -> Option<f64> {
    (weight.is_finite() && weight >= 0.0).then_some(weight * weight)
}

fn information_2d(translation: f64, rotation: f64) -> Option<<Rigid2 as GraphPose>::Information> {
    let (t, r) = (squared(translation)?, squared(rotation)?);
    Rigid2::information_from_upper(&[t, 0.0, 0.0, t, 0.0, r])
}

fn information_3d(translation: f64, rotation: f64) -> Option<<Rigid3 as GraphPose>::Information> {
    let diagonal = [squared(translation)?; 3].into_iter().chain([squared(rotation)?; 3]);
    let mut upper = Vec::with_capacity(21);
    for (row, value) in diagonal.enumerate() {
        upper.push(value);
        upper.extend(std::iter::repeat_n(0.0, 5 - row));
    }
    Rigid3::information_from_upper(&upper)
}
