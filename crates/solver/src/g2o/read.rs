//! Reads g2o files.

use std::collections::{BTreeMap, HashMap};
use std::io::{self, BufRead};

use portolan_geometry::{Rigid2, Rigid3};
use portolan_input::{Line, read_line};
use portolan_numeric::counted;

use super::connectivity::Adjacency;
use super::graph::{Edge, Graph, PoseGraph, Vertex};
use super::initialize::follow;
use super::pose::GraphPose;

/// Maximum length of a line, bytes: a FIX line may list a million vertices.
const MAX_LINE: usize = 16 << 20;

/// Why a g2o file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum G2oError {
    /// The file could not be read.
    #[error("the file cannot be read: {0}")]
    Io(#[from] io::Error),
    /// A line whose contents do not match its tag.
    #[error("line {line}: {tag} needs {expected}; the file is damaged or cut off")]
    Malformed {
        /// Line number, from 1.
        line: usize,
        /// First word of the line.
        tag: String,
        /// The expected contents.
        expected: &'static str,
    },
    /// Poses in 2D and in 3D in one file.
    #[error("line {line}: {tag} in a graph of the other dimension; split the file")]
    MixedDimensions {
        /// Line number, from 1.
        line: usize,
        /// First word of the line.
        tag: String,
    },
    /// The file has no vertex and no edge.
    #[error("the file contains no vertices and edges (VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT)")]
    Empty,
    /// A line too long for a g2o file; this is another kind of file.
    #[error(
        "line {line} is longer than {limit_mib} MiB: this is not a g2o file, which is text with a line for each \
        vertex and edge"
    )]
    LongLine {
        /// Line number, from 1.
        line: usize,
        /// Maximum length, MiB.
        limit_mib: usize,
    },
    /// More than 4 billion vertices or edges.
    #[error("the graph has more than 4 billion vertices or edges")]
    TooLarge,
}

/// What was left out or repaired while reading.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct G2oRepairs {
    /// Number of lines per unknown tag; beyond [`G2oRepairs::MAX_TAGS`] different tags they are counted under
    /// "…".
    pub ignored_tags: BTreeMap<String, usize>,
    /// Vertices that were defined again; the first definition is used.
    pub duplicate_vertices: usize,
    /// Vertices with a number that is too large or not finite, or with a quaternion of length zero.
    pub unusable_vertices: usize,
    /// Vertices to which only edges (or unusable lines) refer; their poses follow from measurements.
    pub created_vertices: usize,
    /// Edges with a number that is too large or not finite, or with a quaternion of length zero; dropped.
    pub unusable_edges: usize,
    /// Edges from a vertex to itself; dropped.
    pub self_edges: usize,
    /// Quaternions whose norm was off by more than 0.001; normalised.
    pub normalized_quaternions: usize,
    /// FIX lines for vertices that do not exist.
    pub unknown_fixed: usize,
}

impl G2oRepairs {
    /// Maximum number of unknown tags that are counted separately.
    pub const MAX_TAGS: usize = 32;

