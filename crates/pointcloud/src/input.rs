//! Reading files piece by piece: lines of bounded length, rows of bytes.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::error::CloudError;

/// Longer lines are cut.
const MAX_LINE: usize = 1 << 16;

/// A file that is read from start to end.
pub(crate) struct Input {
    pub path: PathBuf,
    reader: BufReader<File>,
    length: u64,
    line: Vec<u8>,
}

impl Input {
    pub fn open(path: &Path) -> Result<Self, CloudError> {
        let file = File::open(path).map_err(|e| CloudError::read(path, e))?;
        let length = file.metadata().map_err(|e| CloudError::read(path, e))?.len();
        Ok(Self {
            path: path.to_owned(),
            reader: BufReader::with_capacity(1 << 18, file),
            length,
            line: Vec::new(),
        })
    }

    /// Bytes of the file.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Bytes read so far.
    pub fn position(&mut self) -> Result<u64, CloudError> {
        self.reader.stream_position().map_err(|e| CloudError::read(&self.path, e))
    }

    pub fn seek(&mut self, position: u64) -> Result<(), CloudError> {
        self.reader.seek(SeekFrom::Start(position)).map(drop).map_err(|e| CloudError::read(&self.path, e))
    }

    /// The next line without its end; none at the end of the file. What is beyond 64 KiB is dropped.
    pub fn line(&mut self) -> Result<Option<&str>, CloudError> {
        self.line.clear();
        let mut any = false;
        loop {
            let buffer = self.reader.fill_buf().map_err(|e| CloudError::read(&self.path, e))?;
            if buffer.is_empty() {
                break;
            }
            any = true;
            let end = buffer.iter().position(|b| *b == b'\n');
            let taken = end.map_or(buffer.len(), |end| end + 1);
            let room = MAX_LINE.saturating_sub(self.line.len());
            let text = buffer.get(..end.unwrap_or(buffer.len())).unwrap_or_default();
            self.line.extend_from_slice(text.get(..text.len().min(room)).unwrap_or_default());
            self.reader.consume(taken);
            if end.is_some() {
                break;
            }
        }
        if !any {
            return Ok(None);
        }
        if self.line.last() == Some(&b'\r') {
            self.line.pop();
        }
        // Text in other encodings only appears in comments.
        if std::str::from_utf8(&self.line).is_err() {
            self.line.iter_mut().filter(|b| !b.is_ascii()).for_each(|b| *b = b'?');
        }
        Ok(std::str::from_utf8(&self.line).ok())
    }

    /// Fills `bytes` as far as the file goes; how many there were.
    pub fn fill(&mut self, bytes: &mut [u8]) -> Result<usize, CloudError> {
        let mut done = 0;
        while let Some(rest) = bytes.get_mut(done..).filter(|rest| !rest.is_empty()) {
            match self.reader.read(rest) {
                Ok(0) => break,
                Ok(count) => done += count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(CloudError::read(&self.path, error)),
            }
        }
        Ok(done)
    }
}

/// Numbers of a line, parted by spaces, commas or semicolons; false if one is no number.
pub(crate) fn numbers(line: &str, into: &mut Vec<f64>) -> bool {
    into.clear();
    for part in line.split([' ', '\t', ',', ';']).filter(|part| !part.is_empty()) {
        match part.parse() {
            Ok(value) => into.push(value),
            Err(_) => return false,
        }
    }
    true
}
