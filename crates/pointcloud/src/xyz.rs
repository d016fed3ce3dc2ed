//! Reads and writes text with one point per line.
//!
//! A first line of names (`x y z intensity …`, also after `#` or `//`) defines the columns. Without one their
//! number does: x y z, then intensity (4), red green blue (6), or intensity red green blue (7). A first line
//! with a single whole number is the number of points (PTS).

use std::fmt::Write;
use std::path::Path;

use portolan_issue::{Issue, IssueKind, IssueLog};

use crate::BATCH_POINTS;
use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::fields::{Column, Columns, Role, Scalar};
use crate::format::{CloudReader, CloudWriter, Written};
use crate::input::{CloudLine, Input, numbers};
use crate::output::Output;

/// Maximum number of lines before the first point.
const MAX_HEAD: usize = 100;

/// Whether bytes begin like text with coordinates.
pub(crate) fn sniff(start: &[u8]) -> bool {
    if start.is_empty() || start.contains(&0) {
        return false;
    }
    let text = String::from_utf8_lossy(start);
    // The last line may be incomplete.
    let complete = text.rsplit_once('\n').map_or(&*text, |(lines, _)| lines);
    let mut values = Vec::new();
    complete
        .lines()
        .any(|line| columns_of_names(line).is_some() || (numbers(line, &mut values) && values.len() >= 3))
}

fn columns_of_names(line: &str) -> Option<Columns> {
    let names = line.trim_start_matches(['#', '/', ' ']);
    let names =
        names.split([' ', '\t', ',', ';']).filter(|name| !name.is_empty()).map(|n| n.trim_matches('"'));
    let columns = names.enumerate().filter_map(|(at, name)| {
        Some(Column { role: Role::of(name)?, at, scalar: color_scalar(Role::of(name)?) })
    });
    Columns::of(&columns.collect::<Vec<_>>())
}

fn color_scalar(role: Role) -> Scalar {
    // Colours in text are from 0 to 255.
    if matches!(role, Role::Red | Role::Green | Role::Blue) { Scalar::U8 } else { Scalar::F64 }
}

fn columns_of_count(count: usize) -> Option<Columns> {
    use Role::{Blue, Green, Intensity, Red, X, Y, Z};
    let roles: &[Role] = match count {
        0..3 => return None,
        3 => &[X, Y, Z],
        4 | 5 => &[X, Y, Z, Intensity],
        6 => &[X, Y, Z, Red, Green, Blue],
        _ => &[X, Y, Z, Intensity, Red, Green, Blue],
    };
    let column = |(at, role): (usize, &Role)| Column { role: *role, at, scalar: color_scalar(*role) };
    Columns::of(&roles.iter().enumerate().map(column).collect::<Vec<_>>())
}

/// Reads text.
pub(crate) struct XyzReader {
    input: Input,
    columns: Columns,
    count: Option<u64>,
    /// The first line of numbers, which was read to determine the columns.
    first: Option<Vec<f64>>,
    values: Vec<f64>,
    issues: IssueLog,
}

impl XyzReader {
    /// # Errors
    /// Reading fails, or the first lines are neither names of columns nor points.
    pub fn open(mut input: Input) -> Result<Self, CloudError> {
        let (mut named, mut count, mut values) = (None, None, Vec::new());
        for _ in 0..MAX_HEAD {
            let Some(line) = input.line()? else { break };
            if let Some(columns) = columns_of_names(line) {
                named = Some(columns);
            } else if numbers(line, &mut values) && !values.is_empty() {
                if let (1, Some(value)) = (values.len(), values.first()) {
                    count = (*value >= 0.0 && value.fract() == 0.0).then_some(*value as u64);
                    continue;
                }
                let Some(columns) = named.take().or_else(|| columns_of_count(values.len())) else { continue };
                let first = Some(values.clone());
                return Ok(Self { input, columns, count, first, values, issues: IssueLog::default() });
            }
        }
        match named {
            // A header without points.
            Some(columns) => {
                Ok(Self { input, columns, count: Some(0), first: None, values, issues: IssueLog::default() })
            }
            None => Err(CloudError::damaged(&input.path, "it has no line with three numbers")),
        }
    }

