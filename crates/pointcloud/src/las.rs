//! Reads and writes LAS and LAZ.
//!
//! Times are stored unchanged in the field for GPS time. Intensities are rounded to whole numbers from 0 to
//! 65535, colours are scaled to 16 bits.

mod ahead;
mod promises;
mod remembering;
mod shallow;

use std::io::BufReader;
use std::path::{Path, PathBuf};

use las::point::Format;
use las::{Builder, Color, Point, PointData, PointDataBuilder, Reader, Transform, Vector, Version, Writer};
use portolan_atomic_file::Disk;
use portolan_issue::{Issue, IssueKind, IssueLog};

use crate::BATCH_POINTS;
use crate::caught;
use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::format::{CloudReader, CloudWriter, WriteOptions, Written};
use crate::output::Output;
use remembering::{Failure, Remembering};
use shallow::Shallow;

/// Tolerance of the stated bounds as a fraction of the extent; dimensionless.
const ROOM: f64 = 0.01;

/// Reads points.
struct LasReader {
    path: PathBuf,
    reader: Reader,
    data: PointData,
    attributes: Attributes,
    total: u64,
    left: u64,
    /// Number of points requested at a time: halved repeatedly where the file is damaged.
    at_once: u64,
    /// Bounds of all points according to the header.
    bounds: Option<[[f64; 3]; 2]>,
    issues: IssueLog,
}

pub(crate) use ahead::open;

/// Maximum number of bytes of the points read at a time.
const BATCH_BYTES: u64 = 1 << 25;

/// Opens a LAS or LAZ file on the current thread.
fn open_here(path: &Path) -> Result<LasReader, CloudError> {
    let file = portolan_input::regular_file(path).map_err(|e| CloudError::read(path, e))?;
    let bytes = file.metadata().map_err(|e| CloudError::read(path, e))?.len();
    let mut file = BufReader::with_capacity(1 << 18, file);
    let damaged = |error: Option<String>| {
        CloudError::damaged(path, error.unwrap_or_else(|| "its header cannot be understood".to_owned()))
    };
    if let Some(detail) = unpanicked(|| promises::beyond_the_file(&mut file, bytes)).map_err(damaged)? {
        return Err(CloudError::damaged(path, detail));
    }
    let reader = unpanicked(|| {
        std::io::Seek::rewind(&mut file)?;
        Reader::new(Shallow::new(file, ahead::DEEPEST))
    });
    let reader = reader.map_err(damaged)?;
    let header = reader.header();
    let format = *header.point_format();
    let mut issues = IssueLog::default();
    let mut total = header.number_of_points();
    if !format.is_compressed {
        let offset = header.clone().into_raw().map_or(0, |raw| u64::from(raw.offset_to_point_data));
        let there = bytes.saturating_sub(offset) / u64::from(format.len().max(1));
        issues.count(IssueKind::CloudPointsMissing, total.saturating_sub(there));
        total = total.min(there);
    }
    let bounds = stated_bounds(header);
    let attributes = Attributes { intensity: true, time: format.has_gps_time, color: format.has_color };
    let data = PointDataBuilder::new().for_header(header).build();
    let (path, left, at_once) = (path.to_owned(), total, points_at_once(u64::from(format.len())));
    Ok(LasReader { path, reader, data, attributes, total, left, at_once, bounds, issues })
}

/// Number of points of this size that are read at a time. Extra bytes can make a point as long as 64 kB, and
/// the library allocates memory for all requested points, whether they are in the file or not.
fn points_at_once(bytes: u64) -> u64 {
    (BATCH_BYTES / bytes.max(1)).clamp(1, BATCH_POINTS as u64)
}

/// Result of a call of the library. The error is its text, or none if the library panicked: the decompressor
/// checks damaged files by assertions.
fn unpanicked<T>(call: impl FnOnce() -> las::Result<T>) -> Result<T, Option<String>> {
    // A reader that has panicked is not used again.
    match caught::unpanicked(call) {
        Some(result) => result.map_err(|error| Some(error.to_string())),
        None => Err(None),
    }
}

impl CloudReader for LasReader {
    fn attributes(&self) -> Attributes {
        self.attributes
    }

