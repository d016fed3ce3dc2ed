//! Mutations that damage files.

use std::io::{Read, Write};
use std::ops::Range;

use super::random::Random;
use super::records::{Layout, Records, number};

/// Text values that often break readers of numbers.
const WORDS: [&str; 14] = [
    "nan",
    "inf",
    "-0",
    "1e308",
    "-1e308",
    "1e-320",
    "0",
    "-1",
    "2147483648",
    "18446744073709551616",
    "",
    "x",
    "\u{fffd}",
    "{",
];
/// Lengths that often break readers.
const LENGTHS: [u64; 10] =
    [0, 1, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x7fff_ffff_ffff_ffff, u64::MAX];

/// Damaged copy of a sound file, with one to four mutations.
pub fn damaged(sound: &[u8], layout: Layout, random: &mut Random) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for _ in 0..=random.below(4) {
        let records = Records::of(&bytes, layout);
        match layout {
            Layout::Pbstream if random.once_in(2) => in_message(&mut bytes, &records, random),
            Layout::Lines | Layout::Tokens if random.once_in(2) => replace_word(&mut bytes, random),
            _ if random.once_in(3) => any_bytes(&mut bytes, random),
            _ => whole_records(&mut bytes, &records, random),
        }
    }
    if layout == Layout::E57 && !random.once_in(4) {
        put_checksums_right(&mut bytes);
    }
    bytes
}

/// Damage without knowledge of the format: truncated, overwritten, removed or flipped bytes.
fn any_bytes(bytes: &mut Vec<u8>, random: &mut Random) {
    let at = random.below(bytes.len());
    let bits = random.below(13);
    let length = 1 + random.below(1 << bits);
    let range = at..(at + length).min(bytes.len());
    match random.below(6) {
        0 => bytes.truncate(at),
        1 => bytes[range].fill(0),
        2 => bytes[range].fill(0xff),
        3 => drop(bytes.drain(range)),
        4 => range.for_each(|i| bytes[i] = random.next() as u8),
        _ => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
    }
}

/// Damage of whole records: removed, duplicated, copied elsewhere, zeroed, or cut in the middle; or a changed length.
fn whole_records(bytes: &mut Vec<u8>, records: &Records, random: &mut Random) {
    if !records.lengths.is_empty() && random.once_in(2) {
        let field = random.choose(&records.lengths).clone();
        if let Some(field) = bytes.get_mut(field) {
            let value = match random.below(3) {
                0 => number(field, 0, field.len()).unwrap_or(0) as u64 ^ (1 << random.below(8 * field.len())),
                _ => *random.choose(&LENGTHS),
            };
            let size = field.len();
            field.copy_from_slice(&value.to_le_bytes()[..size]);
        }
        return;
    }
    if records.records.is_empty() {
        return any_bytes(bytes, random);
    }
    let record: Range<usize> = random.choose(&records.records).clone();
    let copy = bytes[record.clone()].to_vec();
    match random.below(6) {
        0 => drop(bytes.drain(record)),
        1 => drop(bytes.splice(record.start..record.start, copy)),
        2 => {
            // Up to 200 copies of the record, at most 1 MiB.
            let times = (1 + random.below(200)).min((1 << 20) / copy.len().max(1));
            drop(bytes.splice(record.start..record.start, copy.repeat(times)));
        }
        3 => bytes[record].fill(0),
        4 => bytes.truncate(record.start + random.below(record.len())),
        _ => {
            let other = random.choose(&records.records).start;
            drop(bytes.splice(other..other, copy));
        }
    }
}

/// Replaces a word or number of a text, sometimes by a very long one.
fn replace_word(bytes: &mut Vec<u8>, random: &mut Random) {
    let is_blank = |byte: &u8| b" ,\t\n:[]{}=".contains(byte);
    let at = random.below(bytes.len());
    let start = bytes[..at].iter().rposition(is_blank).map_or(0, |i| i + 1);
    let end = bytes[at..].iter().position(is_blank).map_or(bytes.len(), |i| at + i);
    let word = match random.below(20) {
        0 => "7".repeat(200_000),
        1 => "[".repeat(50_000),
        _ => (*random.choose(&WORDS)).to_owned(),
    };
    drop(bytes.splice(start..end.max(start), word.bytes()));
}

/// Decompresses a protobuf message of a map, damages it and compresses it again, so that readers get past gzip.
fn in_message(bytes: &mut Vec<u8>, records: &Records, random: &mut Random) {
    let Some(record) = records.records.get(random.below(records.records.len())).cloned() else { return };
    let mut message = Vec::new();
    let packed = bytes.get(record.start + 8..record.end).unwrap_or_default();
    if flate2::read::GzDecoder::new(packed).take(1 << 24).read_to_end(&mut message).is_err() {
        return;
    }
    for _ in 0..=random.below(3) {
        let fields = protobuf_fields(&message);
        if fields.is_empty() || random.once_in(4) {
            any_bytes(&mut message, random);
            continue;
        }
        let field = random.choose(&fields).clone();
        let copy = message[field.clone()].to_vec();
        match random.below(4) {
            0 => drop(message.drain(field)),
            1 => drop(message.splice(field.start..field.start, copy)),
            2 => message[field].iter_mut().skip(1).for_each(|byte| *byte = random.next() as u8),
            _ => drop(message.splice(field.start..field.start, random.choose(&LENGTHS).to_le_bytes())),
        }
    }
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packer.write_all(&message).unwrap();
    let packed = packer.finish().unwrap();
    let mut whole = (packed.len() as u64).to_le_bytes().to_vec();
    whole.extend(packed);
    drop(bytes.splice(record, whole));
}

/// Byte ranges of the fields of a message and, for fields that may be messages, of the fields in them.
fn protobuf_fields(message: &[u8]) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let whole = 0..message.len();
    let mut todo = Vec::from([whole]);
    while let Some(range) = todo.pop() {
        let mut at = range.start;
        while at < range.end && found.len() < 5000 {
            let start = at;
            let Some((tag, next)) = varint(message, at) else { break };
            let end = match tag & 7 {
                0 => varint(message, next).map(|(_, end)| end),
                1 => Some(next + 8),
                2 => varint(message, next).and_then(|(length, content)| {
                    let end = content.checked_add(usize::try_from(length).ok()?)?;
                    todo.push(content..end.min(range.end));
                    Some(end)
                }),
                5 => Some(next + 4),
                _ => None,
            };
            let Some(end) = end.filter(|end| *end <= range.end) else { break };
            found.push(start..end);
            at = end;
        }
    }
    found
}

fn varint(bytes: &[u8], at: usize) -> Option<(u64, usize)> {
    let mut value = 0;
    for (i, byte) in bytes.get(at..)?.iter().take(10).enumerate() {
        value |= u64::from(byte & 0x7f).checked_shl(7 * i as u32)?;
        if byte & 0x80 == 0 {
            return Some((value, at + i + 1));
        }
    }
    None
}

/// Recomputes the checksums of E57 pages, so that readers do not detect the damage by them.
fn put_checksums_right(bytes: &mut Vec<u8>) {
    bytes.truncate(bytes.len() / 1024 * 1024);
    for page in bytes.chunks_exact_mut(1024) {
        let step = |crc: u32| if crc & 1 == 1 { (crc >> 1) ^ 0x82f6_3b78 } else { crc >> 1 };
        let add = |crc, byte: &u8| (0..8).fold(crc ^ u32::from(*byte), |crc, _| step(crc));
        let crc = !page[..1020].iter().fold(u32::MAX, add);
        page[1020..].copy_from_slice(&crc.to_be_bytes());
    }
}
