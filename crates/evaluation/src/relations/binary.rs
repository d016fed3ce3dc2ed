//! Relations as a protobuf message `cartographer.ground_truth.proto.GroundTruth` (`spec/formats.md` §5).

use std::io::Write;

use portolan_geometry::{Quaternion, Rigid3, Time, nalgebra as na, pose_from_xyz_quaternion};

use super::Relation;
use crate::EvaluationError;

/// A relation as stored in the file; absent fields are zero.
#[derive(Clone, Copy, Default)]
struct RawRelation {
    timestamp1: i64,
    timestamp2: i64,
    translation: [f64; 3],
    rotation_xyzw: [f64; 4],
    covered_distance: f64,
}

impl RawRelation {
    /// Keeps a quaternion of unit length to the last bit, so that reading and writing a file does not change
    /// it. A quaternion that is slightly off is normalised.
    fn pose(&self) -> Option<Rigid3> {
        let mut pose = pose_from_xyz_quaternion(self.translation, self.rotation_xyzw)?;
        let [x, y, z, w] = self.rotation_xyzw;
        let stored = na::Quaternion::new(w, x, y, z);
        if (stored.norm() - 1.0).abs() < 1e-9 {
            pose.rotation = Quaternion::new_unchecked(stored);
        }
        Some(pose)
    }
}

/// Reads relations from the bytes of a file. Unknown fields are skipped.
///
/// # Errors
/// If the bytes are damaged, or of another format.
pub fn read_binary_relations(bytes: &[u8]) -> Result<Vec<Relation>, EvaluationError> {
    let mut relations = Vec::new();
    let mut message = Message { bytes, position: 0, offset: 0 };
    while let Some(field) = message.next_field()? {
        if let (1, Value::Bytes(inner)) = field {
            let position = inner.offset;
            let raw = parse_relation(inner)?;
            let expected_1_from_2 =
                raw.pose().ok_or_else(|| bad(position, "the expected transform is not a pose"))?;
            relations.push(Relation {
                time1: Time::from_ticks(raw.timestamp1),
                time2: Time::from_ticks(raw.timestamp2),
                expected_1_from_2,
                covered_distance: raw.covered_distance,
            });
        }
    }
    Ok(relations)
}

fn parse_relation(mut message: Message) -> Result<RawRelation, EvaluationError> {
    let mut raw = RawRelation::default();
    while let Some(field) = message.next_field()? {
        match field {
            (1, Value::Integer(v)) => raw.timestamp1 = v as i64,
            (2, Value::Integer(v)) => raw.timestamp2 = v as i64,
            (3, Value::Bytes(mut pose)) => {
                while let Some(part) = pose.next_field()? {
                    match part {
                        (1, Value::Bytes(vector)) => parse_doubles(vector, &mut raw.translation)?,
                        (2, Value::Bytes(vector)) => parse_doubles(vector, &mut raw.rotation_xyzw)?,
                        _ => {}
                    }
                }
            }
            (4, Value::Double(v)) => raw.covered_distance = v,
            _ => {}
        }
    }
    Ok(raw)
}

/// Fields 1, 2, … of type double.
fn parse_doubles(mut message: Message, values: &mut [f64]) -> Result<(), EvaluationError> {
    while let Some((number, value)) = message.next_field()? {
        if let (Some(slot), Value::Double(v)) = (values.get_mut((number as usize).wrapping_sub(1)), value) {
            *slot = v;
        }
    }
    Ok(())
}

fn bad(position: usize, reason: &'static str) -> EvaluationError {
    EvaluationError::BadRelations { position, reason }
}

/// A protobuf message being read.
struct Message<'a> {
    bytes: &'a [u8],
    position: usize,
    /// Where the message begins in the file.
    offset: usize,
}

enum Value<'a> {
    Integer(u64),
    Double(f64),
    Bytes(Message<'a>),
    /// A 32-bit value, of which these messages have none.
    Skipped,
}

impl<'a> Message<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], EvaluationError> {
        let rest = self.bytes.get(self.position..).unwrap_or_default();
        let taken =
            rest.get(..count).ok_or_else(|| bad(self.offset + self.position, "the data end too early"))?;
        self.position += count;
        Ok(taken)
    }

    fn varint(&mut self) -> Result<u64, EvaluationError> {
        let mut value = 0;
        for shift in (0..70).step_by(7) {
            let byte = *self.take(1)?.first().unwrap_or(&0);
            value |= u64::from(byte & 0x7f).checked_shl(shift).unwrap_or(0);
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(bad(self.offset + self.position, "a number does not end"))
    }

    fn next_field(&mut self) -> Result<Option<(u64, Value<'a>)>, EvaluationError> {
        if self.position >= self.bytes.len() {
            return Ok(None);
        }
        let start = self.offset + self.position;
        let tag = self.varint()?;
        let value = match tag & 7 {
            0 => Value::Integer(self.varint()?),
            1 => {
                let bytes = self.take(8)?;
                Value::Double(f64::from_le_bytes(bytes.try_into().unwrap_or_default()))
            }
            2 => {
                let too_long = |_| bad(start, "a length is too large");
                let length = usize::try_from(self.varint()?).map_err(too_long)?;
                let offset = self.offset + self.position;
                Value::Bytes(Message { bytes: self.take(length)?, position: 0, offset })
            }
            5 => {
                self.take(4)?;
                Value::Skipped
            }
            _ => return Err(bad(start, "not a protobuf message")),
        };
        Ok(Some((tag >> 3, value)))
    }
}