    fn count(&self) -> Option<u64> {
        Some(self.total)
    }

    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError> {
        batch.reset(self.attributes);
        while batch.is_empty() && self.left > 0 {
            let count = self.left.min(self.at_once);
            let read = match unpanicked(|| self.reader.fill_points(count, &mut self.data)) {
                Ok(read) => read.min(count),
                Err(error) => {
                    // Reads smaller batches up to the damage; points after it are not read.
                    self.at_once = count / 2;
                    let position = self.total - self.left;
                    let may_retry = self.at_once > 0 && error.is_some();
                    if may_retry && unpanicked(|| self.reader.seek(position)).is_ok() {
                        continue;
                    }
                    let error = error.unwrap_or_else(|| "its points cannot be decompressed".to_owned());
                    if position == 0 {
                        return Err(CloudError::damaged(&self.path, error));
                    }
                    self.issues.count(IssueKind::CloudDamage, self.left);
                    self.left = 0;
                    break;
                }
            };
            if read == 0 {
                self.issues.count(IssueKind::CloudPointsMissing, self.left);
                self.left = 0;
                break;
            }
            self.left -= read;
            self.push(batch, read as usize);
        }
        Ok(!batch.is_empty())
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}

impl LasReader {
    fn push(&mut self, batch: &mut PointCloud, count: usize) {
        let data = &self.data;
        let mut times = data.gps_time();
        let mut colors = data.rgb();
        let positions = data.x().zip(data.y()).zip(data.z()).zip(data.intensity()).take(count);
        let (mut not_finite, mut outside) = (0, 0);
        for (((x, y), z), intensity) in positions {
            let time = times.as_mut().and_then(Iterator::next).unwrap_or(0.0);
            let color = colors.as_mut().and_then(Iterator::next).unwrap_or((0, 0, 0));
            outside += u64::from(self.bounds.is_some_and(|bounds| is_outside(&bounds, [x, y, z])));
            if x.is_finite() && y.is_finite() && z.is_finite() {
                let color = [color.0, color.1, color.2].map(|c| (f64::from(c) / 257.0).round() as u8);
                batch.push([x, y, z], f32::from(intensity), time, color);
            } else {
                not_finite += 1;
            }
        }
        self.issues.count(IssueKind::CloudPointNotFinite, not_finite);
        // Points decompressed from damaged bytes have arbitrary positions.
        self.issues.count(IssueKind::CloudPointsOutsideBounds, outside);
    }
}

/// Minimum and maximum coordinates stated in the header, with a tolerance; none if none are stated.
fn stated_bounds(header: &las::Header) -> Option<[[f64; 3]; 2]> {
    let (low, high) = (header.bounds().min, header.bounds().max);
    let bounds = [[low.x, low.y, low.z], [high.x, high.y, high.z]];
    let [least, greatest] = bounds;
    let is_stated =
        least.iter().zip(&greatest).all(|(l, g)| l <= g) && bounds.as_flattened().iter().any(|v| *v != 0.0);
    let with_room = |(low, high): (&f64, &f64)| {
        let room = ROOM * (high - low).max(1.0);
        (low - room, high + room)
    };
    let [x, y, z] = [(&low.x, &high.x), (&low.y, &high.y), (&low.z, &high.z)].map(with_room);
    is_stated.then_some([[x.0, y.0, z.0], [x.1, y.1, z.1]])
}

fn is_outside([low, high]: &[[f64; 3]; 2], point: [f64; 3]) -> bool {
    low.iter().zip(high).zip(point).any(|((low, high), v)| v < *low || v > *high)
}

/// Writes points.
pub(crate) struct LasWriter {
    output: Output,
    attributes: Attributes,
    resolution: f64,
    origin: Option<[f64; 3]>,
    is_compressed: bool,
    /// Created with the first point, to which the coordinates are relative.
    writer: Option<Writer<Remembering<std::io::BufWriter<Disk<std::fs::File>>>>>,
    /// The first error of writing the file.
    failure: Failure,
    written: Written,
}

impl LasWriter {
    /// # Errors
    /// The resolution is outside 0.1 µm to 10 m, or the file cannot be created.
    pub fn create(
        path: &Path,
        attributes: Attributes,
        options: &WriteOptions,
        is_compressed: bool,
    ) -> Result<Self, CloudError> {
        if !(1e-7..=10.0).contains(&options.resolution) {
            let detail = format!("the resolution must be from 1e-7 to 10 m, but is {}", options.resolution);
            return Err(CloudError::Unwritable { path: path.to_owned(), detail });
        }
        Ok(Self {
            output: Output::create(path)?,
            attributes,
            resolution: options.resolution,
            origin: options.origin,
            is_compressed,
            writer: None,
            failure: Failure::default(),
            written: Written { points: 0, not_finite: 0 },
        })
    }

