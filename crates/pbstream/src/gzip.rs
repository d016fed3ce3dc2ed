//! Compresses each record to one gzip stream (RFC 1952) and decompresses it, with limits, and without
//! allocating the state of the codec for each record.

use std::cell::RefCell;
use std::io;

use flate2::{Compress, Compression, Decompress, FlushCompress, FlushDecompress, Status};

/// Deflate cannot shrink data by more than this factor.
const MAX_DEFLATE_RATIO: usize = 1032;

/// Maximum size of data that are stored without compression, bytes. Data this short (an IMU sample) hardly
/// shrink, and resetting a compressor takes far longer than everything else that is done with them.
const MOST_STORED: usize = 128;

/// The same header as other writers of pbstream files use: no name, no time, "fastest", unknown system.
const HEADER: [u8; 10] = [0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 4, 0xff];

/// Why a record could not be decompressed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GzipError {
    /// The magic bytes, the method or the flags are not those of gzip.
    #[error("the record does not start like a gzip stream")]
    NotGzip,
    /// The compressed bytes end before the stream does.
    #[error("the gzip stream is cut off")]
    Truncated,
    /// The compressed bytes are not valid deflate data.
    #[error("the compressed data are damaged")]
    Damaged,
    /// The decompressed data do not have the checksum or the length stated after them.
    #[error("checksum or length of the unpacked data is wrong: the file is damaged")]
    Checksum,
    /// The record decompresses to more than the limit.
    #[error("the record unpacks to more than the limit of {limit} bytes")]
    TooLarge {
        /// The limit in bytes.
        limit: usize,
    },
}

thread_local! {
    static INFLATE: RefCell<Decompress> = RefCell::new(Decompress::new(false));
    // Level 1 ("best speed"), as in other writers of the format.
    static DEFLATE: RefCell<Compress> = RefCell::new(Compress::new(Compression::new(1), false));
}

/// Decompresses a gzip stream of one or more members; stops with [`GzipError::TooLarge`] when the result
/// would exceed `limit` bytes. Memory never exceeds the limit, whatever size the stream states.
pub fn gunzip(mut input: &[u8], limit: usize) -> Result<Vec<u8>, GzipError> {
    let mut output = Vec::with_capacity(expected_size(input, limit));
    loop {
        let rest = skip_header(input)?;
        let start = output.len();
        let rest = inflate(rest, &mut output, limit)?;
        let (trailer, rest) = rest.split_at_checked(8).ok_or(GzipError::Truncated)?;
        let member = output.get(start..).unwrap_or_default();
        if trailer != trailer_of(member) {
            return Err(GzipError::Checksum);
        }
        if rest.is_empty() {
            return Ok(output);
        }
        input = rest;
    }
}

/// Compresses `data` to one gzip stream. The same data always give the same bytes. An error means that the
/// compressor itself is broken.
pub fn gzip(data: &[u8]) -> io::Result<Vec<u8>> {
    let mut output = Vec::new();
    gzip_into(data, &mut output)?;
    Ok(output)
}

/// [`gzip`], appended to `output`.
pub fn gzip_into(data: &[u8], output: &mut Vec<u8>) -> io::Result<()> {
    // Space for stored blocks, so that deflating almost always takes one call.
    output.reserve(data.len() / 2 + 64);
    output.extend_from_slice(&HEADER);
    match data.len() <= MOST_STORED {
        true => store(data, output),
        false => deflate(data, output)?,
    }
    output.extend_from_slice(&trailer_of(data));
    Ok(())
}

/// Writes the data as one last stored block (RFC 1951, 3.2.4).
fn store(data: &[u8], output: &mut Vec<u8>) {
    let length = data.len() as u16;
    output.push(1);
    output.extend_from_slice(&length.to_le_bytes());
    output.extend_from_slice(&(!length).to_le_bytes());
    output.extend_from_slice(data);
}

fn deflate(data: &[u8], output: &mut Vec<u8>) -> io::Result<()> {
    let before = output.len();
    DEFLATE.with_borrow_mut(|deflate| {
        deflate.reset();
        loop {
            let consumed = (deflate.total_in() as usize).min(data.len());
            match deflate.compress_vec(
                data.get(consumed..).unwrap_or_default(),
                output,
                FlushCompress::Finish,
            ) {
                Ok(Status::StreamEnd) => return Ok(()),
                Ok(Status::Ok | Status::BufError) => output.reserve((output.len() - before).max(64)),
                Err(error) => return Err(io::Error::other(error)),
            }
        }
    })
}

/// Size to reserve: the stream's own length field, limited to plausible values.
fn expected_size(input: &[u8], limit: usize) -> usize {
    let stated = input.last_chunk::<4>().map_or(0, |b| u32::from_le_bytes(*b) as usize);
    // A ratio above 64:1 is possible but rare; then the output grows as it is written.
    stated.min(input.len().saturating_mul(64)).min(limit)
}

fn trailer_of(data: &[u8]) -> [u8; 8] {
    let mut trailer = [0; 8];
    trailer[..4].copy_from_slice(&crc32fast::hash(data).to_le_bytes());
    trailer[4..].copy_from_slice(&(data.len() as u32).to_le_bytes());
    trailer
}

