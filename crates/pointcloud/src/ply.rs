//! Polygon File Format: the vertices of a file, in ascii or binary of either byte order.

use std::fmt::Write;
use std::path::Path;

use crate::BATCH_POINTS;
use crate::cloud::{Attributes, PointCloud};
use crate::error::{CloudError, NOT_FINITE, Repair, Repairs};
use crate::fields::{Column, Columns, Role, Scalar};
use crate::format::{CloudReader, CloudWriter, Encoding, Precision, WriteOptions, Written};
use crate::input::{Input, numbers};
use crate::output::Output;
use crate::xyz::push_text;

/// Headers are not longer.
const MAX_HEADER_LINES: usize = 10_000;
/// Rows are not longer, bytes.
const MAX_ROW: usize = 1 << 16;
/// The header is written at last; a comment fills what is left of this, bytes.
const HEADER_BYTES: usize = 512;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Storage {
    Ascii,
    Binary { is_big: bool },
}

#[derive(Clone, Debug)]
enum Property {
    Scalar { name: String, scalar: Scalar },
    List { count: Scalar, items: Scalar },
}

#[derive(Clone, Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

/// Reads vertices.
pub(crate) struct PlyReader {
    input: Input,
    storage: Storage,
    columns: Columns,
    row_bytes: usize,
    total: u64,
    left: u64,
    bytes: Vec<u8>,
    repairs: Repairs,
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

/// Storage and elements of a header.
fn header(input: &mut Input) -> Result<(Storage, Vec<Element>), CloudError> {
    let path = input.path.clone();
    let bad = |line: &str| CloudError::damaged(&path, format!("its header has the line \"{line}\""));
    let (mut storage, mut elements): (Option<Storage>, Vec<Element>) = (None, Vec::new());
    for _ in 0..MAX_HEADER_LINES {
        let Some(line) = input.line()? else { break };
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            [] | ["ply" | "comment" | "obj_info", ..] => {}
            ["format", kind, ..] => {
                storage = Some(match *kind {
                    "ascii" => Storage::Ascii,
                    "binary_little_endian" => Storage::Binary { is_big: false },
                    "binary_big_endian" => Storage::Binary { is_big: true },
                    _ => return Err(bad(line)),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad(line))?;
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", "list", count, items, _] => {
                let (Some(count), Some(items)) = (scalar(count), scalar(items)) else {
                    return Err(bad(line));
                };
                let element = elements.last_mut().ok_or_else(|| bad(line))?;
                element.properties.push(Property::List { count, items });
            }
            ["property", kind, name] => {
                let scalar = scalar(kind).ok_or_else(|| bad(line))?;
                let element = elements.last_mut().ok_or_else(|| bad(line))?;
                element.properties.push(Property::Scalar { name: (*name).to_owned(), scalar });
            }
            ["end_header"] => {
                let storage =
                    storage.ok_or_else(|| CloudError::damaged(&path, "its header names no format"))?;
                return Ok((storage, elements));
            }
            _ => return Err(bad(line)),
        }
    }
    Err(CloudError::damaged(&path, "its header has no end"))
}

impl PlyReader {
    pub fn open(path: &Path) -> Result<Self, CloudError> {
        let mut input = Input::open(path)?;
        let (storage, elements) = header(&mut input)?;
        let Some(at) = elements.iter().position(|element| element.name == "vertex") else {
            return Err(CloudError::damaged(path, "it has no element \"vertex\""));
        };
        let mut repairs = Repairs::default();
        for element in elements.iter().take(at) {
            skip(&mut input, storage, element)?;
        }
        let vertex = elements.get(at).cloned().unwrap_or(Element {
            name: String::new(),
            count: 0,
            properties: Vec::new(),
        });
        let (mut offset, mut all) = (0, Vec::new());
        for (place, property) in vertex.properties.iter().enumerate() {
            let Property::Scalar { name, scalar } = property else {
                return Err(CloudError::damaged(path, "its vertices have lists, which are not understood"));
            };
            let place = if storage == Storage::Ascii { place } else { offset };
            all.extend(Role::of(name).map(|role| Column { role, at: place, scalar: *scalar }));
            offset += scalar.bytes();
        }
        let columns = Columns::of(&all).filter(|_| offset <= MAX_ROW);
        let columns = columns.ok_or_else(|| CloudError::damaged(path, "its vertices have no x, y and z"))?;
        let mut total = vertex.count;
        if storage != Storage::Ascii {
            let there = input.length().saturating_sub(input.position()?) / offset.max(1) as u64;
            repairs.add(
                "points that the header promises and the file does not have",
                true,
                total.saturating_sub(there),
            );
            total = total.min(there);
        }
        Ok(Self {
            input,
            storage,
            columns,
            row_bytes: offset,
            total,
            left: total,
            bytes: Vec::new(),
            repairs,
        })
    }

