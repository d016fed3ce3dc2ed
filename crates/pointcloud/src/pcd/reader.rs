//! Reads PCD files.

use std::io::{BufReader, Read};
use std::path::Path;

use portolan_issue::{Issue, IssueKind, IssueLog};

use super::header::{Data, Header};
use super::lzf::Decompressor;
use crate::BATCH_POINTS;
use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::fields::{Column, Columns};
use crate::format::CloudReader;
use crate::input::{Input, numbers};
use crate::output::Spool;

/// Reads points.
pub(crate) struct PcdReader {
    input: Input,
    header: Header,
    columns: Columns,
    total: u64,
    next: u64,
    /// Decompressed columns, on disk.
    unpacked: Option<Spool>,
    bytes: Vec<u8>,
    issues: IssueLog,
}

impl PcdReader {
    /// # Errors
    /// Reading fails, the header is damaged or has no x, y and z, or compressed points are incomplete,
    /// damaged, or cannot be decompressed to disk.
    pub fn open(mut input: Input) -> Result<Self, CloudError> {
        let path = input.path.clone();
        let path = path.as_path();
        let header = Header::read(&mut input)?;
        let columns =
            header.columns().ok_or_else(|| CloudError::damaged(path, "it has no fields x, y and z"))?;
        let (mut issues, mut unpacked) = (IssueLog::default(), None);
        let row = header.point_bytes() as u64;
        let mut total = header.points;
        match header.data {
            Data::Ascii => {}
            Data::Binary => {
                if let Some(there) = input.rows_left(row) {
                    issues.count(IssueKind::CloudPointsMissing, total.saturating_sub(there));
                    total = total.min(there);
                }
            }
            Data::Compressed => {
                let wanted = total.saturating_mul(row);
                let spool = unpack(&mut input, path, wanted)?;
                // Points are stored column by column: if bytes are missing no point is complete.
                if spool.length() < wanted {
                    return Err(CloudError::damaged(path, "its compressed points are cut off"));
                }
                unpacked = Some(spool);
            }
        }
        Ok(Self { input, header, columns, total, next: 0, unpacked, bytes: Vec::new(), issues })
    }

    fn read_ascii(&mut self, batch: &mut PointCloud, count: u64) -> Result<(), CloudError> {
        let mut values = Vec::new();
        for _ in 0..count {
            let Some(line) = self.input.line()? else {
                self.issues.count(IssueKind::CloudPointsMissing, self.total - self.next);
                self.next = self.total;
                return Ok(());
            };
            self.next += 1;
            if !numbers(line, &mut values) || values.len() < 3 {
                self.issues.count(IssueKind::CloudLineUnreadable, 1);
                continue;
            }
            let is_finite = self.columns.push(|column| values.get(column.at).copied().unwrap_or(0.0), batch);
            self.issues.count(IssueKind::CloudPointNotFinite, u64::from(!is_finite));
        }
        Ok(())
    }

    fn read_rows(&mut self, batch: &mut PointCloud, count: u64) -> Result<(), CloudError> {
        let row_bytes = self.header.point_bytes();
        self.bytes.resize(count as usize * row_bytes, 0);
        if self.unpacked.is_some() {
            self.gather(count)?;
        } else {
            let got = self.input.fill(&mut self.bytes)?;
            if got < self.bytes.len() {
                // In a pipe a missing end is found only here.
                self.bytes.truncate(got);
                let there = self.next + (got / row_bytes.max(1)) as u64;
                self.issues.count(IssueKind::CloudPointsMissing, self.total.saturating_sub(there));
                self.total = self.next + count;
            }
        }
        self.next += count;
        for row in self.bytes.chunks_exact(row_bytes) {
            let value = |c: &Column| c.scalar.decode(row.get(c.at..).unwrap_or_default(), false);
            let is_finite = self.columns.push(value, batch);
            self.issues.count(IssueKind::CloudPointNotFinite, u64::from(!is_finite));
        }
        Ok(())
    }

    /// Assembles rows from the columns.
    fn gather(&mut self, count: u64) -> Result<(), CloudError> {
        let Some(spool) = &mut self.unpacked else { return Ok(()) };
        let row_bytes = self.header.point_bytes();
        let (mut column_start, mut offset) = (0_u64, 0);
        let mut column = Vec::new();
        for field in &self.header.fields {
            let bytes = field.scalar.bytes() * field.count;
            if bytes == 0 {
                continue;
            }
            column.resize(count as usize * bytes, 0);
            let at = column_start + self.next * bytes as u64;
            spool.read_at(at, &mut column).map_err(|e| CloudError::read(&self.input.path, e))?;
            for (row, value) in self.bytes.chunks_exact_mut(row_bytes).zip(column.chunks_exact(bytes)) {
                if let Some(slot) = row.get_mut(offset..offset + bytes) {
                    slot.copy_from_slice(value);
                }
            }
            column_start += self.total * bytes as u64;
            offset += bytes;
        }
        Ok(())
    }
}

/// Decompresses all columns to a temporary file, at most `wanted` bytes.
fn unpack(input: &mut Input, path: &Path, wanted: u64) -> Result<Spool, CloudError> {
    let error = |e| CloudError::read(path, e);
    let mut sizes = [0; 8];
    input.fill(&mut sizes)?;
    let [a, b, c, d, e, f, g, h] = sizes;
    let (packed, unpacked) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
    if u64::from(unpacked) != wanted {
        return Err(CloudError::damaged(path, "the size of its compressed points does not fit the header"));
    }
    let source = BufReader::with_capacity(1 << 16, input.take(u64::from(packed)));
    let mut decompressor = Decompressor::new(source);
    let mut spool = Spool::new().map_err(error)?;
    let mut bytes = Vec::new();
    loop {
        let goes_on = match decompressor.next_into(&mut bytes) {
            Ok(goes_on) => goes_on,
            Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => false,
            Err(e) => return Err(CloudError::damaged(path, format!("its compressed points: {e}"))),
        };
        if bytes.len() >= 1 << 16 || !goes_on {
            spool.append(&bytes).map_err(error)?;
            bytes.clear();
        }
        if !goes_on || spool.length() > wanted {
            return Ok(spool);
        }
    }
}

impl CloudReader for PcdReader {
    fn attributes(&self) -> Attributes {
        self.columns.attributes()
    }

    fn count(&self) -> Option<u64> {
        Some(self.total)
    }

    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError> {
        batch.reset(self.attributes());
        while batch.is_empty() && self.next < self.total {
            let count = (self.total - self.next).min(BATCH_POINTS as u64);
            match self.header.data {
                Data::Ascii => self.read_ascii(batch, count)?,
                Data::Binary | Data::Compressed => self.read_rows(batch, count)?,
            }
        }
        Ok(!batch.is_empty())
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}
