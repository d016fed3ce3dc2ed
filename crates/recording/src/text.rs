//! Reads text logs line by line: plain, gzip or bzip2, complete or cut off.
//!
//! Short logs (up to 64 MiB of text) are decompressed once and kept, because a recording is read
//! more than once; longer ones are decompressed again in every pass.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use portolan_input::{Line, read_line, skip_line};

use crate::container::most_unpacked;

use crate::{
    CarmenLog, CarmenOptions, CoreSlamLog, Recording, RecordingError, looks_like_carmen, looks_like_coreslam,
};

/// Maximum size of a text that is kept in memory, bytes.
const CACHE_BYTES: u64 = 64 << 20;
/// Maximum length of a line, bytes; a scan of 100,000 beams is shorter.
const LINE_BYTES: usize = 1 << 20;
/// Number of bytes at the start of a text that are used to recognise its format.
const PREFIX_BYTES: u64 = 1 << 17;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Compression {
    None,
    Gzip,
    Bzip2,
}

impl Compression {
    fn of(bytes: &[u8]) -> Self {
        match bytes {
            [0x1f, 0x8b, ..] => Self::Gzip,
            [b'B', b'Z', b'h', ..] => Self::Bzip2,
            _ => Self::None,
        }
    }
}

/// A text file that can be read any number of times.
#[derive(Clone, Debug)]
pub(crate) struct TextFile {
    path: PathBuf,
    size_bytes: u64,
    compression: Compression,
    /// The whole text, unless it is too long to keep.
    cached: Option<CachedText>,
}

/// Text in memory, and the error that ended it early.
type CachedText = (Arc<[u8]>, Option<String>);

impl TextFile {
    /// Opens the file and reads it if it is short.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut text = Self::probe(path)?;
        text.cached = text.read_if_short()?;
        Ok(text)
    }

    /// Determines size and compression only.
    fn probe(path: &Path) -> Result<Self, RecordingError> {
        let io_error = |source| RecordingError::Io { path: path.to_owned(), source };
        let mut file = File::open(path).map_err(io_error)?;
        let size_bytes = file.metadata().map_err(io_error)?.len();
        let mut magic = Vec::with_capacity(3);
        (&mut file).take(3).read_to_end(&mut magic).map_err(io_error)?;
        let compression = Compression::of(&magic);
        Ok(Self { path: path.to_owned(), size_bytes, compression, cached: None })
    }

    /// Decompresses bytes in memory.
    fn from_bytes(name: &Path, bytes: &[u8]) -> Result<Self, RecordingError> {
        let compression = Compression::of(bytes);
        let mut text = Vec::new();
        let stream: Box<dyn Read> = match compression {
            Compression::None => Box::new(bytes),
            Compression::Gzip => Box::new(flate2::bufread::MultiGzDecoder::new(bytes)),
            Compression::Bzip2 => Box::new(bzip2::bufread::MultiBzDecoder::new(bytes)),
        };
        let mut file =
            Self { path: name.to_owned(), size_bytes: bytes.len() as u64, compression, cached: None };
        let damage = match stream.take(CACHE_BYTES).read_to_end(&mut text) {
            Ok(_) if text.len() as u64 == CACHE_BYTES => Some("text beyond 64 MiB was not read".to_owned()),
            Ok(_) => None,
            Err(error) => Some(file.damage(error)?),
        };
        file.cached = Some((text.into(), damage));
        Ok(file)
    }

    /// Opens the text as a log of the format that its beginning has; `None` if it has none.
    fn into_log(self, prefix: &[u8]) -> Result<Option<Box<dyn Recording>>, RecordingError> {
        if looks_like_carmen(prefix) {
            return Ok(Some(Box::new(CarmenLog::of(self, CarmenOptions::default())?)));
        }
        if looks_like_coreslam(prefix) {
            return Ok(Some(Box::new(CoreSlamLog::of(self)?)));
        }
        Ok(None)
    }

    /// Path of the file, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn read_if_short(&self) -> Result<Option<CachedText>, RecordingError> {
        let (stream, _) = self.stream()?;
        let mut bytes = Vec::new();
        let result = stream.take(CACHE_BYTES + 1).read_to_end(&mut bytes);
        if bytes.len() as u64 > CACHE_BYTES {
            return Ok(None);
        }
        let damage = match result {
            Ok(_) => None,
            Err(error) => Some(self.damage(error)?),
        };
        Ok(Some((bytes.into(), damage)))
    }

    fn stream(&self) -> Result<(Box<dyn BufRead + Send>, Arc<AtomicU64>), RecordingError> {
        let file = File::open(&self.path)
            .map_err(|source| RecordingError::Io { path: self.path.clone(), source })?;
        let position = Arc::new(AtomicU64::new(0));
        let file = BufReader::with_capacity(1 << 16, Counted { file, position: position.clone() });
        let stream: Box<dyn BufRead + Send> = match self.compression {
            Compression::None => Box::new(file),
            Compression::Gzip => self.unpacked(flate2::bufread::MultiGzDecoder::new(file)),
            Compression::Bzip2 => self.unpacked(bzip2::bufread::MultiBzDecoder::new(file)),
        };
        Ok((stream, position))
    }

    /// The decompressed text, with a limit on its size.
    fn unpacked(&self, unpacker: impl Read + Send + 'static) -> Box<dyn BufRead + Send> {
        Box::new(BufReader::new(Bounded { unpacker, left: most_unpacked(self.size_bytes) }))
    }

    /// Describes the damage of a compressed file, which ends there; other read errors are returned as errors.
    fn damage(&self, error: std::io::Error) -> Result<String, RecordingError> {
        let damaged = matches!(
            error.kind(),
            ErrorKind::UnexpectedEof | ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::Other
        );
        if self.compression == Compression::None || !damaged {
            return Err(RecordingError::Io { path: self.path.clone(), source: error });
        }
        Ok(error.to_string())
    }

    /// Bytes on disk.
    pub fn size_bytes(&self) -> u64 {
        self.size_bytes
    }

    /// " (bzip2)" and the like, for the name of the format.
    pub fn compression_name(&self) -> &'static str {
        match self.compression {
            Compression::None => "",
            Compression::Gzip => " (gzip)",
            Compression::Bzip2 => " (bzip2)",
        }
    }

    /// Starts reading at the first line.
    pub fn lines(&self) -> Result<Lines, RecordingError> {
        let source = match &self.cached {
            Some((bytes, _)) => Source::Memory(Cursor::new(bytes.clone())),
            None => {
                let (stream, position) = self.stream()?;
                Source::Stream(stream, position)
            }
        };
        Ok(Lines { file: self.clone(), source, line: Vec::new(), overlong: 0, damage: None })
    }
}