/// Writes relations as Cartographer does, byte for byte.
///
/// # Errors
/// If writing fails.
pub fn write_binary_relations(relations: &[Relation], mut writer: impl Write) -> std::io::Result<()> {
    for relation in relations {
        let mut message = Vec::new();
        put_integer(&mut message, 1, relation.time1.ticks());
        put_integer(&mut message, 2, relation.time2.ticks());
        put_bytes(&mut message, 3, &encode_pose(&relation.expected_1_from_2));
        put_double(&mut message, 4, relation.covered_distance);
        let mut field = Vec::with_capacity(message.len() + 4);
        put_bytes(&mut field, 1, &message);
        writer.write_all(&field)?;
    }
    Ok(())
}

fn encode_pose(pose: &Rigid3) -> Vec<u8> {
    let t = pose.translation;
    let q = pose.rotation;
    let (mut translation, mut rotation, mut message) = (Vec::new(), Vec::new(), Vec::new());
    for (number, value) in (1..).zip([t.x, t.y, t.z]) {
        put_double(&mut translation, number, value);
    }
    for (number, value) in (1..).zip([q.i, q.j, q.k, q.w]) {
        put_double(&mut rotation, number, value);
    }
    put_bytes(&mut message, 1, &translation);
    put_bytes(&mut message, 2, &rotation);
    message
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Writes an integer field. Zero is the default and is not written.
fn put_integer(out: &mut Vec<u8>, number: u64, value: i64) {
    if value != 0 {
        put_varint(out, number << 3);
        put_varint(out, value as u64);
    }
}

/// Writes a floating-point field. Zero is the default and is not written, but minus zero is.
fn put_double(out: &mut Vec<u8>, number: u64, value: f64) {
    if value.to_bits() != 0 {
        put_varint(out, number << 3 | 1);
        out.extend(value.to_le_bytes());
    }
}

fn put_bytes(out: &mut Vec<u8>, number: u64, bytes: &[u8]) {
    put_varint(out, number << 3 | 2);
    put_varint(out, bytes.len() as u64);
    out.extend(bytes);
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector3;
    use proptest::prelude::*;

    fn examples() -> Vec<Relation> {
        let relation = |k: i64| Relation {
            time1: Time::from_ticks(k * 635_000_000_000_000),
            time2: Time::from_ticks(-k),
            expected_1_from_2: Rigid3::new(Vector3::new(k as f64, 0.0, -0.0), Vector3::z() * 0.1 * k as f64),
            covered_distance: 12.5 * k as f64,
        };
        (0..4).map(relation).collect()
    }

    fn encoded() -> Vec<u8> {
        let mut bytes = Vec::new();
        write_binary_relations(&examples(), &mut bytes).unwrap();
        bytes
    }

    #[test]
    fn round_trip() {
        assert_eq!(read_binary_relations(&encoded()).unwrap(), examples());
        assert!(read_binary_relations(&[]).unwrap().is_empty());
    }

    #[test]
    fn unknown_fields_are_skipped() {
        let mut bytes = vec![0x7d, 1, 2, 3, 4, 0x50, 5]; // field 15 of 4 bytes, field 10 of one
        bytes.extend(encoded());
        assert_eq!(read_binary_relations(&bytes).unwrap().len(), 4);
    }

    #[test]
    fn damage_is_named() {
        let bytes = encoded();
        let error = read_binary_relations(&bytes[..bytes.len() - 1]).unwrap_err();
        assert!(error.to_string().contains("too early"));
        let error = read_binary_relations(&[0x0a, 0x00]).unwrap_err();
        assert!(error.to_string().contains("not a pose"));
        assert!(read_binary_relations(&[0xff; 20]).is_err() && read_binary_relations(&[0x0b]).is_err());
    }

    proptest! {
        #[test]
        fn flips_and_cuts_never_panic(index in 0usize..300, bit in 0..8u32, length in 0usize..400) {
            let mut bytes = encoded();
            let index = index % bytes.len();
            bytes[index] ^= 1 << bit;
            bytes.truncate(length);
            let _ = read_binary_relations(&bytes);
        }
    }
}
