//! How long does unpacking a chunk of a bag take, here and in the `bzip2` crate?
//!
//! `cargo bench -p portolan-bunzip2 -- [packed file]…`; without files a made-up chunk of 8 MB.

#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

use std::io::{Read, Write};
use std::time::Instant;

use portolan_bunzip2::Unpacker;

const CHUNK_BYTES: u32 = 8 << 20;
const RUNS: u32 = 5;

/// Points with a smooth coordinate, noise, counters and zeros, as bags of lidars have them.
fn made_up_chunk() -> Vec<u8> {
    let mut state = 1u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 20
    };
    let point = |i: u32| {
        let metres = (i as f32 * 0.01).sin() * 20.0 + noise() as f32 * 1e-4;
        [metres.to_le_bytes(), (i / 16).to_le_bytes(), [0; 4], [(i % 16) as u8, 0, 7, 7]].concat()
    };
    let chunk: Vec<u8> = (0..CHUNK_BYTES / 16).flat_map(point).collect();
    let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
    encoder.write_all(&chunk).unwrap();
    encoder.finish().unwrap()
}

/// Shortest of some runs, nanoseconds a byte; `unpack` returns how many bytes came out.
fn nanoseconds_per_byte(mut unpack: impl FnMut() -> usize) -> f64 {
    let run = |_| {
        let start = Instant::now();
        let bytes = unpack();
        1e9 * start.elapsed().as_secs_f64() / bytes as f64
    };
    (0..RUNS).map(run).fold(f64::INFINITY, f64::min)
}

fn report(name: &str, packed: &[u8]) {
    let (mut unpacker, mut data) = (Unpacker::default(), Vec::new());
    let ours = nanoseconds_per_byte(|| {
        data.clear();
        unpacker.unpack(packed, usize::MAX, &mut data).unwrap();
        data.len()
    });
    let theirs = nanoseconds_per_byte(|| {
        data.clear();
        bzip2::bufread::MultiBzDecoder::new(packed).read_to_end(&mut data).unwrap()
    });
    println!("{name}: {ours:.1} ns a byte, bzip2 crate {theirs:.1}");
}

fn main() {
    let files: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    for file in &files {
        report(file, &std::fs::read(file).unwrap());
    }
    if files.is_empty() {
        report("made-up chunk", &made_up_chunk());
    }
}
