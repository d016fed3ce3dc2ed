//! Expands the runs in the text of a block: after four equal bytes comes the number of further repetitions.

use std::io::Result;

use crate::damaged;

/// Number of bytes whose checksum is computed at once.
const PART: usize = 4096;

/// Appends `text` with expanded runs to `into`, which may grow to `limit` bytes, and returns the checksum of
/// the appended bytes.
///
/// # Errors
/// If the limit is too small; everything that fits was appended.
pub(crate) fn expand(text: &[u8], limit: usize, into: &mut Vec<u8>) -> Result<u32> {
    let begin = into.len();
    let mut rest = text;
    while !rest.is_empty() {
        let (plain, behind) = rest.split_at_checked(plain_length(rest)).unwrap_or((rest, &[]));
        into.extend_from_slice(plain);
        rest = behind;
        if let (Some((&more, behind)), Some(&byte)) = (rest.split_first(), into.last()) {
            into.resize(into.len() + usize::from(more), byte);
            rest = behind;
        }
        if into.len() > limit {
            into.truncate(limit);
            return Err(damaged("more data than announced"));
        }
    }
    Ok(checksum(into.get(begin..).unwrap_or_default()))
}

/// Length of the part that ends with the first four equal bytes, or of the whole text.
fn plain_length(text: &[u8]) -> usize {
    let mut at = 0;
    while let Some(&[a, b, c, d]) = text.get(at..at + 4) {
        // Four equal bytes that begin here or at one of the next two positions contain the third and the
        // fourth byte.
        if c != d {
            at += 3;
        } else if a == b && b == c {
            return at + 4;
        } else {
            at += 1;
        }
    }
    text.len()
}

/// CRC-32 with the polynomial 0x04C11DB7, most significant bit first. The common CRC-32 starts with the least
/// significant bit; it is the same with all bits reversed.
fn checksum(data: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    let mut reversed = [0u8; PART];
    for part in data.chunks(PART) {
        for (to, from) in reversed.iter_mut().zip(part) {
            *to = from.reverse_bits();
        }
        hasher.update(reversed.get(..part.len()).unwrap_or_default());
    }
    hasher.finalize().reverse_bits()
}