    /// Whether everything in the file was used as it was.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The repairs in words.
    pub fn notes(&self) -> Vec<String> {
        let mut notes: Vec<String> = self
            .ignored_tags
            .iter()
            .map(|(tag, n)| {
                format!("{} with the unknown tag {tag}: left out", counted(*n as u64, "line", "lines"))
            })
            .collect();
        let counts = [
            (self.duplicate_vertices, "vertices given again: the first counts"),
            (self.unusable_vertices, "vertices with numbers that are no pose"),
            (self.created_vertices, "vertices that only edges name: placed by following measurements"),
            (self.unusable_edges, "edges with numbers that are no measurement: left out"),
            (self.self_edges, "edges from a vertex to itself: left out"),
            (self.normalized_quaternions, "quaternions normalised"),
            (self.unknown_fixed, "FIX lines for vertices that do not exist"),
        ];
        notes.extend(counts.into_iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")));
        notes
    }

    fn ignore(&mut self, tag: &str) {
        let known = self.ignored_tags.contains_key(tag) || self.ignored_tags.len() < Self::MAX_TAGS;
        let tag: String = if known { tag.chars().take(64).collect() } else { "…".into() };
        *self.ignored_tags.entry(tag).or_default() += 1;
    }
}

/// Number of lines without a vertex or edge after which reading stops: such a file is not a pose graph and
/// may be endless.
const MOST_LINES_BEFORE_GRAPH: usize = 100_000;

/// Reads VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT and FIX. Other tags are counted. Lines may be
/// in any order.
///
/// # Errors
/// If reading fails, a line is too long or does not match its tag, poses in 2D and in 3D are mixed, or the
/// file contains no graph.
pub fn read_g2o(mut input: impl BufRead) -> Result<(Graph, G2oRepairs), G2oError> {
    let mut reader = Reader::default();
    let mut bytes = Vec::new();
    let mut line = 0;
    loop {
        line += 1;
        match read_line(&mut input, MAX_LINE, &mut bytes)? {
            Line::End => return reader.finish(),
            Line::TooLong => return Err(G2oError::LongLine { line, limit_mib: MAX_LINE >> 20 }),
            Line::Whole => reader.line(line, &String::from_utf8_lossy(&bytes))?,
        }
        if line > MOST_LINES_BEFORE_GRAPH && reader.two_d.is_empty() && reader.three_d.is_empty() {
            return Err(G2oError::Empty);
        }
    }
}

#[derive(Default)]
struct Reader {
    two_d: Builder<Rigid2>,
    three_d: Builder<Rigid3>,
    fixed: Vec<i64>,
    repairs: G2oRepairs,
    numbers: Vec<f64>,
}

impl Reader {
    fn line(&mut self, line: usize, text: &str) -> Result<(), G2oError> {
        let mut words = text.split_ascii_whitespace();
        let Some(tag) = words.next().filter(|t| !t.starts_with('#')) else { return Ok(()) };
        let is_2d = [Rigid2::TAGS.0, Rigid2::TAGS.1].contains(&tag);
        let is_3d = [Rigid3::TAGS.0, Rigid3::TAGS.1].contains(&tag);
        if (is_2d && !self.three_d.is_empty()) || (is_3d && !self.two_d.is_empty()) {
            return Err(G2oError::MixedDimensions { line, tag: tag.into() });
        }
        let Self { two_d, three_d, fixed, repairs, numbers } = self;
        let done = if is_2d {
            two_d.line(tag, words, numbers, repairs)
        } else if is_3d {
            three_d.line(tag, words, numbers, repairs)
        } else if tag == "FIX" {
            let ids: Option<Vec<i64>> = words.map(|w| w.parse().ok()).collect();
            ids.filter(|ids| !ids.is_empty()).map(|ids| fixed.extend(ids)).ok_or("whole numbers of vertices")
        } else {
            repairs.ignore(tag);
            Ok(())
        };
        done.map_err(|expected| G2oError::Malformed { line, tag: tag.into(), expected })
    }

    fn finish(mut self) -> Result<(Graph, G2oRepairs), G2oError> {
        let graph = if !self.two_d.is_empty() {
            Graph::TwoD(self.two_d.finish(&self.fixed, &mut self.repairs)?)
        } else if !self.three_d.is_empty() {
            Graph::ThreeD(self.three_d.finish(&self.fixed, &mut self.repairs)?)
        } else {
            return Err(G2oError::Empty);
        };
        Ok((graph, self.repairs))
    }
}

/// An edge that refers to its vertices by their numbers in the file.
struct RawEdge<P: GraphPose> {
    from: i64,
    to: i64,
    measurement: P,
    information: P::Information,
}

struct Builder<P: GraphPose> {
    vertices: Vec<Vertex<P>>,
    index_of: HashMap<i64, u32>,
    edges: Vec<RawEdge<P>>,
    seen: bool,
}

impl<P: GraphPose> Default for Builder<P> {
    fn default() -> Self {
        Self { vertices: Vec::new(), index_of: HashMap::new(), edges: Vec::new(), seen: false }
    }
}

impl<P: GraphPose> Builder<P> {
    fn is_empty(&self) -> bool {
        !self.seen
    }

