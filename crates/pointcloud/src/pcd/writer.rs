//! Writes PCD files.

use std::path::Path;

use portolan_geometry::{NearFrame, Vector3};

use super::lzf::compress;
use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::format::{CloudWriter, Encoding, Precision, WriteOptions, Written};
use crate::output::{Output, Spool, folder_of};
use crate::ply::push_bytes;

/// Size of the header, bytes. It is written last; a comment pads it to this size.
const HEADER_BYTES: usize = 512;
/// Size of the blocks in which columns are compressed, bytes.
const BLOCK: usize = 1 << 18;

/// Writes points.
pub(crate) struct PcdWriter {
    output: Output,
    attributes: Attributes,
    encoding: Encoding,
    precision: Precision,
    /// Whether coordinates are in double precision; determined at the first point.
    is_double: bool,
    bytes: Vec<u8>,
    /// One spool for each column of a compressed file.
    columns: Vec<Spool>,
    written: Written,
}

impl PcdWriter {
    /// # Errors
    /// The file, or temporary ones for its columns, cannot be created in the folder, or the header cannot be
    /// written.
    pub fn create(path: &Path, attributes: Attributes, options: &WriteOptions) -> Result<Self, CloudError> {
        let mut writer = Self {
            output: Output::create(path)?,
            attributes,
            encoding: options.encoding,
            precision: options.precision,
            is_double: options.precision == Precision::Double,
            bytes: Vec::new(),
            columns: Vec::new(),
            written: Written { points: 0, not_finite: 0 },
        };
        if writer.encoding == Encoding::Compressed {
            let folder = folder_of(path);
            let spools =
                writer.column_bytes().iter().map(|_| Spool::in_folder(folder)).collect::<Result<_, _>>();
            writer.columns = spools.map_err(|e| CloudError::temporary(folder, e))?;
        }
        let header = writer.header();
        writer.output.append(header.as_bytes())?;
        Ok(writer)
    }

    /// Chooses double precision far from the origin, where single precision would lose decimetres, unless the
    /// options set the precision.
    fn choose_precision(&mut self, batch: &PointCloud) {
        if self.written.points > 0 || self.precision != Precision::Usual {
            return;
        }
        let mut places = (0..batch.len()).map(|index| Vector3::from(batch.position(index)));
        let first = places.find(|place| place.iter().all(|v| v.is_finite()));
        self.is_double = first.is_some_and(|place| !NearFrame::around([place]).is_map());
    }

    /// Size of a value in each column, bytes.
    fn column_bytes(&self) -> Vec<usize> {
        let mut bytes = vec![if self.is_double { 8 } else { 4 }; 3];
        bytes.extend(self.attributes.intensity.then_some(4));
        bytes.extend(self.attributes.time.then_some(8));
        bytes.extend(self.attributes.color.then_some(4));
        bytes
    }