    fn push(&mut self, values: &[f64], batch: &mut PointCloud) {
        if values.len() < 3 {
            self.issues.count(IssueKind::CloudLineShort, 1);
            return;
        }
        let is_finite = self.columns.push(|column| values.get(column.at).copied().unwrap_or(0.0), batch);
        self.issues.count(IssueKind::CloudPointNotFinite, u64::from(!is_finite));
    }
}

impl CloudReader for XyzReader {
    fn attributes(&self) -> Attributes {
        self.columns.attributes()
    }

    fn count(&self) -> Option<u64> {
        self.count
    }

    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError> {
        batch.reset(self.attributes());
        if let Some(first) = self.first.take() {
            self.push(&first, batch);
        }
        while batch.len() < BATCH_POINTS {
            let line = match self.input.line_of_any_length()? {
                None => break,
                Some(CloudLine::Text(line)) => line,
                Some(CloudLine::TooLong) => {
                    self.issues.add(IssueKind::CloudLineTooLong);
                    continue;
                }
            };
            let mut values = std::mem::take(&mut self.values);
            let is_comment = line.trim().is_empty() || line.trim_start().starts_with(['#', '/']);
            if is_comment {
            } else if numbers(line, &mut values) {
                self.push(&values, batch);
            } else {
                self.issues.count(IssueKind::CloudLineNotNumbers, 1);
            }
            self.values = values;
        }
        Ok(!batch.is_empty())
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}

/// Writes text.
pub(crate) struct XyzWriter {
    output: Output,
    attributes: Attributes,
    text: String,
    written: Written,
}

impl XyzWriter {
    /// # Errors
    /// The file cannot be created, or the line with the names cannot be written.
    pub fn create(path: &Path, attributes: Attributes) -> Result<Self, CloudError> {
        let mut output = Output::create(path)?;
        let mut names = "# x y z".to_owned();
        names += if attributes.intensity { " intensity" } else { "" };
        names += if attributes.time { " time" } else { "" };
        names += if attributes.color { " red green blue\n" } else { "\n" };
        output.append(names.as_bytes())?;
        let written = Written { points: 0, not_finite: 0 };
        Ok(Self { output, attributes, text: String::new(), written })
    }
}

/// Appends a point as text: coordinates to 0.1 mm.
pub(crate) fn push_text(text: &mut String, cloud: &PointCloud, index: usize, attributes: Attributes) {
    let [x, y, z] = cloud.position(index);
    let _ = write!(text, "{x:.4} {y:.4} {z:.4}");
    if attributes.intensity {
        let _ = write!(text, " {}", cloud.intensity(index).unwrap_or(0.0));
    }
    if attributes.time {
        let _ = write!(text, " {:.7}", cloud.time(index).unwrap_or(0.0));
    }
    if attributes.color {
        let [red, green, blue] = cloud.color(index).unwrap_or([0; 3]);
        let _ = write!(text, " {red} {green} {blue}");
    }
    text.push('\n');
}

impl CloudWriter for XyzWriter {
    fn write(&mut self, batch: &PointCloud) -> Result<(), CloudError> {
        self.text.clear();
        for index in 0..batch.len() {
            if batch.position(index).iter().all(|v| v.is_finite()) {
                push_text(&mut self.text, batch, index, self.attributes);
                self.written.points += 1;
            } else {
                self.written.not_finite += 1;
            }
        }
        self.output.append(self.text.as_bytes())
    }

    fn finish(mut self: Box<Self>) -> Result<Written, CloudError> {
        self.output.finish()?;
        Ok(self.written)
    }
}