/// Opens a text log of any format, compressed or not; `None` if its beginning is of no known format.
pub fn open_text_log(path: &Path) -> Result<Option<Box<dyn Recording>>, RecordingError> {
    let file = TextFile::probe(path)?;
    let mut prefix = Vec::new();
    // If nothing can be decompressed, it is not a text log.
    let _ = file.stream()?.0.take(PREFIX_BYTES).read_to_end(&mut prefix);
    if looks_like_carmen(&prefix) || looks_like_coreslam(&prefix) {
        return TextFile::open(path)?.into_log(&prefix);
    }
    Ok(None)
}

/// As [`open_text_log`], for bytes in memory; `name` is used in messages. Text beyond 64 MiB is lost, and the
/// loss is counted.
pub fn open_text_log_bytes(name: &Path, bytes: &[u8]) -> Result<Option<Box<dyn Recording>>, RecordingError> {
    let file = TextFile::from_bytes(name, bytes)?;
    let prefix: Vec<u8> =
        file.cached.iter().flat_map(|(text, _)| text.iter().take(PREFIX_BYTES as usize)).copied().collect();
    file.into_log(&prefix)
}

/// Decompressed text. It ends with an error if it is longer than a recording of that file size can be, so
/// that a few bytes cannot keep every pass busy for hours.
struct Bounded<R> {
    unpacker: R,
    left: u64,
}

impl<R: Read> Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.left == 0 && !buffer.is_empty() {
            return match self.unpacker.read(&mut [0])? {
                0 => Ok(0),
                _ => Err(std::io::Error::new(
                    ErrorKind::InvalidData,
                    "it unpacks to far more text than any recording of its size holds",
                )),
            };
        }
        let most = usize::try_from(self.left).unwrap_or(usize::MAX).min(buffer.len());
        let count = self.unpacker.read(buffer.get_mut(..most).unwrap_or_default())?;
        self.left -= count as u64;
        Ok(count)
    }
}