/// The bytes after the header of a gzip member.
fn skip_header(input: &[u8]) -> Result<&[u8], GzipError> {
    let (fixed, mut rest) = input.split_first_chunk::<10>().ok_or(GzipError::NotGzip)?;
    let [0x1f, 0x8b, 8, flags, ..] = *fixed else { return Err(GzipError::NotGzip) };
    if flags & 0b1110_0000 != 0 {
        return Err(GzipError::NotGzip);
    }
    if flags & 4 != 0 {
        let (length, after) = rest.split_first_chunk::<2>().ok_or(GzipError::Truncated)?;
        rest = after.get(usize::from(u16::from_le_bytes(*length))..).ok_or(GzipError::Truncated)?;
    }
    for zero_terminated in [8, 16] {
        if flags & zero_terminated != 0 {
            let end = rest.iter().position(|b| *b == 0).ok_or(GzipError::Truncated)?;
            rest = rest.get(end + 1..).ok_or(GzipError::Truncated)?;
        }
    }
    if flags & 2 != 0 {
        rest = rest.get(2..).ok_or(GzipError::Truncated)?;
    }
    Ok(rest)
}

/// Decompresses the deflate stream and appends it to `output`; returns the input after the stream.
fn inflate<'a>(input: &'a [u8], output: &mut Vec<u8>, limit: usize) -> Result<&'a [u8], GzipError> {
    INFLATE.with_borrow_mut(|inflate| {
        inflate.reset(false);
        loop {
            let consumed = inflate.total_in() as usize;
            let rest = input.get(consumed..).unwrap_or_default();
            let before = (consumed, output.len());
            let status = inflate
                .decompress_vec(rest, output, FlushDecompress::None)
                .map_err(|_| GzipError::Damaged)?;
            let consumed = inflate.total_in() as usize;
            if output.len() > limit {
                return Err(GzipError::TooLarge { limit });
            }
            if status == Status::StreamEnd {
                return Ok(input.get(consumed..).unwrap_or_default());
            }
            if output.len() == output.capacity() {
                grow(output, input.len(), limit)?;
            } else if before == (consumed, output.len()) || consumed == input.len() {
                return Err(GzipError::Truncated);
            }
        }
    })
}

/// Doubles the space for output, up to one byte more than the limit, so that a record of exactly the limit
/// can be distinguished from one that is too large.
fn grow(output: &mut Vec<u8>, input_length: usize, limit: usize) -> Result<(), GzipError> {
    let most = limit.min(output.len().saturating_add(input_length.saturating_mul(MAX_DEFLATE_RATIO)));
    let wanted = output.capacity().saturating_mul(2).max(4096).min(most.saturating_add(1));
    match wanted.checked_sub(output.len()) {
        Some(more) if more > 0 => output.reserve_exact(more),
        _ => return Err(GzipError::TooLarge { limit }),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bombs_stop_at_the_limit() {
        let bomb = gzip(&vec![0; 50_000_000]).unwrap();
        assert!(bomb.len() < 1_000_000);
        assert_eq!(gunzip(&bomb, 1_000_000), Err(GzipError::TooLarge { limit: 1_000_000 }));
        assert_eq!(gunzip(&bomb, 49_999_999), Err(GzipError::TooLarge { limit: 49_999_999 }));
        assert_eq!(gunzip(&bomb, 50_000_000).map(|d| d.len()), Ok(50_000_000));
    }

    #[test]
    fn optional_header_fields_are_skipped() {
        let packed = gzip(b"map").unwrap();
        let mut fancy = vec![0x1f, 0x8b, 8, 0b1_1110, 0, 0, 0, 0, 0, 3];
        fancy.extend_from_slice(&[2, 0, 7, 7]);
        fancy.extend_from_slice(b"name\0comment\0\x12\x34");
        fancy.extend_from_slice(&packed[10..]);
        assert_eq!(gunzip(&fancy, 10), Ok(b"map".to_vec()));
        let twice = [packed.clone(), fancy].concat();
        assert_eq!(gunzip(&twice, 10), Ok(b"mapmap".to_vec()));
        assert_eq!(gunzip(&[&packed[..], b"junk"].concat(), 10), Err(GzipError::NotGzip));
    }

    proptest! {
        #[test]
        fn round_trip_does_not_depend_on_earlier_data(
            a in prop::collection::vec(0u8..4, 0..3000), b in prop::collection::vec(any::<u8>(), 0..3000)
        ) {
            let fresh = std::thread::scope(|s| s.spawn(|| gzip(&b)).join()).unwrap().unwrap();
            let packed = (gzip(&a).unwrap(), gzip(&b).unwrap());
            prop_assert_eq!(&packed.1, &fresh);
            prop_assert_eq!(gunzip(&packed.0, a.len()).unwrap(), a);
            prop_assert_eq!(gunzip(&packed.1, b.len()).unwrap(), b);
        }

        #[test]
        fn damage_is_an_error(
            data in prop::collection::vec(0u8..8, 1..2000), at in any::<prop::sample::Index>(), bit in 0u8..8
        ) {
            let mut packed = gzip(&data).unwrap();
            let cut = at.index(packed.len());
            prop_assert!(gunzip(&packed[..cut], data.len()).is_err());
            packed[cut] ^= 1 << bit;
            // Bytes 4 to 9 (time, hints, system) carry no data.
            if let Ok(unpacked) = gunzip(&packed, data.len()) {
                prop_assert_eq!(unpacked, data);
            }
        }
    }
}
