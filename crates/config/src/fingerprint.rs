//! Hash of a whole configuration.

use crate::options::Options;

/// FNV-1a offset basis and prime of 128 bits.
const OFFSET: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;
const PRIME: u128 = 0x0000_0000_0100_0000_0000_0000_0000_013b;

impl Options {
    /// 32 hexadecimal digits that depend on all values and nothing else (FNV-1a, 128 bits, of the lines
    /// `path = value`). They are the same on every machine. A version of the program with more options gives other
    /// digits.
    pub fn fingerprint(&self) -> String {
        fingerprint_of(self.entries().into_iter().map(|entry| format!("{entry}\n")))
    }
}

/// 32 hexadecimal digits that depend on all bytes of the concatenated texts and nothing else (FNV-1a, 128
/// bits).
pub fn fingerprint_of(texts: impl IntoIterator<Item = String>) -> String {
    let bytes = texts.into_iter().flat_map(String::into_bytes);
    let hash = bytes.fold(OFFSET, |hash, byte| (hash ^ u128::from(byte)).wrapping_mul(PRIME));
    format!("{hash:032x}")
}