    /// The header, always of the same length.
    fn header(&self) -> String {
        let size = if self.is_double { "8" } else { "4" };
        // Names, sizes and types.
        let mut fields = vec![["x", size, "F"], ["y", size, "F"], ["z", size, "F"]];
        fields.extend(self.attributes.intensity.then_some(["intensity", "4", "F"]));
        fields.extend(self.attributes.time.then_some(["time", "8", "F"]));
        fields.extend(self.attributes.color.then_some(["rgb", "4", "U"]));
        let join = |part: fn(&[&'static str; 3]) -> &'static str| {
            fields.iter().map(part).collect::<Vec<_>>().join(" ")
        };
        let data = match self.encoding {
            Encoding::Ascii => "ascii",
            Encoding::Binary => "binary",
            Encoding::Compressed => "binary_compressed",
        };
        let count = self.written.points;
        let head = "# .PCD v0.7 - Point Cloud Data file format\n";
        let body = format!(
            "VERSION 0.7\nFIELDS {}\nSIZE {}\nTYPE {}\nCOUNT {}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
             POINTS {count}\nDATA {data}\n",
            join(|[name, ..]| name),
            join(|[_, size, _]| size),
            join(|[.., kind]| kind),
            vec!["1"; fields.len()].join(" "),
        );
        let filler = HEADER_BYTES.saturating_sub(head.len() + body.len() + "# \n".len());
        format!("{head}# {}\n{body}", ".".repeat(filler))
    }

    fn push(&mut self, batch: &PointCloud, index: usize) {
        let start = self.bytes.len();
        let plain = Attributes { color: false, ..self.attributes };
        push_bytes(&mut self.bytes, batch, index, plain, self.is_double);
        if self.attributes.color {
            let [red, green, blue] = batch.color(index).unwrap_or([0; 3]);
            self.bytes.extend_from_slice(&[blue, green, red, 0]);
        }
        debug_assert_eq!(self.bytes.len() - start, self.column_bytes().iter().sum::<usize>());
    }

    /// Splits rows into columns.
    fn scatter(&mut self) -> Result<(), CloudError> {
        let sizes = self.column_bytes();
        let row: usize = sizes.iter().sum();
        let mut offset = 0;
        let mut column = Vec::new();
        for (spool, size) in self.columns.iter_mut().zip(&sizes) {
            column.clear();
            for point in self.bytes.chunks_exact(row) {
                column.extend_from_slice(point.get(offset..offset + size).unwrap_or_default());
            }
            let folder = folder_of(&self.output.path);
            spool.append(&column).map_err(|e| CloudError::temporary(folder, e))?;
            offset += size;
        }
        Ok(())
    }

    /// Appends the compressed columns, preceded by both sizes.
    fn append_columns(&mut self) -> Result<(), CloudError> {
        let unpacked: u64 = self.columns.iter().map(Spool::length).sum();
        let path = self.output.path.clone();
        let too_long = || CloudError::Unwritable {
            path: path.clone(),
            detail: "compressed PCD holds at most 4 GiB; write binary PCD, or LAZ".to_owned(),
        };
        let unpacked = u32::try_from(unpacked).map_err(|_| too_long())?;
        self.output.append(&[0; 8])?;
        let (mut packed_bytes, mut block, mut packed) = (0_u64, vec![0; BLOCK], Vec::new());
        for spool in &mut self.columns {
            let mut at = 0;
            while at < spool.length() {
                let count = (spool.length() - at).min(BLOCK as u64) as usize;
                let Some(part) = block.get_mut(..count) else { break };
                spool.read_at(at, part).map_err(|e| CloudError::temporary(folder_of(&path), e))?;
                packed.clear();
                compress(part, &mut packed);
                self.output.append(&packed)?;
                packed_bytes += packed.len() as u64;
                at += count as u64;
            }
        }
        let packed_bytes = u32::try_from(packed_bytes).map_err(|_| too_long())?;
        let sizes = [packed_bytes.to_le_bytes(), unpacked.to_le_bytes()].concat();
        self.output.overwrite(HEADER_BYTES as u64, &sizes)
    }
}

/// A point as text; its colour is one whole number.
fn push_text(text: &mut String, cloud: &PointCloud, index: usize, attributes: Attributes) {
    crate::xyz::push_text(text, cloud, index, Attributes { color: false, ..attributes });
    if attributes.color {
        text.pop();
        let [red, green, blue] = cloud.color(index).unwrap_or([0; 3]).map(u32::from);
        text.push_str(&format!(" {}\n", (red << 16) | (green << 8) | blue));
    }
}

impl CloudWriter for PcdWriter {
    fn write(&mut self, batch: &PointCloud) -> Result<(), CloudError> {
        self.choose_precision(batch);
        self.bytes.clear();
        let mut text = String::new();
        for index in 0..batch.len() {
            if !batch.position(index).iter().all(|v| v.is_finite()) {
                self.written.not_finite += 1;
                continue;
            }
            self.written.points += 1;
            match self.encoding {
                Encoding::Ascii => push_text(&mut text, batch, index, self.attributes),
                _ => self.push(batch, index),
            }
        }
        match self.encoding {
            Encoding::Ascii => self.output.append(text.as_bytes()),
            Encoding::Binary => self.output.append(&self.bytes),
            Encoding::Compressed => self.scatter(),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<Written, CloudError> {
        if self.encoding == Encoding::Compressed {
            self.append_columns()?;
        }
        let header = self.header();
        self.output.overwrite(0, header.as_bytes())?;
        self.output.finish()?;
        Ok(self.written)
    }
}
