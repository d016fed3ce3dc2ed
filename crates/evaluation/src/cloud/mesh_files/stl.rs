//! STL: triangles with their corners, as text or binary.

use super::{Mesh, bad};
use crate::EvaluationError;

/// Bytes of the header of a binary file, which includes the number of triangles, and of each triangle.
const HEAD: usize = 84;
const RECORD: usize = 50;

fn count(bytes: &[u8]) -> Option<usize> {
    let number = bytes.get(80..84)?.try_into().ok()?;
    usize::try_from(u32::from_le_bytes(number)).ok()
}

/// Text files contain facets soon after `solid`. Binary files have exactly the length given by their number
/// of triangles.
pub(super) fn is_stl(bytes: &[u8]) -> bool {
    is_text(bytes) || count(bytes).is_some_and(|n| n > 0 && bytes.len() == HEAD + RECORD * n)
}

fn is_text(bytes: &[u8]) -> bool {
    let start = bytes.get(..1000.min(bytes.len())).unwrap_or_default();
    bytes.starts_with(b"solid") && String::from_utf8_lossy(start).contains("facet")
}

pub(super) fn read(bytes: &[u8]) -> Result<Mesh, EvaluationError> {
    let mut mesh = Mesh::default();
    let mut corners = Vec::new();
    if is_text(bytes) {
        let text = std::str::from_utf8(bytes).map_err(|_| bad("it is not text as its first line says"))?;
        let mut words = text.split_ascii_whitespace();
        while let Some(word) = words.next() {
            match word {
                "vertex" => {
                    let mut next = || words.next().and_then(|w| w.parse().ok()).unwrap_or(f64::NAN);
                    corners.push([next(), next(), next()]);
                }
                "endfacet" => {
                    let all: Vec<usize> = (0..corners.len()).collect();
                    mesh.add(&corners, &all);
                    corners.clear();
                }
                _ => {}
            }
        }
        return Ok(mesh);
    }
    for record in bytes.get(HEAD..).unwrap_or_default().chunks_exact(RECORD) {
        corners.clear();
        // The record starts with the normal, which is skipped because it follows from the corners.
        corners.extend(record[12..48].chunks_exact(12).map(|corner| {
            std::array::from_fn(|k| {
                let b = &corner[4 * k..4 * k + 4];
                f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            })
        }));
        mesh.add(&corners, &[0, 1, 2]);
    }
    Ok(mesh)
}
