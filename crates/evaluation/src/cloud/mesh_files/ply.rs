//! PLY with faces: ascii, and binary of both byte orders.

use portolan_pointcloud::{PlyHeader, PlyHeaderError, PlyHeaderLines, PlyProperty, PlyStorage, Scalar};

use super::{Mesh, bad};
use crate::EvaluationError;

/// Maximum number of corners of a face.
const MAX_CORNERS: usize = 1 << 16;

pub(super) fn read(bytes: &[u8]) -> Result<Mesh, EvaluationError> {
    let (PlyHeader { storage, elements }, start) = header(bytes)?;
    let mut values = Values { storage, rest: bytes.get(start..).unwrap_or_default() };
    let (mut mesh, mut vertices) = (Mesh::default(), Vec::new());
    let (mut list, mut corners) = (Vec::new(), Vec::new());
    for element in elements {
        let place = |name| element.properties.iter().position(|p| p.name == name && p.length.is_none());
        let axes = [place("x"), place("y"), place("z")];
        let is_face = |p: &PlyProperty| p.length.is_some() && p.name.starts_with("vertex_ind");
        for _ in 0..element.count {
            let mut vertex = [f64::NAN; 3];
            for (index, property) in element.properties.iter().enumerate() {
                values.read(property, &mut list)?;
                if let (Some(axis), Some(value)) = (axes.iter().position(|a| *a == Some(index)), list.first())
                {
                    vertex[axis] = *value;
                }
                if element.name == "face" && is_face(property) {
                    corners.clear();
                    corners.extend(list.iter().map(|v| if *v >= 0.0 { *v as usize } else { usize::MAX }));
                    mesh.add(&vertices, &corners);
                }
            }
            if element.name == "vertex" {
                vertices.push(vertex);
            }
        }
    }
    Ok(mesh)
}

/// The header, and the offset of the data.
fn header(bytes: &[u8]) -> Result<(PlyHeader, usize), EvaluationError> {
    let (mut lines, mut position) = (PlyHeaderLines::default(), 0);
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        position += line.len();
        let line = std::str::from_utf8(line).map_err(|_| bad("its header is not text"))?;
        if let Some(mut header) = lines.add(line).map_err(|error| bad(error.to_string()))? {
            // Elements without properties take no bytes: nothing would bound the number of them.
            header.elements.retain(|e| !e.properties.is_empty());
            return Ok((header, position));
        }
    }
    Err(bad(PlyHeaderError::NoEnd.to_string()))
}

/// Reads consecutive numbers.
struct Values<'a> {
    storage: PlyStorage,
    rest: &'a [u8],
}

impl Values<'_> {
    /// The number, or the numbers of the list, of one property.
    fn read(&mut self, property: &PlyProperty, list: &mut Vec<f64>) -> Result<(), EvaluationError> {
        list.clear();
        let count = match property.length {
            Some(length) => self.number(length)?,
            None => 1.0,
        };
        if !(0.0..=MAX_CORNERS as f64).contains(&count) {
            return Err(bad("it has a list of an impossible length"));
        }
        for _ in 0..count as usize {
            list.push(self.number(property.scalar)?);
        }
        Ok(())
    }

    fn number(&mut self, scalar: Scalar) -> Result<f64, EvaluationError> {
        let PlyStorage::Binary { is_big } = self.storage else {
            let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(ends)?;
            let word = &self.rest[start..];
            let (word, rest) =
                word.split_at(word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len()));
            self.rest = rest;
            let text = std::str::from_utf8(word).ok();
            return text.and_then(|t| t.parse().ok()).ok_or_else(|| bad("it has a word that is no number"));
        };
        let (bytes, rest) = self.rest.split_at_checked(scalar.bytes()).ok_or_else(ends)?;
        self.rest = rest;
        Ok(scalar.decode(bytes, is_big))
    }
}

fn ends() -> EvaluationError {
    bad("it ends before all that its header promises")
}
