//! Writes g2o files.

use std::io::{self, Write};

use super::graph::{Graph, PoseGraph};
use super::pose::GraphPose;

/// Writes vertices, fixed vertices and edges. Numbers are written with as many digits as are needed to read
/// the same numbers back.
///
/// # Errors
/// If writing fails.
pub fn write_g2o(graph: &Graph, mut out: impl Write) -> io::Result<()> {
    match graph {
        Graph::TwoD(graph) => write(graph, &mut out),
        Graph::ThreeD(graph) => write(graph, &mut out),
    }?;
    out.flush()
}

fn write<P: GraphPose>(graph: &PoseGraph<P>, out: &mut impl Write) -> io::Result<()> {
    let (vertex_tag, edge_tag) = P::TAGS;
    for vertex in &graph.vertices {
        write!(out, "{vertex_tag} {}", vertex.id)?;
        write_numbers(&vertex.pose.to_numbers(), out)?;
        writeln!(out)?;
    }
    for vertex in graph.vertices.iter().filter(|v| v.fixed) {
        writeln!(out, "FIX {}", vertex.id)?;
    }
    for (index, edge) in graph.edges.iter().enumerate() {
        let id = |vertex: u32| graph.vertices.get(vertex as usize).map(|v| v.id);
        let (Some(from), Some(to)) = (id(edge.from), id(edge.to)) else {
            let message = format!("edge {index} points to a vertex that does not exist");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
        };
        write!(out, "{edge_tag} {from} {to}")?;
        write_numbers(&edge.measurement.to_numbers(), out)?;
        let information = edge.information.as_ref();
        for (row, values) in information.chunks(P::DIMENSION).enumerate() {
            write_numbers(&values[row..], out)?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn write_numbers(numbers: &[f64], out: &mut impl Write) -> io::Result<()> {
    numbers.iter().try_for_each(|v| write!(out, " {v}"))
}
