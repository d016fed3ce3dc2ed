//! PLY with faces: ascii, and binary of both byte orders.

use super::{Mesh, bad};
use crate::EvaluationError;

/// A face has no more corners than this.
const MAX_CORNERS: usize = 1 << 16;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// How a number is stored: its bytes, whether it is a float, whether it has a sign.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Scalar {
    bytes: usize,
    float: bool,
    signed: bool,
}

impl Scalar {
    fn named(name: &str) -> Result<Self, EvaluationError> {
        let (bytes, float, signed) = match name {
            "char" | "int8" => (1, false, true),
            "uchar" | "uint8" => (1, false, false),
            "short" | "int16" => (2, false, true),
            "ushort" | "uint16" => (2, false, false),
            "int" | "int32" => (4, false, true),
            "uint" | "uint32" => (4, false, false),
            "float" | "float32" => (4, true, true),
            "double" | "float64" => (8, true, true),
            _ => return Err(bad(format!("its header has a property of the unknown type \"{name}\""))),
        };
        Ok(Self { bytes, float, signed })
    }
}

#[derive(Clone, Debug)]
struct Property {
    name: String,
    /// How the length of a list is stored; none for a single number.
    length: Option<Scalar>,
    scalar: Scalar,
}

#[derive(Clone, Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

pub(super) fn read(bytes: &[u8]) -> Result<Mesh, EvaluationError> {
    let (encoding, elements, start) = header(bytes)?;
    let mut values = Values { encoding, rest: bytes.get(start..).unwrap_or_default() };
    let (mut mesh, mut vertices) = (Mesh::default(), Vec::new());
    let (mut list, mut corners) = (Vec::new(), Vec::new());
    for element in elements {
        let place = |name| element.properties.iter().position(|p| p.name == name && p.length.is_none());
        let axes = [place("x"), place("y"), place("z")];
        let is_face = |p: &Property| p.length.is_some() && p.name.starts_with("vertex_ind");
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

/// Encoding, elements, and where the data begin.
fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, usize), EvaluationError> {
    let (mut encoding, mut elements, mut position) = (None, Vec::<Element>::new(), 0);
    for line in bytes.split_inclusive(|byte| *byte == b'\n').take(10_000) {
        position += line.len();
        let line = std::str::from_utf8(line).map_err(|_| bad("its header is not text"))?;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["format", "ascii", ..] => encoding = Some(Encoding::Ascii),
            ["format", "binary_little_endian", ..] => encoding = Some(Encoding::Little),
            ["format", "binary_big_endian", ..] => encoding = Some(Encoding::Big),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad("its header has a count that is no number"))?;
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", rest @ .., name] => {
                let (length, scalar) = match rest {
                    ["list", length, scalar] => (Some(Scalar::named(length)?), Scalar::named(scalar)?),
                    [scalar] => (None, Scalar::named(scalar)?),
                    _ => return Err(bad("its header has a property that cannot be understood")),
                };
                let property = Property { name: (*name).to_owned(), length, scalar };
                elements
                    .last_mut()
                    .ok_or_else(|| bad("its header is out of order"))?
                    .properties
                    .push(property);
            }
            ["end_header"] => {
                let encoding = encoding.ok_or_else(|| bad("its header does not say how it is encoded"))?;
                // Elements without properties would take no bytes and no end.
                elements.retain(|e| !e.properties.is_empty());
                return Ok((encoding, elements, position));
            }
            _ => {}
        }
    }
    Err(bad("its header has no end"))
}

/// Numbers one after the other.
struct Values<'a> {
    encoding: Encoding,
    rest: &'a [u8],
}

impl Values<'_> {
    /// The number, or the numbers of the list, of one property.
    fn read(&mut self, property: &Property, list: &mut Vec<f64>) -> Result<(), EvaluationError> {
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
        if self.encoding == Encoding::Ascii {
            let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(ends)?;
            let word = &self.rest[start..];
            let (word, rest) =
                word.split_at(word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len()));
            self.rest = rest;
            let text = std::str::from_utf8(word).ok();
            return text.and_then(|t| t.parse().ok()).ok_or_else(|| bad("it has a word that is no number"));
        }
        let (bytes, rest) = self.rest.split_at_checked(scalar.bytes).ok_or_else(ends)?;
        self.rest = rest;
        let mut bits = [0; 8];
        for (i, byte) in bytes.iter().enumerate() {
            let at = if self.encoding == Encoding::Little { i } else { scalar.bytes - 1 - i };
            bits[at] = *byte;
        }
        let bits = u64::from_le_bytes(bits);
        Ok(match (scalar.float, scalar.bytes) {
            (true, 4) => f64::from(f32::from_bits(bits as u32)),
            (true, _) => f64::from_bits(bits),
            (false, bytes) => {
                let unused = 64 - 8 * bytes as u32;
                if scalar.signed { ((bits << unused) as i64 >> unused) as f64 } else { bits as f64 }
            }
        })
    }
}

fn ends() -> EvaluationError {
    bad("it ends before all that its header promises")
}
