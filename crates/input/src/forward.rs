//! Input that is read once, from start to end.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

/// Size of the read buffer, bytes.
const BUFFER: usize = 256 << 10;

/// File or pipe that is read forward. Bytes returned by [`Forward::peek`] are read again.
pub struct Forward {
    /// Peeked bytes, of which the first `taken` have been read.
    start: Vec<u8>,
    taken: usize,
    rest: BufReader<Box<dyn Read + Send>>,
    /// Total size, bytes; none if unknown.
    length: Option<u64>,
    position: u64,
}

impl Forward {
    /// Opens a file, a pipe, a device, or the standard input (`-`).
    ///
    /// # Errors
    /// Errors of the system; [`io::ErrorKind::IsADirectory`] for a folder.
    pub fn open(path: &Path) -> io::Result<Self> {
        if path == Path::new("-") {
            return Ok(Self::of(Box::new(io::stdin()), None));
        }
        let file = File::open(path)?;
        let metadata = file.metadata()?;
        if metadata.is_dir() {
            return Err(io::Error::new(io::ErrorKind::IsADirectory, "this is a folder, not a file"));
        }
        // The length that the system reports for pipes and devices is meaningless.
        let length = metadata.is_file().then_some(metadata.len());
        Ok(Self::of(Box::new(file), length))
    }

    /// From any source; `length` is its size in bytes, if known.
    pub fn of(source: Box<dyn Read + Send>, length: Option<u64>) -> Self {
        let rest = BufReader::with_capacity(BUFFER, source);
        Self { start: Vec::new(), taken: 0, rest, length, position: 0 }
    }

    /// Total size, bytes; none for pipes and devices.
    pub fn length(&self) -> Option<u64> {
        self.length
    }

    /// Bytes read so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The next `count` bytes, or fewer at the end of the input. They are read again afterwards.
    ///
    /// # Errors
    /// Errors of the input.
    pub fn peek(&mut self, count: usize) -> io::Result<&[u8]> {
        self.start.drain(..self.taken);
        self.taken = 0;
        let missing = count.saturating_sub(self.start.len());
        self.rest.by_ref().take(missing as u64).read_to_end(&mut self.start)?;
        Ok(self.start.get(..count).unwrap_or(&self.start))
    }

    /// Skips `count` bytes; returns the number of bytes skipped, which is smaller at the end of the input.
    ///
    /// # Errors
    /// Errors of the input.
    pub fn skip(&mut self, count: u64) -> io::Result<u64> {
        io::copy(&mut self.take(count), &mut io::sink())
    }
}

impl Read for Forward {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = match self.start.get(self.taken..).filter(|start| !start.is_empty()) {
            Some(mut start) => {
                let count = start.read(buffer)?;
                self.taken += count;
                count
            }
            None => self.rest.read(buffer)?,
        };
        self.position += count as u64;
        Ok(count)
    }
}

impl BufRead for Forward {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        match self.start.get(self.taken..).filter(|start| !start.is_empty()) {
            Some(start) => Ok(start),
            None => self.rest.fill_buf(),
        }
    }

    fn consume(&mut self, count: usize) {
        self.position += count as u64;
        if self.taken < self.start.len() {
            self.taken = (self.taken + count).min(self.start.len());
        } else {
            self.rest.consume(count);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Returns one byte per read, as a pipe may.
    struct Slow(&'static [u8]);

    impl Read for Slow {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let most = buffer.len().min(1);
            self.0.read(&mut buffer[..most])
        }
    }

    #[test]
    fn peeked_bytes_are_read_again() {
        let mut input = Forward::of(Box::new(Slow(b"first\nsecond\nthird")), None);
        assert_eq!(input.peek(3).unwrap(), b"fir");
        assert_eq!(input.peek(8).unwrap(), b"first\nse");
        assert_eq!(input.peek(2).unwrap(), b"fi");
        let mut line = String::new();
        input.read_line(&mut line).unwrap();
        assert_eq!((line.as_str(), input.position()), ("first\n", 6));
        assert_eq!(input.peek(3).unwrap(), b"sec");
        assert_eq!(input.skip(7).unwrap(), 7);
        let mut rest = String::new();
        input.read_to_string(&mut rest).unwrap();
        assert_eq!((rest.as_str(), input.position()), ("third", 18));
        assert_eq!(input.peek(9).unwrap(), b"");
        assert_eq!(input.skip(9).unwrap(), 0);
    }

    #[test]
    fn files_have_a_length_and_folders_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "abc").unwrap();
        assert_eq!(Forward::open(&path).unwrap().length(), Some(3));
        assert!(Forward::open(folder.path()).is_err());
    }
}
