//! Clouds as binary PLY files, written point by point.

use std::io::Write;
use std::path::Path;

use portolan_mapfile::{AtomicFile, WriteError};

/// Coordinates beyond this need double precision to be good to a millimetre.
const SINGLE_PRECISION_REACH: f64 = 8192.0;

/// A binary little-endian PLY file of points with x, y and z in metres. Single precision where that is good to
/// a millimetre.
pub struct PlyWriter {
    file: AtomicFile,
    double: bool,
    promised: u64,
    written: u64,
}

impl PlyWriter {
    /// Begins a file of `count` points whose coordinates are at most `reach` metres from zero.
    pub fn create(path: &Path, count: u64, reach: f64) -> Result<Self, WriteError> {
        let double = reach > SINGLE_PRECISION_REACH;
        let mut file = AtomicFile::create(path)?;
        let kind = if double { "double" } else { "float" };
        let header = format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\nend_header\n"
        );
        match file.write_all(header.as_bytes()) {
            Ok(()) => Ok(Self { file, double, promised: count, written: 0 }),
            Err(source) => Err(file.error(source)),
        }
    }

    /// Writes the next point; points beyond the promised count are not written.
    pub fn write(&mut self, point: [f64; 3]) -> Result<(), WriteError> {
        if self.written == self.promised {
            return Ok(());
        }
        self.written += 1;
        let mut bytes = [0u8; 24];
        let used = if self.double {
            for (bytes, v) in bytes.chunks_exact_mut(8).zip(point) {
                bytes.copy_from_slice(&v.to_le_bytes());
            }
            24
        } else {
            for (bytes, v) in bytes.chunks_exact_mut(4).zip(point) {
                bytes.copy_from_slice(&(v as f32).to_le_bytes());
            }
            12
        };
        self.file.write_all(&bytes[..used]).map_err(|source| self.file.error(source))
    }

    /// Completes the file.
    ///
    /// # Errors
    /// Fails if fewer points than promised were written, or the file cannot be written.
    pub fn finish(self) -> Result<(), WriteError> {
        if self.written < self.promised {
            let what = format!("{} of {} points were given", self.written, self.promised);
            return Err(self.file.error(std::io::Error::other(what)));
        }
        self.file.commit()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_follow_the_header() {
        let folder = tempfile::tempdir().unwrap();
        for (reach, size) in [(10.0, 12), (1e6, 24)] {
            let path = folder.path().join("cloud.ply");
            let mut ply = PlyWriter::create(&path, 2, reach).unwrap();
            ply.write([1.0, 2.0, 3.0]).unwrap();
            ply.write([4.0, 5.0, -6.0]).unwrap();
            ply.write([7.0; 3]).unwrap();
            ply.finish().unwrap();
            let bytes = std::fs::read(&path).unwrap();
            let start = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            assert_eq!(bytes.len() - start, 2 * size);
            let last = &bytes[bytes.len() - size / 3..];
            let z = if size == 12 {
                f64::from(f32::from_le_bytes(last.try_into().unwrap()))
            } else {
                f64::from_le_bytes(last.try_into().unwrap())
            };
            assert_eq!(z, -6.0);
        }
        let path = folder.path().join("short.ply");
        assert!(PlyWriter::create(&path, 1, 1.0).unwrap().finish().is_err() && !path.exists());
    }
}