struct Counted {
    file: File,
    position: Arc<AtomicU64>,
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.position.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

enum Source {
    Memory(Cursor<Arc<[u8]>>),
    Stream(Box<dyn BufRead + Send>, Arc<AtomicU64>),
}

/// One pass over the lines of a text file.
pub(crate) struct Lines {
    file: TextFile,
    source: Source,
    line: Vec<u8>,
    overlong: u64,
    damage: Option<String>,
}

impl Lines {
    /// The next line without its end, `None` after the last. Lines that are too long are skipped and counted.
    pub fn next_line(&mut self) -> Result<Option<&[u8]>, RecordingError> {
        loop {
            let stream: &mut dyn BufRead = match &mut self.source {
                Source::Memory(cursor) => cursor,
                Source::Stream(stream, _) => stream,
            };
            let read = match read_line(stream, LINE_BYTES, &mut self.line) {
                Ok(Line::TooLong) => skip_line(stream).map(|()| Line::TooLong),
                other => other,
            };
            match read {
                Ok(Line::Whole) => return Ok(Some(&self.line)),
                Ok(Line::TooLong) => self.overlong += 1,
                Ok(Line::End) => {
                    if let Some((_, damage)) = &self.file.cached {
                        self.damage.clone_from(damage);
                    }
                    return Ok(None);
                }
                Err(error) => {
                    self.damage = Some(self.file.damage(error)?);
                    return Ok(None);
                }
            }
        }
    }

    /// Number of lines that were skipped because they are too long.
    pub fn overlong(&self) -> u64 {
        self.overlong
    }

    /// The damage that ended the file early, once the end is reached.
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    /// Bytes of the file consumed so far.
    pub fn position_bytes(&self) -> u64 {
        match &self.source {
            Source::Stream(_, position) => position.load(Ordering::Relaxed),
            Source::Memory(cursor) => {
                let share = cursor.position() as f64 / cursor.get_ref().len().max(1) as f64;
                (share * self.file.size_bytes as f64) as u64
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn lines_of(bytes: &[u8]) -> (Vec<String>, Option<String>, u64) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log");
        std::fs::write(&path, bytes).unwrap();
        let mut lines = TextFile::open(&path).unwrap().lines().unwrap();
        let mut found = Vec::new();
        while let Some(line) = lines.next_line().unwrap() {
            found.push(String::from_utf8_lossy(line).into_owned());
        }
        (found, lines.damage().map(str::to_owned), lines.overlong())
    }

    #[test]
    fn a_few_bytes_do_not_unpack_for_ever() {
        let line = [&[b'a'; 1023][..], b"\n"].concat();
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        (0..80 << 10).for_each(|_| gzip.write_all(&line).unwrap());
        let bytes = gzip.finish().unwrap();
        assert!(bytes.len() < 1 << 18, "{}", bytes.len());
        let (lines, damage, _) = lines_of(&bytes);
        assert_eq!(lines.len(), 64 << 10);
        assert!(damage.is_some_and(|damage| damage.contains("far more text")));
    }

    #[test]
    fn plain_and_compressed_text_reads_the_same() {
        let text = b"one\r\ntwo\n\nthree";
        let expected = ["one", "two", "", "three"];
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(text).unwrap();
        let mut bzip = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
        bzip.write_all(text).unwrap();
        for bytes in [text.to_vec(), gzip.finish().unwrap(), bzip.finish().unwrap()] {
            let (lines, damage, overlong) = lines_of(&bytes);
            assert_eq!(lines, expected);
            assert_eq!((damage, overlong), (None, 0));
        }
    }

    #[test]
    fn a_truncated_file_gives_its_remaining_lines() {
        let text: Vec<u8> =
            (0..20_000).flat_map(|i| format!("line {}\n", i * 7919 % 10_007).into_bytes()).collect();
        let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gzip.write_all(&text).unwrap();
        let gzip = gzip.finish().unwrap();
        let (lines, damage, _) = lines_of(&gzip[..gzip.len() / 2]);
        assert!(lines.len() > 5000 && lines.len() < 15_000, "{}", lines.len());
        assert!(damage.is_some());
        let mut bzip = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
        bzip.write_all(&text).unwrap();
        let bzip = bzip.finish().unwrap();
        let (_, damage, _) = lines_of(&bzip[..bzip.len() / 2]);
        assert!(damage.is_some());
    }

    #[test]
    fn an_endless_line_is_passed_over() {
        let mut text = vec![b'x'; 3 << 20];
        text.extend_from_slice(b"\nshort\n");
        let (lines, damage, overlong) = lines_of(&text);
        assert_eq!((lines.as_slice(), damage, overlong), (["short".to_owned()].as_slice(), None, 1));
    }
}
