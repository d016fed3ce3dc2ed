//! Reads lines of bounded length, so that a file without line ends does not fill the memory.

use std::io::{self, BufRead, Read};

/// Result of reading a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// End of the input; nothing was read.
    End,
    /// A complete line, or the text after the last line end.
    Whole,
    /// The start of a line longer than the limit; its rest has not been read.
    TooLong,
}

/// Reads at most `limit` bytes of the next line into `line`, without its line end (LF, or CR LF).
///
/// # Errors
/// Errors of the input.
pub fn read_line<R: BufRead + ?Sized>(reader: &mut R, limit: usize, line: &mut Vec<u8>) -> io::Result<Line> {
    line.clear();
    // One more byte distinguishes a line of exactly `limit` bytes from a longer one.
    let most = (limit as u64).saturating_add(1);
    if reader.take(most).read_until(b'\n', line)? == 0 {
        return Ok(Line::End);
    }
    if line.last() == Some(&b'\n') {
        line.pop();
    } else if line.len() > limit {
        line.truncate(limit);
        return Ok(Line::TooLong);
    }
    while line.last() == Some(&b'\r') {
        line.pop();
    }
    Ok(Line::Whole)
}

/// Skips everything up to and including the next line end.
///
/// # Errors
/// Errors of the input.
pub fn skip_line<R: BufRead + ?Sized>(reader: &mut R) -> io::Result<()> {
    loop {
        let buffer = match reader.fill_buf() {
            Ok(buffer) => buffer,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        let (used, done) = match buffer.iter().position(|byte| *byte == b'\n') {
            Some(index) => (index + 1, true),
            None => (buffer.len(), buffer.is_empty()),
        };
        reader.consume(used);
        if done {
            return Ok(());
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn all_line_endings_are_recognised() {
        let mut input: &[u8] = b"one\r\ntwo\n\nfour";
        let mut line = Vec::new();
        let mut found = Vec::new();
        while read_line(&mut input, 4, &mut line).unwrap() == Line::Whole {
            found.push(String::from_utf8(line.clone()).unwrap());
        }
        assert_eq!(found, ["one", "two", "", "four"]);
    }

    #[test]
    fn a_line_without_end_takes_no_more_than_the_limit() {
        let mut input = io::BufReader::new(io::repeat(0));
        let mut line = Vec::new();
        assert_eq!(read_line(&mut input, 1000, &mut line).unwrap(), Line::TooLong);
        assert!(line.len() == 1000 && line.capacity() <= 4096);
        let mut input: &[u8] = b"longer than ten bytes\nnext";
        assert_eq!(read_line(&mut input, 10, &mut line).unwrap(), Line::TooLong);
        skip_line(&mut input).unwrap();
        assert_eq!(read_line(&mut input, 10, &mut line).unwrap(), Line::Whole);
        assert_eq!(line, b"next");
        skip_line(&mut input).unwrap();
    }
}