    fn read_ascii(&mut self, batch: &mut PointCloud, count: u64) -> Result<(), CloudError> {
        let mut values = Vec::new();
        for _ in 0..count {
            let Some(line) = self.input.line()? else {
                self.repairs.add(
                    "points that the header promises and the file does not have",
                    true,
                    self.left,
                );
                self.left = 0;
                return Ok(());
            };
            self.left -= 1;
            if !numbers(line, &mut values) || values.len() < 3 {
                self.repairs.add("lines that are no points were left out", true, 1);
                continue;
            }
            let is_finite = self.columns.push(|column| values.get(column.at).copied().unwrap_or(0.0), batch);
            self.repairs.add(NOT_FINITE, false, u64::from(!is_finite));
        }
        Ok(())
    }

    fn read_binary(&mut self, batch: &mut PointCloud, count: u64, is_big: bool) -> Result<(), CloudError> {
        self.bytes.resize(count as usize * self.row_bytes, 0);
        let got = self.input.fill(&mut self.bytes)?;
        self.left -= count;
        for row in self.bytes.get(..got).unwrap_or_default().chunks_exact(self.row_bytes) {
            let value = |c: &Column| c.scalar.decode(row.get(c.at..).unwrap_or_default(), is_big);
            let is_finite = self.columns.push(value, batch);
            self.repairs.add(NOT_FINITE, false, u64::from(!is_finite));
        }
        Ok(())
    }
}

/// Skips an element before the vertices.
fn skip(input: &mut Input, storage: Storage, element: &Element) -> Result<(), CloudError> {
    let Storage::Binary { is_big } = storage else {
        for _ in 0..element.count {
            if input.line()?.is_none() {
                break;
            }
        }
        return Ok(());
    };
    let fixed: Option<usize> = element
        .properties
        .iter()
        .map(|p| if let Property::Scalar { scalar, .. } = p { Some(scalar.bytes()) } else { None })
        .sum();
    let position = input.position()?;
    if let Some(bytes) = fixed {
        return input.seek(position.saturating_add(element.count.saturating_mul(bytes as u64)));
    }
    let (mut position, length) = (position, input.length());
    let mut word = [0; 8];
    for _ in 0..element.count {
        for property in &element.properties {
            match property {
                Property::Scalar { scalar, .. } => position += scalar.bytes() as u64,
                Property::List { count, items } => {
                    input.seek(position)?;
                    input.fill(word.get_mut(..count.bytes()).unwrap_or_default())?;
                    let number = count.decode(&word, is_big).max(0.0) as u64;
                    position +=
                        count.bytes() as u64 + number.saturating_mul(items.bytes() as u64).min(length);
                }
            }
        }
        if position >= length {
            break;
        }
    }
    input.seek(position.min(length))
}

impl CloudReader for PlyReader {
    fn attributes(&self) -> Attributes {
        self.columns.attributes()
    }

