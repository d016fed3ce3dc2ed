//! Compression and decompression of chunks.

use std::fmt;
use std::io::{self, Read};

use portolan_bunzip2::Unpacker;

/// How a chunk is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Compression {
    None,
    Bz2,
    Lz4,
    Zstd,
}

impl Compression {
    /// From the name in the chunk (MCAP uses an empty name for no compression).
    pub(crate) fn from_name(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"" | b"none" => Self::None,
            b"bz2" => Self::Bz2,
            b"lz4" => Self::Lz4,
            b"zstd" => Self::Zstd,
            _ => return None,
        })
    }
}

impl fmt::Display for Compression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "uncompressed",
            Self::Bz2 => "bz2",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        })
    }
}

/// Maximum ratio of decompressed to compressed size. LZ4 cannot exceed 255; bzip2 and Zstandard can, but
/// messages of sensors are never that repetitive.
const MAX_RATIO: u64 = 256;
/// Decompressed size that is allowed for any compressed size, bytes; the chunks of recorders are far smaller.
const ALWAYS_ALLOWED: u64 = 64 << 20;

/// Maximum decompressed size of `packed_bytes`, whatever the file states, so that a few bytes cannot exhaust
/// the memory.
pub(crate) fn most_unpacked(packed_bytes: u64) -> u64 {
    usual_unpacked(packed_bytes).max(ALWAYS_ALLOWED)
}

/// Maximum decompressed size of sensor data with a compressed size of `packed_bytes`.
pub(crate) fn usual_unpacked(packed_bytes: u64) -> u64 {
    packed_bytes.saturating_mul(MAX_RATIO)
}

/// Decompresses chunks; reuses its memory.
#[derive(Default)]
pub(crate) struct Decompressor {
    bz2: Unpacker,
}

impl Decompressor {
    /// Decompresses at most `limit` bytes into `into`, which is replaced. After an error `into` holds the
    /// bytes that were decompressed before it.
    pub(crate) fn decompress(
        &mut self,
        compression: Compression,
        packed: &[u8],
        limit: u64,
        into: &mut Vec<u8>,
    ) -> io::Result<()> {
        into.clear();
        // The limit comes from the file and may be wrong, so it must not decide alone how much is allocated
        // at once.
        let guess = limit.min(8 * packed.len() as u64 + 4096);
        into.reserve(usize::try_from(guess).unwrap_or_default());
        let mut reader: Box<dyn Read + '_> = match compression {
            Compression::None => Box::new(packed),
            Compression::Bz2 => {
                let limit = usize::try_from(limit).unwrap_or(usize::MAX);
                match self.bz2.unpack(packed, limit, into) {
                    Err(error) if error.kind() == io::ErrorKind::Unsupported => into.clear(),
                    result => return result,
                }
                Box::new(bzip2::bufread::MultiBzDecoder::new(packed))
            }
            Compression::Lz4 => Box::new(lz4_flex::frame::FrameDecoder::new(packed)),
            Compression::Zstd => Box::new(zstd::stream::read::Decoder::with_buffer(packed)?),
        };
        let read = reader.by_ref().take(limit).read_to_end(into)?;
        // Reads one byte more, so that checksums after the last byte are verified.
        if read as u64 == limit && reader.read(&mut [0])? != 0 {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "more data than announced"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn packed(compression: Compression, data: &[u8]) -> Vec<u8> {
        match compression {
            Compression::None => data.to_vec(),
            Compression::Bz2 => {
                let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::fast());
                encoder.write_all(data).unwrap();
                encoder.finish().unwrap()
            }
            Compression::Lz4 => {
                let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
                encoder.write_all(data).unwrap();
                encoder.finish().unwrap()
            }
            Compression::Zstd => zstd::bulk::compress(data, 1).unwrap(),
        }
    }

    #[test]
    fn every_compression_round_trips_and_obeys_the_limit() {
        let data = vec![7u8; 3_000_000];
        for compression in [Compression::None, Compression::Bz2, Compression::Lz4, Compression::Zstd] {
            let packed = packed(compression, &data);
            let mut out = Vec::new();
            Decompressor::default().decompress(compression, &packed, data.len() as u64, &mut out).unwrap();
            assert_eq!(out, data, "{compression}");
            Decompressor::default().decompress(compression, &packed, u64::MAX, &mut out).unwrap();
            assert_eq!(out, data, "{compression}");
            assert!(
                Decompressor::default().decompress(compression, &packed, 1000, &mut out).is_err(),
                "{compression}"
            );
            assert_eq!(out.len(), 1000, "{compression}");
        }
    }

    #[test]
    fn data_before_damage_is_kept() {
        let data: Vec<u8> = (0..2_000_000u32).flat_map(|i| (i / 7).to_le_bytes()).collect();
        for compression in [Compression::Lz4, Compression::Zstd, Compression::Bz2] {
            let packed = packed(compression, &data);
            let mut out = Vec::new();
            let cut = &packed[..packed.len() * 3 / 4];
            assert!(
                Decompressor::default().decompress(compression, cut, data.len() as u64, &mut out).is_err(),
                "{compression}"
            );
            assert!(out.len() > 1_000_000, "{compression}: {}", out.len());
            assert!(data.starts_with(&out), "{compression}");
        }
    }
}
