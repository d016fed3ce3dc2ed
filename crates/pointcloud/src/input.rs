//! Reads files in pieces: lines of bounded length, rows of bytes.

use std::io::Read;
use std::path::{Path, PathBuf};

use portolan_input::{Forward, Line, read_line, skip_line};

use crate::error::CloudError;

/// Maximum length of a line, bytes.
const MAX_LINE: usize = 1 << 16;

/// A file or pipe that is read from start to end.
pub(crate) struct Input {
    pub path: PathBuf,
    reader: Forward,
    line: Vec<u8>,
    line_number: u64,
}

/// A line of a cloud.
pub(crate) enum CloudLine<'a> {
    Text(&'a str),
    /// Longer than the maximum; skipped.
    TooLong,
}

impl Input {
    /// # Errors
    /// The file cannot be opened.
    pub fn open(path: &Path) -> Result<Self, CloudError> {
        let reader = Forward::open(path).map_err(|e| CloudError::read(path, e))?;
        Ok(Self { path: path.to_owned(), reader, line: Vec::new(), line_number: 0 })
    }

    /// The next bytes without consuming them.
    ///
    /// # Errors
    /// Reading fails.
    pub fn peek(&mut self, count: usize) -> Result<&[u8], CloudError> {
        self.reader.peek(count).map_err(|e| CloudError::read(&self.path, e))
    }

    /// Number of rows of this size still to come; none if the length is unknown (a pipe).
    pub fn rows_left(&self, row_bytes: u64) -> Option<u64> {
        let left = self.reader.length()?.saturating_sub(self.reader.position());
        Some(left / row_bytes.max(1))
    }

    /// Skips bytes; false if the file ends before.
    ///
    /// # Errors
    /// Reading fails.
    pub fn skip(&mut self, count: u64) -> Result<bool, CloudError> {
        let skipped = self.reader.skip(count).map_err(|e| CloudError::read(&self.path, e))?;
        Ok(skipped == count)
    }

    /// The next line without its end; none at the end of the file.
    ///
    /// # Errors
    /// A line longer than 64 KiB: the file is probably not text.
    pub fn line(&mut self) -> Result<Option<&str>, CloudError> {
        let number = self.line_number + 1;
        let path = self.path.clone();
        match self.line_of_any_length()? {
            None => Ok(None),
            Some(CloudLine::Text(text)) => Ok(Some(text)),
            Some(CloudLine::TooLong) => Err(CloudError::damaged(
                &path,
                format!("line {number} is longer than 64 KiB, so this is not text with a point a line"),
            )),
        }
    }

    /// The next line; one that is too long is not an error.
    ///
    /// # Errors
    /// Reading fails.
    pub fn line_of_any_length(&mut self) -> Result<Option<CloudLine<'_>>, CloudError> {
        let error = |e| CloudError::read(&self.path, e);
        self.line_number += 1;
        match read_line(&mut self.reader, MAX_LINE, &mut self.line).map_err(error)? {
            Line::End => return Ok(None),
            Line::TooLong => {
                skip_line(&mut self.reader).map_err(error)?;
                return Ok(Some(CloudLine::TooLong));
            }
            Line::Whole => {}
        }
        // Text in other encodings occurs only in comments.
        if std::str::from_utf8(&self.line).is_err() {
            self.line.iter_mut().filter(|b| !b.is_ascii()).for_each(|b| *b = b'?');
        }
        Ok(std::str::from_utf8(&self.line).ok().map(CloudLine::Text))
    }

    /// Fills `bytes` up to the end of the file; returns the number of bytes read.
    ///
    /// # Errors
    /// Reading fails; the end of the file is no error.
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

impl Read for Input {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.reader.read(buffer)
    }
}

/// Parses the numbers of a line, separated by spaces, commas or semicolons; false if one is not a number.
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