    fn count(&self) -> Option<u64> {
        Some(self.total)
    }

    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError> {
        batch.reset(self.attributes());
        while batch.is_empty() && self.left > 0 {
            let count = self.left.min(BATCH_POINTS as u64);
            match self.storage {
                Storage::Ascii => self.read_ascii(batch, count)?,
                Storage::Binary { is_big } => self.read_binary(batch, count, is_big)?,
            }
        }
        Ok(!batch.is_empty())
    }

    fn repairs(&self) -> Vec<Repair> {
        self.repairs.list()
    }
}

/// Writes vertices.
pub(crate) struct PlyWriter {
    output: Output,
    attributes: Attributes,
    is_ascii: bool,
    is_double: bool,
    bytes: Vec<u8>,
    written: Written,
}

impl PlyWriter {
    pub fn create(path: &Path, attributes: Attributes, options: &WriteOptions) -> Result<Self, CloudError> {
        let mut writer = Self {
            output: Output::create(path)?,
            attributes,
            is_ascii: options.encoding == Encoding::Ascii,
            is_double: options.precision != Precision::Single,
            bytes: Vec::new(),
            written: Written { points: 0, not_finite: 0 },
        };
        let header = writer.header();
        writer.output.append(header.as_bytes())?;
        Ok(writer)
    }

    /// The header, always of the same length.
    fn header(&self) -> String {
        let kind = if self.is_ascii { "ascii" } else { "binary_little_endian" };
        let number = if self.is_double { "double" } else { "float" };
        let mut text = format!("ply\nformat {kind} 1.0\nelement vertex {}\n", self.written.points);
        for axis in ["x", "y", "z"] {
            let _ = writeln!(text, "property {number} {axis}");
        }
        if self.attributes.intensity {
            text += "property float intensity\n";
        }
        if self.attributes.time {
            text += "property double time\n";
        }
        if self.attributes.color {
            text += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
        }
        let filler = HEADER_BYTES.saturating_sub(text.len() + "comment \nend_header\n".len());
        let _ = write!(text, "comment {}\nend_header\n", ".".repeat(filler));
        text
    }
}

/// Appends a point as little-endian bytes: position, intensity, time, colour as asked for.
pub(crate) fn push_bytes(
    bytes: &mut Vec<u8>,
    cloud: &PointCloud,
    index: usize,
    attributes: Attributes,
    is_double: bool,
) {
    for value in cloud.position(index) {
        if is_double {
            bytes.extend_from_slice(&value.to_le_bytes());
        } else {
            bytes.extend_from_slice(&(value as f32).to_le_bytes());
        }
    }
    if attributes.intensity {
        bytes.extend_from_slice(&cloud.intensity(index).unwrap_or(0.0).to_le_bytes());
    }
    if attributes.time {
        bytes.extend_from_slice(&cloud.time(index).unwrap_or(0.0).to_le_bytes());
    }
    if attributes.color {
        bytes.extend_from_slice(&cloud.color(index).unwrap_or([0; 3]));
    }
}

impl CloudWriter for PlyWriter {
    fn write(&mut self, batch: &PointCloud) -> Result<(), CloudError> {
        self.bytes.clear();
        let mut text = String::new();
        for index in 0..batch.len() {
            if !batch.position(index).iter().all(|v| v.is_finite()) {
                self.written.not_finite += 1;
                continue;
            }
            self.written.points += 1;
            if self.is_ascii {
                push_text(&mut text, batch, index, self.attributes);
            } else {
                push_bytes(&mut self.bytes, batch, index, self.attributes, self.is_double);
            }
        }
        self.output.append(if self.is_ascii { text.as_bytes() } else { &self.bytes })
    }

    fn finish(mut self: Box<Self>) -> Result<Written, CloudError> {
        let header = self.header();
        self.output.overwrite(0, header.as_bytes())?;
        self.output.finish()?;
        Ok(self.written)
    }
}
