//! Reads all scans of E57 files, each transformed by its pose, and writes one scan.

use std::io::{self, BufReader, ErrorKind::Interrupted, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

use e57::{E57Reader, PointCloud as Scan, RawValues, Record, RecordDataType, RecordName, RecordValue};
use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use portolan_input::{XmlLimits, check_xml, regular_file};
use portolan_issue::{Issue, IssueKind, IssueLog};

use crate::BATCH_POINTS;
use crate::caught;
use crate::cloud::{Attributes, PointCloud};
use crate::error::CloudError;
use crate::format::{CloudReader, CloudWriter, Written};
use crate::output::{Output, Spool, folder_of};

/// Messages of the reading thread.
type Sent = Result<(PointCloud, u64), String>;

/// Reads points on its own thread, because each scan borrows the reader of the library.
struct E57Points {
    path: PathBuf,
    attributes: Attributes,
    count: u64,
    batches: Receiver<Sent>,
    /// Returns whether the thread ended without a panic.
    thread: Option<JoinHandle<bool>>,
    given: u64,
    issues: IssueLog,
}

/// Opens a file.
pub(crate) fn open(path: &Path) -> Result<Box<dyn CloudReader>, CloudError> {
    let damaged = |error: e57::Error| CloudError::damaged(path, error.to_string());
    let open = || regular_file(path).map(BufReader::new).map_err(|e| CloudError::read(path, e));
    let xml = E57Reader::raw_xml(open()?).map_err(damaged)?;
    check_xml(&xml, XmlLimits::default()).map_err(|e| CloudError::damaged(path, e.to_string()))?;
    let mut reader = E57Reader::new(open()?).map_err(damaged)?;
    let scans: Vec<Scan> =
        reader.pointclouds().into_iter().filter(|scan| ScanLayout::of(scan).is_some()).collect();
    if scans.is_empty() {
        return Err(CloudError::damaged(path, "it has no scan with coordinates"));
    }
    let mut attributes = Attributes::default();
    for scan in &scans {
        let has = |name: &RecordName| scan.prototype.iter().any(|record| record.name == *name);
        attributes.intensity |= has(&RecordName::Intensity);
        attributes.time |= has(&RecordName::TimeStamp);
        attributes.color |= has(&RecordName::ColorRed);
    }
    let count = scans.iter().map(|scan| scan.records).sum();
    let (sender, batches) = sync_channel::<Sent>(2);
    let work = move || {
        for scan in &scans {
            let mut left_out = 0;
            let mut batch = PointCloud::new(attributes);
            let Some(layout) = ScanLayout::of(scan) else { continue };
            let points = match reader.pointcloud_raw(scan) {
                Ok(points) => points,
                Err(error) => {
                    let _ = sender.send(Err(error.to_string()));
                    return;
                }
            };
            for values in points {
                let values = match values {
                    Ok(values) => values,
                    Err(error) => {
                        let _ = sender.send(Ok((batch, left_out)));
                        let _ = sender.send(Err(error.to_string()));
                        return;
                    }
                };
                left_out += u64::from(!layout.push(&values, &mut batch));
                if batch.len() >= BATCH_POINTS {
                    let full = std::mem::replace(&mut batch, PointCloud::new(attributes));
                    // The receiver has been dropped.
                    if sender.send(Ok((full, std::mem::take(&mut left_out)))).is_err() {
                        return;
                    }
                }
            }
            if sender.send(Ok((batch, left_out))).is_err() {
                return;
            }
        }
    };
    let thread = std::thread::spawn(move || caught::unpanicked(work).is_some());
    let (path, thread, issues) = (path.to_owned(), Some(thread), IssueLog::default());
    Ok(Box::new(E57Points { path, attributes, count, batches, thread, given: 0, issues }))
}

impl CloudReader for E57Points {
    fn attributes(&self) -> Attributes {
        self.attributes
    }

    fn count(&self) -> Option<u64> {
        Some(self.count)
    }

    fn next_batch(&mut self, batch: &mut PointCloud) -> Result<bool, CloudError> {
        batch.reset(self.attributes);
        loop {
            match self.batches.recv() {
                Ok(Ok((points, left_out))) => {
                    self.issues.count(IssueKind::CloudPointNotFinite, left_out);
                    self.given += points.len() as u64;
                    if !points.is_empty() {
                        batch.extend(&points);
                        return Ok(true);
                    }
                }
                Ok(Err(error)) if self.given == 0 => return Err(CloudError::damaged(&self.path, error)),
                Ok(Err(_)) => {
                    self.issues.count(IssueKind::CloudDamage, self.count - self.given.min(self.count))
                }
                Err(_) => {
                    // The thread has ended.
                    let panicked = self.thread.take().is_some_and(|thread| !thread.join().unwrap_or(false));
                    return if panicked {
                        Err(CloudError::damaged(&self.path, "its points cannot be decoded"))
                    } else {
                        Ok(false)
                    };
                }
            }
        }
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}

/// Columns of the values of a scan.
struct ScanLayout {
    /// x, y, z; or range, azimuth, elevation.
    position: [(usize, RecordDataType); 3],
    is_spherical: bool,
    invalid: Option<usize>,
    intensity: Option<(usize, RecordDataType)>,
    time: Option<(usize, RecordDataType)>,
    color: Option<[(usize, RecordDataType); 3]>,
    file_from_scan: Rigid3,
}

impl ScanLayout {
    fn of(scan: &Scan) -> Option<Self> {
        let find = |name: RecordName| {
            let at = scan.prototype.iter().position(|record| record.name == name)?;
            Some((at, scan.prototype.get(at)?.data_type.clone()))
        };
        let cartesian = || {
            Some([
                find(RecordName::CartesianX)?,
                find(RecordName::CartesianY)?,
                find(RecordName::CartesianZ)?,
            ])
        };
        let spherical = || {
            let (azimuth, elevation) = (RecordName::SphericalAzimuth, RecordName::SphericalElevation);
            Some([find(RecordName::SphericalRange)?, find(azimuth)?, find(elevation)?])
        };
        let color = || {
            Some([find(RecordName::ColorRed)?, find(RecordName::ColorGreen)?, find(RecordName::ColorBlue)?])
        };
        let (position, is_spherical) = match cartesian() {
            Some(position) => (position, false),
            None => (spherical()?, true),
        };
        let state =
            if is_spherical { RecordName::SphericalInvalidState } else { RecordName::CartesianInvalidState };
        Some(Self {
            position,
            is_spherical,
            invalid: find(state).map(|(at, _)| at),
            intensity: find(RecordName::Intensity),
            time: find(RecordName::TimeStamp),
            color: color(),
            file_from_scan: pose(scan),
        })
    }

    /// Adds a point; returns whether its coordinates are valid.
    fn push(&self, values: &RawValues, out: &mut PointCloud) -> bool {
        let number = |(at, kind): &(usize, RecordDataType)| number(values.get(*at), kind);
        if let Some(RecordValue::Integer(1..)) = self.invalid.and_then(|at| values.get(at)) {
            return false;
        }
        let [a, b, c] = self.position.each_ref().map(number);
        let position = if self.is_spherical {
            let ((sa, ca), (se, ce)) = (b.sin_cos(), c.sin_cos());
            Vector3::new(a * ce * ca, a * ce * sa, a * se)
        } else {
            Vector3::new(a, b, c)
        };
        let position = (self.file_from_scan * na::Point3::from(position)).coords;
        if !position.iter().all(|v| v.is_finite()) {
            return false;
        }
        let color = self.color.as_ref().map_or([0; 3], |columns| {
            columns
                .each_ref()
                .map(|column| (share(number(column), &column.1) * 255.0).round().clamp(0.0, 255.0) as u8)
        });
        let intensity = self.intensity.as_ref().map_or(0.0, number) as f32;
        out.push(position.into(), intensity, self.time.as_ref().map_or(0.0, number), color);
        true
    }
}

fn number(value: Option<&RecordValue>, kind: &RecordDataType) -> f64 {
    match (value, kind) {
        (Some(RecordValue::Single(v)), _) => f64::from(*v),
        (Some(RecordValue::Double(v)), _) => *v,
        (Some(RecordValue::ScaledInteger(v)), RecordDataType::ScaledInteger { scale, offset, .. }) => {
            *v as f64 * scale + offset
        }
        (Some(RecordValue::ScaledInteger(v) | RecordValue::Integer(v)), _) => *v as f64,
        (None, _) => 0.0,
    }
}

/// A colour as a fraction of its largest value.
fn share(value: f64, kind: &RecordDataType) -> f64 {
    match kind {
        RecordDataType::Integer { min, max } if max > min => {
            (value - *min as f64) / (*max as f64 - *min as f64)
        }
        _ => value,
    }
}

fn pose(scan: &Scan) -> Rigid3 {
    let Some(transform) = &scan.transform else { return Rigid3::identity() };
    let (q, t) = (&transform.rotation, &transform.translation);
    let q = na::Quaternion::new(q.w, q.x, q.y, q.z);
    // A quaternion of norm zero is not a rotation: the identity replaces it.
    let rotation = na::UnitQuaternion::try_new(q, 1e-9).unwrap_or_default();
    Rigid3::from_parts(na::Translation3::new(t.x, t.y, t.z), rotation)
}

/// Writes one scan. Points are buffered in a temporary file, because the library takes them all at once.
pub(crate) struct E57Writer {
    output: Output,
    attributes: Attributes,
    spool: Spool,
    bytes: Vec<u8>,
    written: Written,
}

impl E57Writer {
    /// # Errors
    /// The file, or the temporary one for its points, cannot be created in the folder.
    pub fn create(path: &Path, attributes: Attributes) -> Result<Self, CloudError> {
        let output = Output::create(path)?;
        let folder = folder_of(path);
        let spool = Spool::in_folder(folder).map_err(|e| CloudError::temporary(folder, e))?;
        Ok(Self {
            output,
            attributes,
            spool,
            bytes: Vec::new(),
            written: Written { points: 0, not_finite: 0 },
        })
    }

    fn prototype(&self) -> Vec<Record> {
        let record = |name: RecordName, data_type: RecordDataType| Record { name, data_type };
        let byte = || RecordDataType::Integer { min: 0, max: 255 };
        let double = || RecordDataType::Double { min: None, max: None };
        let mut prototype = vec![
            record(RecordName::CartesianX, double()),
            record(RecordName::CartesianY, double()),
            record(RecordName::CartesianZ, double()),
        ];
        if self.attributes.intensity {
            prototype.push(record(RecordName::Intensity, RecordDataType::Single { min: None, max: None }));
        }
        if self.attributes.time {
            prototype.push(record(RecordName::TimeStamp, double()));
        }
        if self.attributes.color {
            prototype.extend(
                [RecordName::ColorRed, RecordName::ColorGreen, RecordName::ColorBlue]
                    .map(|n| record(n, byte())),
            );
        }
        prototype
    }

    fn write_file(&mut self) -> Result<(), String> {
        let text = |error: e57::Error| error.to_string();
        let handle = Persistent(self.output.handle().map_err(|e| e.to_string())?);
        // Constant names, so that the same points give the same bytes.
        let mut file = e57::E57Writer::new(handle, "{portolan-file}").map_err(text)?;
        let prototype = self.prototype();
        let mut points = file.add_pointcloud("{portolan-points}", prototype).map_err(text)?;
        let row = 24
            + if self.attributes.intensity { 4 } else { 0 }
            + if self.attributes.time { 8 } else { 0 }
            + if self.attributes.color { 3 } else { 0 };
        let rows_at_once = BATCH_POINTS as u64;
        let mut at = 0;
        while at < self.spool.length() {
            let count = ((self.spool.length() - at) / row as u64).min(rows_at_once) as usize;
            if count == 0 {
                break;
            }
            self.bytes.resize(count * row, 0);
            self.spool.read_at(at, &mut self.bytes).map_err(|e| e.to_string())?;
            at += (count * row) as u64;
            for bytes in self.bytes.chunks_exact(row) {
                points.add_point(values(bytes, self.attributes)).map_err(text)?;
            }
        }
        points.finalize().map_err(text)?;
        file.finalize().map_err(text)
    }
}

/// A file whose reads are repeated after a signal; the library does not do that.
struct Persistent<F>(F);

impl<F: Read> Read for Persistent<F> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            match self.0.read(bytes) {
                Err(error) if error.kind() == Interrupted => {}
                read => return read,
            }
        }
    }
}

