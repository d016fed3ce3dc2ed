//! Meshes from files: PLY (ascii and binary), OBJ and STL (ascii and binary), distinguished by content.

mod obj;
mod ply;
mod stl;

use super::Triangle;
use crate::EvaluationError;

/// A mesh, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Its triangles; polygons are cut into fans.
    pub triangles: Vec<Triangle>,
    /// Number of faces that were left out because they refer to vertices that do not exist or are not finite.
    pub left_out: usize,
}

impl Mesh {
    /// Adds a polygon given by the indices of its vertices.
    fn add(&mut self, vertices: &[[f64; 3]], corners: &[usize]) {
        let corner = |i: usize| vertices.get(i).copied().filter(|p| p.iter().all(|v| v.is_finite()));
        let places: Option<Vec<[f64; 3]>> = corners.iter().map(|i| corner(*i)).collect();
        match places.as_deref() {
            Some([first, rest @ ..]) if rest.len() >= 2 => {
                self.triangles.extend(rest.windows(2).map(|pair| Triangle([*first, pair[0], pair[1]])));
            }
            _ => self.left_out += 1,
        }
    }
}

fn bad(reason: impl Into<String>) -> EvaluationError {
    EvaluationError::BadMesh(reason.into())
}

/// Whether the bytes begin like a mesh and not like a table of boxes or points. A PLY file may still turn out
/// to be a cloud without faces.
pub fn is_mesh(bytes: &[u8]) -> bool {
    bytes.starts_with(b"ply") || stl::is_stl(bytes) || obj::is_obj(bytes)
}

/// Reads a mesh from the bytes of a file.
///
/// # Errors
/// Fails for files that are damaged, of another format, or without faces.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, EvaluationError> {
    let mesh = if bytes.starts_with(b"ply") {
        ply::read(bytes)?
    } else if stl::is_stl(bytes) {
        stl::read(bytes)?
    } else if obj::is_obj(bytes) {
        obj::read(bytes)
    } else {
        return Err(bad("it is neither PLY nor OBJ nor STL"));
    };
    match mesh.triangles.is_empty() {
        true => Err(bad("it has no faces")),
        false => Ok(mesh),
    }
}

#[cfg(test)]
mod tests;
