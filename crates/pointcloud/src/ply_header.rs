//! Reads the header of a PLY file: its storage, elements and properties.

use crate::fields::Scalar;

/// Maximum number of lines of a header.
const MAX_LINES: usize = 10_000;

/// Storage of the numbers of a PLY file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyStorage {
    /// As text.
    Ascii,
    /// As binary numbers.
    Binary {
        /// Whether the most significant byte comes first.
        is_big: bool,
    },
}

/// A property of an element: a number, or a list of numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyProperty {
    /// Its name.
    pub name: String,
    /// Type of the length of a list; none for a single number.
    pub length: Option<Scalar>,
    /// Type of its numbers.
    pub scalar: Scalar,
}

/// A kind of row, such as vertices or faces.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyElement {
    /// Its name.
    pub name: String,
    /// Number of rows stated in the header.
    pub count: u64,
    /// Properties of each row, in this order.
    pub properties: Vec<PlyProperty>,
}

/// Content of a header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyHeader {
    /// Storage of numbers.
    pub storage: PlyStorage,
    /// Elements after the header, in this order.
    pub elements: Vec<PlyElement>,
}

/// Why a header cannot be parsed. The text follows the name of the file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlyHeaderError {
    /// A line is not valid, or comes too early.
    #[error("its header has the line \"{0}\"")]
    Line(String),
    /// There is no line `format …`.
    #[error("its header names no format")]
    NoFormat,
    /// There is no line `end_header` within the maximum number of lines.
    #[error("its header has no end")]
    NoEnd,
}

/// Parses a header line by line.
#[derive(Clone, Debug, Default)]
pub struct PlyHeaderLines {
    storage: Option<PlyStorage>,
    elements: Vec<PlyElement>,
    lines: usize,
}

impl PlyHeaderLines {
    /// Parses the next line, starting with the first of the file. Returns the header after its last line.
    ///
    /// # Errors
    /// Fails for lines that do not belong to a header, and for too many lines.
    pub fn add(&mut self, line: &str) -> Result<Option<PlyHeader>, PlyHeaderError> {
        self.lines += 1;
        if self.lines > MAX_LINES {
            return Err(PlyHeaderError::NoEnd);
        }
        let bad = || PlyHeaderError::Line(line.trim_end().chars().take(100).collect());
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            [] | ["ply" | "comment" | "obj_info", ..] => {}
            ["format", kind, ..] => self.storage = Some(storage(kind).ok_or_else(bad)?),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad())?;
                self.elements.push(PlyElement { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", kind @ .., name] => {
                let (length, kind) = match kind {
                    ["list", length, kind] => (Some(scalar(length).ok_or_else(bad)?), kind),
                    [kind] => (None, kind),
                    _ => return Err(bad()),
                };
                let scalar = scalar(kind).ok_or_else(bad)?;
                let element = self.elements.last_mut().ok_or_else(bad)?;
                element.properties.push(PlyProperty { name: (*name).to_owned(), length, scalar });
            }
            ["end_header"] => {
                let storage = self.storage.ok_or(PlyHeaderError::NoFormat)?;
                return Ok(Some(PlyHeader { storage, elements: std::mem::take(&mut self.elements) }));
            }
            _ => return Err(bad()),
        }
        Ok(None)
    }
}

fn storage(name: &str) -> Option<PlyStorage> {
    Some(match name {
        "ascii" => PlyStorage::Ascii,
        "binary_little_endian" => PlyStorage::Binary { is_big: false },
        "binary_big_endian" => PlyStorage::Binary { is_big: true },
        _ => return None,
    })
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Option<PlyHeader>, PlyHeaderError> {
        let mut lines = PlyHeaderLines::default();
        for line in text.lines() {
            if let Some(header) = lines.add(line)? {
                return Ok(Some(header));
            }
        }
        Ok(None)
    }

    #[test]
    fn elements_and_lists_are_understood() {
        let text = "ply\r\nformat binary_big_endian 1.0\r\ncomment x y\nelement vertex 3\nproperty double x\n\
            element face 2\nproperty list uchar int vertex_indices\nend_header\n";
        let header = read(text).unwrap().unwrap();
        assert_eq!(header.storage, PlyStorage::Binary { is_big: true });
        assert_eq!((header.elements[0].count, header.elements[0].properties[0].scalar), (3, Scalar::F64));
        let list = &header.elements[1].properties[0];
        assert_eq!(
            (list.length, list.scalar, &*list.name),
            (Some(Scalar::U8), Scalar::I32, "vertex_indices")
        );
    }

    #[test]
    fn invalid_headers_are_errors() {
        assert_eq!(read("ply\nend_header"), Err(PlyHeaderError::NoFormat));
        for line in ["property float x", "format text 1.0", "element vertex many", "nonsense"] {
            assert_eq!(read(line), Err(PlyHeaderError::Line(line.to_owned())));
        }
        assert_eq!(read(&"comment\n".repeat(20_000)), Err(PlyHeaderError::NoEnd));
        assert_eq!(read("ply\nformat ascii 1.0"), Ok(None));
    }
}