impl<F: Write> Write for Persistent<F> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl<F: Seek> Seek for Persistent<F> {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.0.seek(position)
    }
}

/// The values of a point from its bytes in the spool.
fn values(bytes: &[u8], attributes: Attributes) -> RawValues {
    let mut rest = bytes;
    let mut take = |count: usize| {
        let (value, after) = rest.split_at_checked(count).unwrap_or((&[], rest));
        rest = after;
        value
    };
    let double = |b: &[u8]| RecordValue::Double(b.try_into().map_or(0.0, f64::from_le_bytes));
    let mut values: RawValues = (0..3).map(|_| double(take(8))).collect();
    if attributes.intensity {
        values.push(RecordValue::Single(take(4).try_into().map_or(0.0, f32::from_le_bytes)));
    }
    if attributes.time {
        values.push(double(take(8)));
    }
    if attributes.color {
        values.extend(take(3).iter().map(|c| RecordValue::Integer(i64::from(*c))));
    }
    values
}

impl CloudWriter for E57Writer {
    fn write(&mut self, batch: &PointCloud) -> Result<(), CloudError> {
        self.bytes.clear();
        for index in 0..batch.len() {
            if batch.position(index).iter().all(|v| v.is_finite()) {
                crate::ply::push_bytes(&mut self.bytes, batch, index, self.attributes, true);
                self.written.points += 1;
            } else {
                self.written.not_finite += 1;
            }
        }
        let folder = folder_of(&self.output.path);
        self.spool.append(&self.bytes).map_err(|e| CloudError::temporary(folder, e))
    }

    fn finish(mut self: Box<Self>) -> Result<Written, CloudError> {
        let path = self.output.path.clone();
        self.write_file().map_err(|detail| CloudError::Unwritable { path, detail })?;
        self.output.finish()?;
        Ok(self.written)
    }
}