    /// Parses a line; the error is the expected contents.
    fn line<'a>(
        &mut self,
        tag: &str,
        mut words: impl Iterator<Item = &'a str>,
        numbers: &mut Vec<f64>,
        repairs: &mut G2oRepairs,
    ) -> Result<(), &'static str> {
        self.seen = true;
        let mut id =
            || words.next().and_then(|w| w.parse::<i64>().ok()).ok_or("the whole number of a vertex");
        let is_vertex = tag == P::TAGS.0;
        let (from, to) = if is_vertex { (id()?, 0) } else { (id()?, id()?) };
        numbers.clear();
        for word in words {
            numbers.push(word.parse().map_err(|_| "numbers")?);
        }
        let pose_length = if P::SPACE_DIMENSION == 2 { 3 } else { 7 };
        if is_vertex {
            if numbers.len() != pose_length {
                return Err(if P::SPACE_DIMENSION == 2 { "id x y angle" } else { "id x y z qx qy qz qw" });
            }
            self.vertex(from, numbers, repairs);
        } else {
            if numbers.len() != pose_length + P::DIMENSION * (P::DIMENSION + 1) / 2 {
                return Err("two ids, a pose and the upper triangle of the information matrix");
            }
            self.edge(from, to, numbers.split_at(pose_length), repairs);
        }
        Ok(())
    }

    fn vertex(&mut self, id: i64, numbers: &[f64], repairs: &mut G2oRepairs) {
        let Some((pose, normalized)) = P::from_numbers(numbers) else {
            repairs.unusable_vertices += 1;
            return;
        };
        repairs.normalized_quaternions += usize::from(normalized);
        if !self.add(Vertex { id, pose, fixed: false }) {
            repairs.duplicate_vertices += 1;
        }
    }

    /// Adds a vertex unless its number is already used; returns whether it was added.
    fn add(&mut self, vertex: Vertex<P>) -> bool {
        let index = self.vertices.len() as u32;
        let is_new = !self.index_of.contains_key(&vertex.id);
        if is_new {
            self.index_of.insert(vertex.id, index);
            self.vertices.push(vertex);
        }
        is_new
    }

    fn edge(&mut self, from: i64, to: i64, (pose, upper): (&[f64], &[f64]), repairs: &mut G2oRepairs) {
        if from == to {
            repairs.self_edges += 1;
            return;
        }
        let (Some((measurement, normalized)), Some(information)) =
            (P::from_numbers(pose), P::information_from_upper(upper))
        else {
            repairs.unusable_edges += 1;
            return;
        };
        repairs.normalized_quaternions += usize::from(normalized);
        self.edges.push(RawEdge { from, to, measurement, information });
    }

    fn finish(mut self, fixed: &[i64], repairs: &mut G2oRepairs) -> Result<PoseGraph<P>, G2oError> {
        let given = self.vertices.len();
        let raw = std::mem::take(&mut self.edges);
        for edge in &raw {
            for id in [edge.from, edge.to] {
                self.add(Vertex { id, pose: P::identity(), fixed: false });
            }
        }
        if self.vertices.is_empty() {
            return Err(G2oError::Empty);
        }
        if u32::try_from(self.vertices.len().max(raw.len()).saturating_mul(2)).is_err() {
            return Err(G2oError::TooLarge);
        }
        repairs.created_vertices = self.vertices.len() - given;
        for id in fixed {
            match self.index_of.get(id).and_then(|i| self.vertices.get_mut(*i as usize)) {
                Some(vertex) => vertex.fixed = true,
                None => repairs.unknown_fixed += 1,
            }
        }
        let index = |id: &i64| self.index_of.get(id).copied().unwrap_or_default();
        let edges = raw
            .iter()
            .map(|e| Edge {
                from: index(&e.from),
                to: index(&e.to),
                measurement: e.measurement,
                information: e.information,
            })
            .collect();
        let mut graph = PoseGraph { vertices: self.vertices, edges };
        if repairs.created_vertices > 0 {
            let known = (0..graph.vertices.len()).map(|i| i < given).collect();
            let adjacency = Adjacency::new(&graph);
            follow(&mut graph, &adjacency, known);
        }
        Ok(graph)
    }
}
