use std::io::{Read, Write};

use bzip2::Compression;
use bzip2::bufread::MultiBzDecoder;
use bzip2::write::BzEncoder;
use proptest::prelude::*;

use super::*;

fn pack(data: &[u8], level: u32) -> Vec<u8> {
    let mut encoder = BzEncoder::new(Vec::new(), Compression::new(level));
    encoder.write_all(data).unwrap();
    encoder.finish().unwrap()
}

fn unpack(packed: &[u8]) -> (Vec<u8>, Result<()>) {
    let mut data = Vec::new();
    let result = Unpacker::default().unpack(packed, usize::MAX, &mut data);
    (data, result)
}

/// Data like those of recordings: counters, smooth values, noise, zeros.
fn like_a_recording(bytes: usize) -> Vec<u8> {
    let mut state = 1u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 20
    };
    let point = |i: u32| {
        let metres = (i as f32 * 0.01).sin() * 20.0 + noise() as f32 * 1e-4;
        [metres.to_le_bytes(), (i / 16).to_le_bytes(), [0; 4], [(i % 16) as u8, 0, 7, 7]].concat()
    };
    let mut data: Vec<u8> = (0..bytes as u32 / 16 + 1).flat_map(point).collect();
    data.truncate(bytes);
    data
}

#[test]
fn texts_of_all_lengths_and_kinds_round_trip() {
    let mut unpacker = Unpacker::default();
    let lengths = (0..40).chain([255, 256, 257, 1023, 1024, 1025, 9000, 99_990, 250_000]);
    for length in lengths {
        let texts = [
            vec![0; length],
            b"ab".iter().copied().cycle().take(length).collect(),
            (0..length).map(|i| (i % 251) as u8).collect(),
            like_a_recording(length),
        ];
        for text in texts {
            let mut data = Vec::new();
            unpacker.unpack(&pack(&text, 1), usize::MAX, &mut data).unwrap();
            assert!(data == text, "{length}");
        }
    }
}

#[test]
fn largest_blocks_and_concatenated_streams_round_trip() {
    let text = like_a_recording(2_000_000);
    let streams = [pack(&text, 9), pack(&[], 9), pack(&text[..70_000], 5)].concat();
    let (data, result) = unpack(&streams);
    result.unwrap();
    assert!(data == [&text, &text[..70_000]].concat());
}

#[test]
fn the_limit_is_kept() {
    let packed = pack(&[7; 1_000_000], 9);
    let mut data = Vec::new();
    assert!(Unpacker::default().unpack(&packed, 999_999, &mut data).is_err());
    assert_eq!(data.len(), 999_999);
    data.clear();
    Unpacker::default().unpack(&packed, 1_000_000, &mut data).unwrap();
}

#[test]
fn other_or_truncated_data_is_an_error() {
    let text = like_a_recording(300_000);
    let packed = pack(&text, 1);
    for cut in (0..60).chain([1000, packed.len() / 2, packed.len() - 1]) {
        let (data, result) = unpack(&packed[..cut]);
        assert!(result.is_err(), "{cut}");
        assert!(text.starts_with(&data), "{cut}");
    }
    assert!(unpack(b"no bzip2 at all").1.is_err());
    let trailing = [packed.as_slice(), b"what is this?"].concat();
    assert!(unpack(&trailing).1.is_err());
    assert!(unpack(&trailing).0 == text);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// For any change of bits, the library and our code agree whether the data are valid, and on the data.
    #[test]
    fn damage_is_seen_as_the_library_sees_it(
        at in 0usize..20_000, turned in 0u8..8, length in 1usize..20_000,
    ) {
        let mut packed = pack(&like_a_recording(length), 1);
        let at = at % packed.len();
        packed[at] ^= 1 << turned;
        let (data, result) = unpack(&packed);
        if result.as_ref().err().is_some_and(|error| error.kind() == ErrorKind::Unsupported) {
            return Ok(());
        }
        let mut expected = Vec::new();
        let sound = MultiBzDecoder::new(packed.as_slice()).read_to_end(&mut expected).is_ok();
        prop_assert_eq!(result.is_ok(), sound);
        if sound {
            prop_assert_eq!(data, expected);
        }
    }

    #[test]
    fn random_bytes_are_at_most_an_error(noise in prop::collection::vec(any::<u8>(), 0..600)) {
        let packed = [b"BZh9\x31\x41\x59\x26\x53\x59".as_slice(), &noise].concat();
        prop_assert!(unpack(&packed).1.is_err());
    }

    #[test]
    fn output_does_not_depend_on_earlier_data(
        at in 0usize..20_000, turned in 0u8..8, length in 1usize..20_000,
    ) {
        let mut packed = pack(&like_a_recording(length), 1);
        let at = at % packed.len();
        packed[at] ^= 1 << turned;
        let (mut unpacker, mut data) = (Unpacker::default(), Vec::new());
        unpacker.unpack(&pack(&like_a_recording(30_000), 9), usize::MAX, &mut Vec::new()).unwrap();
        let result = unpacker.unpack(&packed, usize::MAX, &mut data);
        let (expected, sound) = unpack(&packed);
        prop_assert_eq!(result.is_ok(), sound.is_ok());
        prop_assert!(data == expected);
    }
}
