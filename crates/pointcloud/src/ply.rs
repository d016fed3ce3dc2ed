//! Reads and writes the Polygon File Format: the vertices of a file, in ascii or binary of either byte order.

use std::fmt::Write;
use std::path::Path;

use portolan_issue::{Issue, IssueKind, IssueLog};

use crate::BATCH_POINTS;
use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::fields::{Column, Columns, Role};
use crate::format::{CloudReader, CloudWriter, Encoding, Precision, WriteOptions, Written};
use crate::input::{Input, numbers};
use crate::output::Output;
use crate::ply_header::{PlyElement, PlyHeader, PlyHeaderError, PlyHeaderLines, PlyProperty, PlyStorage};
use crate::xyz::push_text;

/// Maximum size of a row, bytes.
const MAX_ROW: usize = 1 << 16;
/// Size of the header, bytes. It is written last; a comment pads it to this size.
const HEADER_BYTES: usize = 512;

/// Reads vertices.
pub(crate) struct PlyReader {
    input: Input,
    storage: PlyStorage,
    columns: Columns,
    row_bytes: usize,
    total: u64,
    left: u64,
    bytes: Vec<u8>,
    issues: IssueLog,
}

/// Reads storage and elements from the header.
fn header(input: &mut Input) -> Result<PlyHeader, CloudError> {
    let path = input.path.clone();
    let damaged = |error: PlyHeaderError| CloudError::damaged(&path, error.to_string());
    let mut lines = PlyHeaderLines::default();
    while let Some(line) = input.line()? {
        if let Some(header) = lines.add(line).map_err(damaged)? {
            return Ok(header);
        }
    }
    Err(damaged(PlyHeaderError::NoEnd))
}

impl PlyReader {
    /// # Errors
    /// Reading fails, the header is damaged, there are no vertices with x, y and z, or vertices have lists.
    pub fn open(mut input: Input) -> Result<Self, CloudError> {
        let path = input.path.clone();
        let path = path.as_path();
        let PlyHeader { storage, elements } = header(&mut input)?;
        let Some(at) = elements.iter().position(|element| element.name == "vertex") else {
            return Err(CloudError::damaged(path, "it has no element \"vertex\""));
        };
        let mut issues = IssueLog::default();
        for element in elements.iter().take(at) {
            skip(&mut input, storage, element)?;
        }
        let vertex = elements.get(at).cloned().unwrap_or(PlyElement {
            name: String::new(),
            count: 0,
            properties: Vec::new(),
        });
        let (mut offset, mut all) = (0, Vec::new());
        for (place, property) in vertex.properties.iter().enumerate() {
            let PlyProperty { name, length: None, scalar } = property else {
                return Err(CloudError::damaged(path, "its vertices have lists, which are not understood"));
            };
            let place = if storage == PlyStorage::Ascii { place } else { offset };
            all.extend(Role::of(name).map(|role| Column { role, at: place, scalar: *scalar }));
            offset += scalar.bytes();
        }
        let columns = Columns::of(&all).filter(|_| offset <= MAX_ROW);
        let columns = columns.ok_or_else(|| CloudError::damaged(path, "its vertices have no x, y and z"))?;
        let mut total = vertex.count;
        if storage != PlyStorage::Ascii
            && let Some(there) = input.rows_left(offset as u64)
        {
            issues.count(IssueKind::CloudPointsMissing, total.saturating_sub(there));
            total = total.min(there);
        }
        Ok(Self { input, storage, columns, row_bytes: offset, total, left: total, bytes: Vec::new(), issues })
    }

    fn read_ascii(&mut self, batch: &mut PointCloud, count: u64) -> Result<(), CloudError> {
        let mut values = Vec::new();
        for _ in 0..count {
            let Some(line) = self.input.line()? else {
                self.issues.count(IssueKind::CloudPointsMissing, self.left);
                self.left = 0;
                return Ok(());
            };
            self.left -= 1;
            if !numbers(line, &mut values) || values.len() < 3 {
                self.issues.count(IssueKind::CloudLineUnreadable, 1);
                continue;
            }
            let is_finite = self.columns.push(|column| values.get(column.at).copied().unwrap_or(0.0), batch);
            self.issues.count(IssueKind::CloudPointNotFinite, u64::from(!is_finite));
        }
        Ok(())
    }

    fn read_binary(&mut self, batch: &mut PointCloud, count: u64, is_big: bool) -> Result<(), CloudError> {
        self.bytes.resize(count as usize * self.row_bytes, 0);
        let got = self.input.fill(&mut self.bytes)?;
        self.left -= count;
        if got < self.bytes.len() {
            // In a pipe a missing end is found only here.
            let missing = count - (got / self.row_bytes.max(1)) as u64;
            self.issues.count(IssueKind::CloudPointsMissing, missing.saturating_add(self.left));
            self.left = 0;
        }
        for row in self.bytes.get(..got).unwrap_or_default().chunks_exact(self.row_bytes) {
            let value = |c: &Column| c.scalar.decode(row.get(c.at..).unwrap_or_default(), is_big);
            let is_finite = self.columns.push(value, batch);
            self.issues.count(IssueKind::CloudPointNotFinite, u64::from(!is_finite));
        }
        Ok(())
    }
}

/// Skips an element before the vertices.
fn skip(input: &mut Input, storage: PlyStorage, element: &PlyElement) -> Result<(), CloudError> {
    let PlyStorage::Binary { is_big } = storage else {
        for _ in 0..element.count {
            if input.line()?.is_none() {
                break;
            }
        }
        return Ok(());
    };
    let fixed: Option<usize> =
        element.properties.iter().map(|p| p.length.is_none().then(|| p.scalar.bytes())).sum();
    if let Some(bytes) = fixed {
        input.skip(element.count.saturating_mul(bytes as u64))?;
        return Ok(());
    }
    let mut word = [0; 8];
    for _ in 0..element.count {
        for property in &element.properties {
            let mut bytes = property.scalar.bytes() as u64;
            if let Some(count) = property.length {
                let word = word.get_mut(..count.bytes()).unwrap_or_default();
                let got = input.fill(word)?;
                let number = count.decode(word, is_big).max(0.0) as u64;
                bytes = if got == word.len() { bytes.saturating_mul(number) } else { u64::MAX };
            }
            // The header may state any number of elements.
            if !input.skip(bytes)? {
                return Ok(());
            }
        }
    }
    Ok(())
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
                PlyStorage::Ascii => self.read_ascii(batch, count)?,
                PlyStorage::Binary { is_big } => self.read_binary(batch, count, is_big)?,
            }
        }
        Ok(!batch.is_empty())
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
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
    /// # Errors
    /// The file cannot be created, or the header cannot be written.
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

/// Appends a point as little-endian bytes: position, and intensity, time and colour if requested.
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