    fn unwritable(&self, error: &las::Error) -> CloudError {
        // An error of the disk takes precedence: the error of the library may be a consequence of it.
        if let Some(failure) = self.failure.get() {
            return CloudError::write(&self.output.path, failure);
        }
        CloudError::Unwritable {
            path: self.output.path.clone(),
            detail: format!("{error}; a coarser resolution lets coordinates reach farther"),
        }
    }

    /// Whether all writes so far succeeded.
    fn check(&self) -> Result<(), CloudError> {
        self.failure.get().map_or(Ok(()), |error| Err(CloudError::write(&self.output.path, error)))
    }

    fn start(&mut self, first: [f64; 3]) -> Result<(), CloudError> {
        // Multiples of ten metres, so that maps of the same place have similar offsets.
        let origin = self.origin.unwrap_or(first.map(|v| (v / 10.0).floor() * 10.0));
        let [x, y, z] = origin.map(|offset| Transform { scale: self.resolution, offset });
        let mut format = Format::new(0).map_err(|e| self.unwritable(&e))?;
        format.has_gps_time = self.attributes.time;
        format.has_color = self.attributes.color;
        format.is_compressed = self.is_compressed;
        let mut builder = Builder::default();
        builder.generating_software = "portolan".to_owned();
        builder.system_identifier = "portolan".to_owned();
        builder.point_format = format;
        builder.transforms = Vector { x, y, z };
        builder.version = Version::new(1, 4);
        let header = builder.into_header().map_err(|e| self.unwritable(&e))?;
        let file = std::io::BufWriter::with_capacity(1 << 18, self.output.handle()?);
        let file = Remembering::new(file, self.failure.clone());
        self.writer = Some(Writer::new(file, header).map_err(|e| self.unwritable(&e))?);
        Ok(())
    }

    fn point(&self, batch: &PointCloud, index: usize) -> Point {
        let [x, y, z] = batch.position(index);
        let color = batch.color(index).unwrap_or([0; 3]).map(|c| u16::from(c) * 257);
        Point {
            x,
            y,
            z,
            intensity: batch.intensity(index).unwrap_or(0.0).round().clamp(0.0, 65_535.0) as u16,
            return_number: 1,
            number_of_returns: 1,
            gps_time: self.attributes.time.then(|| batch.time(index).unwrap_or(0.0)),
            color: self.attributes.color.then(|| Color::new(color[0], color[1], color[2])),
            ..Point::default()
        }
    }
}

impl CloudWriter for LasWriter {
    fn write(&mut self, batch: &PointCloud) -> Result<(), CloudError> {
        for index in 0..batch.len() {
            let position = batch.position(index);
            if !position.iter().all(|v| v.is_finite()) {
                self.written.not_finite += 1;
                continue;
            }
            if self.writer.is_none() {
                self.start(position)?;
            }
            let point = self.point(batch, index);
            let result = self.writer.as_mut().map_or(Ok(()), |writer| writer.write_point(point));
            result.map_err(|e| self.unwritable(&e))?;
            self.written.points += 1;
        }
        self.check()
    }

    fn finish(mut self: Box<Self>) -> Result<Written, CloudError> {
        if self.writer.is_none() {
            self.start([0.0; 3])?;
        }
        if let Some(mut writer) = self.writer.take() {
            writer.close().map_err(|e| self.unwritable(&e))?;
            // The file is closed above; only the buffer must be flushed.
            if let Ok(mut file) = writer.into_inner() {
                std::io::Write::flush(&mut file).map_err(|e| CloudError::write(&self.output.path, e))?;
            }
        }
        self.check()?;
        self.output.finish()?;
        Ok(self.written)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_points_are_read_few_at_a_time() {
        assert_eq!(points_at_once(34), BATCH_POINTS as u64);
        for bytes in [0, 1, 1000, 65_313, u64::from(u16::MAX)] {
            let points = points_at_once(bytes);
            assert!(points > 0 && points * bytes <= BATCH_BYTES, "{bytes}: {points}");
        }
    }
}
