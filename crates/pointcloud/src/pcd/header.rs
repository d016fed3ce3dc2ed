//! Reads the header of a PCD file.

use crate::error::CloudError;
use crate::fields::{Column, Columns, Role, Scalar};
use crate::input::Input;

/// Maximum number of lines of a header.
const MAX_LINES: usize = 200;
/// Maximum size of a point, bytes.
const MAX_POINT: usize = 1 << 16;

/// Encoding of the points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Data {
    Ascii,
    Binary,
    Compressed,
}

/// One field of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Field {
    pub role: Option<Role>,
    pub scalar: Scalar,
    pub count: usize,
}

/// Content of a header.
#[derive(Clone, Debug)]
pub(super) struct Header {
    pub fields: Vec<Field>,
    pub points: u64,
    pub data: Data,
}

/// Whether bytes begin like a PCD file.
pub(crate) fn sniff(start: &[u8]) -> bool {
    let text = String::from_utf8_lossy(start);
    let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let is_comment_only = start.starts_with(b"# .PCD");
    is_comment_only
        || lines.next().is_some_and(|line| line.starts_with("VERSION") || line.starts_with("FIELDS"))
}

impl Header {
    /// Reads a header; afterwards the input is at the first byte after it.
    ///
    /// # Errors
    /// Reading fails, or the header is damaged: it has no `DATA`, no number of points, lists of fields of
    /// different lengths, an unknown type, or points of an implausible size.
    pub fn read(input: &mut Input) -> Result<Self, CloudError> {
        let path = input.path.clone();
        let bad = |what: &str| CloudError::damaged(&path, format!("its header {what}"));
        let (mut names, mut sizes, mut types, mut counts) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut width, mut height, mut points) = (None, 1_u64, None);
        for _ in 0..MAX_LINES {
            let Some(line) = input.line()? else { break };
            let mut words = line.split_ascii_whitespace();
            let Some(key) = words.next() else { continue };
            let rest: Vec<String> = words.map(str::to_owned).collect();
            let number = || rest.first().and_then(|v| v.parse::<u64>().ok());
            match key {
                "FIELDS" | "COLUMNS" => names = rest,
                "SIZE" => sizes = rest,
                "TYPE" => types = rest,
                "COUNT" => counts = rest,
                "WIDTH" => width = number(),
                "HEIGHT" => height = number().ok_or_else(|| bad("has a HEIGHT that is no number"))?,
                "POINTS" => points = number(),
                "DATA" => {
                    let data = match rest.first().map(String::as_str) {
                        Some("ascii") => Data::Ascii,
                        Some("binary") => Data::Binary,
                        Some("binary_compressed") => Data::Compressed,
                        _ => return Err(bad("has DATA of an unknown kind")),
                    };
                    let points = points.or_else(|| width.and_then(|w: u64| w.checked_mul(height)));
                    let points = points.ok_or_else(|| bad("does not say how many points there are"))?;
                    let fields = fields(&names, &sizes, &types, &counts)
                        .ok_or_else(|| bad("has unequal lists of fields"))?;
                    let header = Self { fields, points, data };
                    if header.point_bytes() > MAX_POINT || header.point_bytes() == 0 {
                        return Err(bad("has points of an unlikely size"));
                    }
                    return Ok(header);
                }
                _ => {}
            }
        }
        Err(bad("has no DATA"))
    }

    /// Size of a point, bytes.
    pub fn point_bytes(&self) -> usize {
        self.fields.iter().map(|f| f.scalar.bytes() * f.count).sum()
    }

    /// Columns of known meaning; `at` is the index among the values (ascii) or the offset in bytes.
    pub fn columns(&self) -> Option<Columns> {
        let (mut at, mut columns) = (0, Vec::new());
        for field in &self.fields {
            columns.extend(field.role.map(|role| Column { role, at, scalar: field.scalar }));
            at += field.count * if self.data == Data::Ascii { 1 } else { field.scalar.bytes() };
        }
        Columns::of(&columns)
    }
}

fn fields(names: &[String], sizes: &[String], types: &[String], counts: &[String]) -> Option<Vec<Field>> {
    if names.len() != sizes.len()
        || names.len() != types.len()
        || !(counts.is_empty() || counts.len() == names.len())
    {
        return None;
    }
    let field = |i: usize| {
        let count: usize = counts.get(i).map_or(Some(1), |c| c.parse().ok())?;
        let scalar = match (types.get(i)?.as_str(), sizes.get(i)?.as_str()) {
            ("F", "4") => Scalar::F32,
            ("F", "8") => Scalar::F64,
            ("I", "1") => Scalar::I8,
            ("I", "2") => Scalar::I16,
            ("I", "4") => Scalar::I32,
            ("I", "8") => Scalar::I64,
            ("U", "1") => Scalar::U8,
            ("U", "2") => Scalar::U16,
            ("U", "4") => Scalar::U32,
            ("U", "8") => Scalar::U64,
            _ => return None,
        };
        // Padding is named `_`.
        Some(Field { role: Role::of(names.get(i)?), scalar, count: count.min(1 << 16) })
    };
    (0..names.len()).map(field).collect()
}
