//! `write_ply`, `write_pcd` and `write_xyz` (`formats.md` §6.1 to §6.3).

use std::io::Write as _;
use std::path::{Path, PathBuf};

use portolan_atomic_file::AtomicFile;
use portolan_geometry::NearFrame;
use portolan_numeric::format_general;

use super::{Flush, Log, PointsBatch, PointsError, Stage};
use crate::colour::to_bytes;

/// Number of significant digits of coordinates in text far from the origin: hundredths of a millimetre in UTM.
const DIGITS_FAR_AWAY: usize = 12;

/// Format of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CloudKind {
    Ply,
    Pcd,
    Xyz,
}

/// Writes all points.
pub(super) struct WriteCloud {
    kind: CloudKind,
    path: PathBuf,
    /// Frame of the points.
    frame: NearFrame,
    file: Option<AtomicFile>,
    /// Content of the first points.
    content: Content,
    count: u64,
    bytes: Vec<u8>,
}

/// Values of points in the file.
#[derive(Clone, Copy, Default)]
struct Content {
    /// Whether positions are in double precision: those far from the origin.
    is_double: bool,
    colours: bool,
    intensities: bool,
}

impl WriteCloud {
    /// Creates the file at once, so that errors are reported before points are processed.
    pub fn create(kind: CloudKind, path: PathBuf, frame: &NearFrame) -> Result<Self, PointsError> {
        let file = Some(AtomicFile::create(&path)?);
        let (frame, content) = (*frame, Content::default());
        Ok(Self { kind, path, frame, file, content, count: 0, bytes: Vec::new() })
    }

    fn check(&self, batch: &PointsBatch) -> Result<(), PointsError> {
        let missing = |what| Err(PointsError::Missing { path: self.path.display().to_string(), what });
        match (
            self.content.colours && batch.colors.is_empty(),
            self.content.intensities && batch.intensities.is_empty(),
        ) {
            (true, _) => missing("colours"),
            (_, true) => missing("intensities"),
            _ => Ok(()),
        }
    }

    fn encode(&mut self, batch: &PointsBatch) {
        self.bytes.clear();
        for (i, point) in batch.points.iter().enumerate() {
            let near = point.coords.cast::<f64>();
            let place = if self.content.is_double { near + self.frame.origin() } else { near };
            if self.kind == CloudKind::Xyz {
                let digits = if self.content.is_double { DIGITS_FAR_AWAY } else { 6 };
                let [x, y, z] = [place.x, place.y, place.z].map(|v| format_general(v, digits));
                self.bytes.extend_from_slice(format!("{x} {y} {z}\n").as_bytes());
                continue;
            }
            match self.content.is_double {
                true => place.iter().for_each(|v| self.bytes.extend(v.to_le_bytes())),
                false => point.coords.iter().for_each(|v| self.bytes.extend(v.to_le_bytes())),
            }
            if let (true, Some(colour)) = (self.content.colours, batch.colors.get(i)) {
                let [r, g, b] = to_bytes(*colour);
                match self.kind {
                    CloudKind::Ply => self.bytes.extend([r, g, b]),
                    _ => self.bytes.extend([b, g, r, 0]),
                }
            }
            if let (true, Some(intensity)) = (self.content.intensities, batch.intensities.get(i)) {
                self.bytes.extend(intensity.to_le_bytes());
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), PointsError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.write_all(bytes).map_err(|source| file.error(source).into())
    }
}

impl Stage for WriteCloud {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        if batch.points.is_empty() {
            return Ok(true);
        }
        if self.count == 0 {
            let colours = !batch.colors.is_empty() && self.kind != CloudKind::Xyz;
            let intensities = !batch.intensities.is_empty() && self.kind == CloudKind::Ply;
            let is_double = !self.frame.is_map();
            self.content = Content { is_double, colours, intensities };
            self.write(header(self.kind, self.content, 0).as_bytes())?;
        }
        self.check(batch)?;
        self.encode(batch);
        let bytes = std::mem::take(&mut self.bytes);
        self.write(&bytes)?;
        self.bytes = bytes;
        self.count += batch.points.len() as u64;
        Ok(true)
    }

    fn end_pass(&mut self, _flush: Flush, log: Log) -> Result<(), PointsError> {
        let Some(mut file) = self.file.take() else { return Ok(()) };
        let header = header(self.kind, self.content, self.count);
        file.overwrite(0, header.as_bytes()).map_err(|source| file.error(source))?;
        file.commit()?;
        log(&format!("Wrote {} points to '{}'.", self.count, Path::display(&self.path)));
        Ok(())
    }
}

/// The header, of the same length for any number of points.
fn header(kind: CloudKind, content: Content, count: u64) -> String {
    match kind {
        CloudKind::Xyz => String::new(),
        CloudKind::Ply => {
            let scalar = if content.is_double { "double" } else { "float" };
            let colours = ["red", "green", "blue"].map(|c| format!("property uchar {c}\n")).concat();
            format!(
                "ply\nformat binary_little_endian 1.0\ncomment generated by Cartographer\nelement vertex \
                 {count:015}\nproperty {scalar} x\nproperty {scalar} y\nproperty {scalar} z\n{}{}end_header\n",
                if content.colours { &colours } else { "" },
                if content.intensities { "property float intensity\n" } else { "" },
            )
        }
        CloudKind::Pcd => {
            let with = |text| if content.colours { text } else { "" };
            let size = if content.is_double { "8 8 8" } else { "4 4 4" };
            format!(
                "# generated by Cartographer\nVERSION .7\nFIELDS x y z{}\nSIZE {size}{}\nTYPE F F F{}\nCOUNT 1 1 \
                 1{}\nWIDTH {count:015}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count:015}\nDATA binary\n",
                with(" rgb"),
                with(" 4"),
                with(" U"),
                with(" 1"),
            )
        }
    }
}
