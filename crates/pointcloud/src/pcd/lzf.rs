//! LZF, the compression of PCD: runs of literals, and copies of up to 264 bytes from at most 8 KiB back.

use std::io::{self, Read};

/// Maximum distance of copies, bytes.
const WINDOW: usize = 1 << 13;
const LONGEST_COPY: usize = 264;
const HASH_BITS: u32 = 14;

/// Compresses a block and appends it to `out`; blocks may follow each other.
pub(super) fn compress(block: &[u8], out: &mut Vec<u8>) {
    let mut table = vec![usize::MAX; 1 << HASH_BITS];
    let (mut at, mut literals) = (0, 0);
    while let Some((three, rest)) = block.get(at..).and_then(<[u8]>::split_first_chunk::<3>) {
        let [a, b, c] = three.map(u32::from);
        let word = a << 16 | b << 8 | c;
        let slot = table.get_mut((word.wrapping_mul(0x9E37_79B1) >> (32 - HASH_BITS)) as usize);
        let candidate = slot.map_or(usize::MAX, |slot| std::mem::replace(slot, at));
        let earlier = block.get(candidate..).and_then(<[u8]>::split_first_chunk::<3>);
        let Some((_, before)) = earlier.filter(|(earlier, _)| *earlier == three && at - candidate <= WINDOW)
        else {
            at += 1;
            continue;
        };
        push_literals(block.get(literals..at).unwrap_or_default(), out);
        let alike = rest.iter().zip(before).take(LONGEST_COPY - 3).take_while(|(a, b)| a == b);
        let length = 3 + alike.count();
        let (back, coded) = (at - candidate - 1, length - 2);
        if coded < 7 {
            out.push((coded << 5) as u8 | (back >> 8) as u8);
        } else {
            out.push((7 << 5) | (back >> 8) as u8);
            out.push((coded - 7) as u8);
        }
        out.push(back as u8);
        at += length;
        literals = at;
    }
    push_literals(block.get(literals..).unwrap_or_default(), out);
}

fn push_literals(bytes: &[u8], out: &mut Vec<u8>) {
    for run in bytes.chunks(32) {
        out.push((run.len() - 1) as u8);
        out.extend_from_slice(run);
    }
}

/// Decompresses a stream in pieces, in bounded memory.
pub(super) struct Decompressor<R> {
    input: R,
    /// Ring buffer of the last bytes of output.
    window: Vec<u8>,
    at: usize,
    written: u64,
}

impl<R: Read> Decompressor<R> {
    pub fn new(input: R) -> Self {
        Self { input, window: vec![0; WINDOW], at: 0, written: 0 }
    }

    /// Appends at least one byte to `out`; false at the end of the input.
    ///
    /// # Errors
    /// Reading fails, the input ends within a step, or a copy starts before the first byte.
    pub fn next_into(&mut self, out: &mut Vec<u8>) -> io::Result<bool> {
        let Some(control) = self.byte_or_end()? else { return Ok(false) };
        if control < 32 {
            for _ in 0..=control {
                let byte = self.byte()?;
                self.push(byte, out);
            }
            return Ok(true);
        }
        let mut length = usize::from(control >> 5);
        if length == 7 {
            length += usize::from(self.byte()?);
        }
        let back = (usize::from(control & 31) << 8) + usize::from(self.byte()?) + 1;
        if back as u64 > self.written {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a copy reaches before the start"));
        }
        for _ in 0..length + 2 {
            let from = (self.at + WINDOW - back) % WINDOW;
            let byte = self.window.get(from).copied().unwrap_or(0);
            self.push(byte, out);
        }
        Ok(true)
    }

    fn push(&mut self, byte: u8, out: &mut Vec<u8>) {
        if let Some(slot) = self.window.get_mut(self.at) {
            *slot = byte;
        }
        self.at = (self.at + 1) % WINDOW;
        self.written += 1;
        out.push(byte);
    }

    fn byte(&mut self) -> io::Result<u8> {
        self.byte_or_end()?.ok_or_else(|| io::ErrorKind::UnexpectedEof.into())
    }

    fn byte_or_end(&mut self) -> io::Result<Option<u8>> {
        let mut byte = [0];
        loop {
            match self.input.read(&mut byte) {
                Ok(0) => return Ok(None),
                Ok(_) => return Ok(byte.first().copied()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn decompressed(bytes: &[u8]) -> io::Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut decompressor = Decompressor::new(bytes);
        while decompressor.next_into(&mut out)? {}
        Ok(out)
    }

    proptest! {
        #[test]
        fn compression_round_trips(seed in prop::collection::vec(any::<u8>(), 1..80), length in 0..30_000_usize, noise in 0..5_u32) {
            let bytes: Vec<u8> = (0..length).map(|i| seed[i % seed.len()].wrapping_add(((i as u32 / 97) * noise) as u8)).collect();
            let mut packed = Vec::new();
            bytes.chunks(9000).for_each(|block| compress(block, &mut packed));
            prop_assert_eq!(decompressed(&packed).unwrap(), bytes);
        }

        #[test]
        fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            let _ = decompressed(&bytes);
        }
    }

    #[test]
    fn repetition_shrinks() {
        let mut packed = Vec::new();
        compress(&[7; 100_000], &mut packed);
        assert!(packed.len() < 1200);
        assert!(decompressed(&[0x20, 0x05]).is_err());
    }
}
