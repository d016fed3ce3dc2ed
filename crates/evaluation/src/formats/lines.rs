//! Reads text files from untrusted sources line by line.

use std::io::BufRead;

use portolan_input::{Line, read_line};

use crate::EvaluationError;

/// Maximum length of a line, bytes.
const MAX_LINE: usize = 1 << 16;

/// Reads line by line, with a limit on the length of a line.
pub(crate) struct Lines<R> {
    reader: R,
    number: usize,
    buffer: Vec<u8>,
}

pub(crate) fn bad_line(line: usize, reason: impl Into<String>) -> EvaluationError {
    EvaluationError::BadLine { line, reason: reason.into() }
}

impl<R: BufRead> Lines<R> {
    pub fn new(reader: R) -> Self {
        Self { reader, number: 0, buffer: Vec::new() }
    }

    /// The next line with its number, without line ends and surrounding blanks.
    ///
    /// # Errors
    /// If reading fails, or the line is longer than 64 KiB or no text.
    pub fn next_line(&mut self) -> Result<Option<(usize, &str)>, EvaluationError> {
        self.number += 1;
        match read_line(&mut self.reader, MAX_LINE, &mut self.buffer)? {
            Line::End => return Ok(None),
            Line::TooLong => {
                return Err(bad_line(self.number, "longer than 64 KiB: this is not a file of numbers"));
            }
            Line::Whole => {}
        }
        let text = std::str::from_utf8(&self.buffer)
            .map_err(|_| bad_line(self.number, "not text: this is not a file of numbers"))?;
        Ok(Some((self.number, text.trim_start_matches('\u{feff}').trim())))
    }

    /// The next line that is neither blank nor a comment (`#` or `%` at its beginning).
    ///
    /// # Errors
    /// As for [`Self::next_line`].
    pub fn next_data(&mut self) -> Result<Option<(usize, String)>, EvaluationError> {
        while let Some((number, line)) = self.next_line()? {
            if !line.is_empty() && !line.starts_with(['#', '%']) {
                return Ok(Some((number, line.to_owned())));
            }
        }
        Ok(None)
    }
}
