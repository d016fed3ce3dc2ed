//! Vertices and edges of a pose graph.

use portolan_geometry::{NearFrame, Rigid2, Rigid3, Vector3, is_on_earth, moved};

use super::pose::GraphPose;
use crate::ProblemError;
use crate::factors::Se3ErrorConvention;

/// A pose to be estimated.
#[derive(Clone, Debug, PartialEq)]
pub struct Vertex<P> {
    /// Its number in the file.
    pub id: i64,
    /// Pose in the map.
    pub pose: P,
    /// Whether it is held constant.
    pub fixed: bool,
}

/// A measured relative pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge<P: GraphPose> {
    /// Index of the vertex whose frame the measurement is in.
    pub from: u32,
    /// Index of the vertex whose pose was measured.
    pub to: u32,
    /// Pose of `to` in the frame of `from`.
    pub measurement: P,
    /// Inverse covariance of the error `z⁻¹ x_i⁻¹ x_j`.
    pub information: P::Information,
}

/// A graph of poses of one kind.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseGraph<P: GraphPose> {
    /// In file order.
    pub vertices: Vec<Vertex<P>>,
    /// In file order.
    pub edges: Vec<Edge<P>>,
}

/// A pose graph in 2D or in 3D.
#[derive(Clone, Debug, PartialEq)]
pub enum Graph {
    /// In 2D.
    TwoD(PoseGraph<Rigid2>),
    /// In 3D.
    ThreeD(PoseGraph<Rigid3>),
}

/// Why a graph cannot be optimised.
#[derive(Debug, thiserror::Error)]
pub enum GraphError {
    /// A graph without vertices.
    #[error("the graph has no vertices")]
    NoVertices,
    /// An edge refers to a vertex that does not exist.
    #[error("edge {edge} names vertex {vertex}, but there are only {count}")]
    UnknownVertex {
        /// Index of the edge.
        edge: usize,
        /// Index of the vertex.
        vertex: u32,
        /// Number of vertices.
        count: usize,
    },
    /// An edge from a vertex to itself.
    #[error("edge {edge} leads from vertex {vertex} to itself; remove it")]
    SelfEdge {
        /// Index of the edge.
        edge: usize,
        /// Index of the vertex.
        vertex: u32,
    },
    /// A pose, measurement or information matrix that is not finite.
    #[error("{what} {index} contains a number that is not finite")]
    NotFinite {
        /// `vertex` or `edge`.
        what: &'static str,
        /// Its index.
        index: usize,
    },
    /// A vertex that is not on the Earth.
    #[error("vertex {index} lies {metres:.1e} m from the origin, farther than anything on the Earth")]
    FarAway {
        /// Its index.
        index: usize,
        /// Its distance, metres.
        metres: f64,
    },
    /// The least-squares problem could not be built or solved.
    #[error(transparent)]
    Problem(#[from] ProblemError),
}

/// Position of a pose; at height 0 in 2D.
fn place<P: GraphPose>(pose: &P) -> Vector3 {
    Vector3::from_fn(|i, _| if i < P::SPACE_DIMENSION { pose.translation_entry(i) } else { 0.0 })
}

impl<P: GraphPose> Default for PoseGraph<P> {
    fn default() -> Self {
        Self { vertices: Vec::new(), edges: Vec::new() }
    }
}

impl<P: GraphPose> PoseGraph<P> {
    /// Whether all indices are in range and all numbers finite.
    ///
    /// # Errors
    /// If there is no vertex, an edge refers to a vertex that does not exist or to the same one at both ends,
    /// or a number is not finite.
    pub fn check(&self) -> Result<(), GraphError> {
        let count = self.vertices.len();
        if count == 0 {
            return Err(GraphError::NoVertices);
        }
        if let Some(index) = self.vertices.iter().position(|v| !v.pose.is_finite()) {
            return Err(GraphError::NotFinite { what: "vertex", index });
        }
        for (index, edge) in self.edges.iter().enumerate() {
            let vertex = edge.from.max(edge.to);
            if vertex as usize >= count {
                return Err(GraphError::UnknownVertex { edge: index, vertex, count });
            }
            if edge.from == edge.to {
                return Err(GraphError::SelfEdge { edge: index, vertex });
            }
            if !edge.measurement.is_finite() || !edge.information.as_ref().iter().all(|v| v.is_finite()) {
                return Err(GraphError::NotFinite { what: "edge", index });
            }
        }
        Ok(())
    }

    /// A frame near the vertices, see [`NearFrame`].
    ///
    /// # Errors
    /// If one of them is not on the Earth.
    pub(super) fn near_frame(&self) -> Result<NearFrame, GraphError> {
        let places: Vec<Vector3> = self.vertices.iter().map(|vertex| place(&vertex.pose)).collect();
        match places.iter().position(|place| !is_on_earth(place)) {
            Some(index) => Err(GraphError::FarAway { index, metres: places[index].norm() }),
            None => Ok(NearFrame::around(places)),
        }
    }

    /// Translates all vertices along the axes of the map, metres.
    pub(super) fn move_by(&mut self, shift: &Vector3) {
        for vertex in &mut self.vertices {
            let place = moved(&Rigid3::from_parts(place(&vertex.pose).into(), Default::default()), shift);
            vertex.pose = vertex.pose.with_translation(&place.translation.vector.into());
        }
    }

    /// `eᵀΩe` of an edge at the current poses; zero if it refers to a vertex that does not exist.
    pub fn edge_chi2(&self, edge: &Edge<P>, convention: Se3ErrorConvention) -> f64 {
        let (from, to) = (self.vertices.get(edge.from as usize), self.vertices.get(edge.to as usize));
        match (from, to) {
            (Some(from), Some(to)) => {
                P::chi2([&from.pose, &to.pose], &edge.measurement, &edge.information, convention)
            }
            _ => 0.0,
        }
    }

    /// `Σ eᵀΩe` at the current poses.
    pub fn chi2(&self, convention: Se3ErrorConvention) -> f64 {
        self.edges.iter().map(|e| self.edge_chi2(e, convention)).sum()
    }
}

impl Graph {
    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        match self {
            Self::TwoD(g) => g.vertices.len(),
            Self::ThreeD(g) => g.vertices.len(),
        }
    }

    /// Number of edges.
    pub fn edge_count(&self) -> usize {
        match self {
            Self::TwoD(g) => g.edges.len(),
            Self::ThreeD(g) => g.edges.len(),
        }
    }

    /// `Σ eᵀΩe` at the current poses.
    pub fn chi2(&self, convention: Se3ErrorConvention) -> f64 {
        match self {
            Self::TwoD(g) => g.chi2(convention),
            Self::ThreeD(g) => g.chi2(convention),
        }
    }
}
