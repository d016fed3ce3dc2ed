//! Reads primitive values of ROS 1 serialisation and CDR.

use std::borrow::Cow;

use portolan_geometry::Time;

use crate::Encoding;

/// Why a message could not be decoded; the text completes "dropped: …".
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct DecodeError(pub(crate) &'static str);

const TOO_SHORT: DecodeError = DecodeError("it ends before its last field");

/// Reads primitives one after the other from a serialised message.
pub(crate) struct WireReader<'a> {
    /// The message without CDR's encapsulation header: alignment counts from its first byte.
    data: &'a [u8],
    position: usize,
    is_cdr: bool,
    big_endian: bool,
}

macro_rules! primitive {
    ($name:ident, $type:ty) => {
        pub(crate) fn $name(&mut self) -> Result<$type, DecodeError> {
            let bytes = self.aligned_array::<{ size_of::<$type>() }>()?;
            Ok(if self.big_endian { <$type>::from_be_bytes(bytes) } else { <$type>::from_le_bytes(bytes) })
        }
    };
}

impl<'a> WireReader<'a> {
    /// Starts at the first byte of a message; for CDR at its encapsulation header.
    pub(crate) fn new(encoding: Encoding, message: &'a [u8]) -> Result<Self, DecodeError> {
        let packed = Self { data: message, position: 0, is_cdr: false, big_endian: false };
        match encoding {
            Encoding::Ros1 => Ok(packed),
            Encoding::Unknown => Err(DecodeError("its encoding is unknown")),
            Encoding::Cdr => {
                let ([kind_high, kind_low, _, _], data) = message.split_first_chunk().ok_or(TOO_SHORT)?;
                let big_endian = match (*kind_high, *kind_low) {
                    (0, 0) => true,
                    (0, 1) => false,
                    (0, 2 | 3) => return Err(DecodeError("it is a CDR parameter list, not plain CDR")),
                    (0, 6..=11) => return Err(DecodeError("it is encoded as XCDR2, not XCDR1")),
                    _ => return Err(DecodeError("its CDR encapsulation header is unknown")),
                };
                Ok(Self { data, position: 0, is_cdr: true, big_endian })
            }
        }
    }

    /// Whether primitives are aligned and strings end with NUL.
    pub(crate) fn is_cdr(&self) -> bool {
        self.is_cdr
    }

    /// Checks that all bytes were used. CDR allows padding to a multiple of eight at the end.
    pub(crate) fn finish(&self) -> Result<(), DecodeError> {
        let left = self.data.len() - self.position;
        if left > if self.is_cdr { 7 } else { 0 } {
            return Err(DecodeError("it is longer than its type says"));
        }
        Ok(())
    }

    primitive!(u8, u8);
    primitive!(i8, i8);
    primitive!(u16, u16);
    primitive!(u32, u32);
    primitive!(u64, u64);
    primitive!(i32, i32);
    primitive!(f32, f32);
    primitive!(f64, f64);

    pub(crate) fn bool(&mut self) -> Result<bool, DecodeError> {
        Ok(self.u8()? != 0)
    }

    /// A stamp: unsigned seconds in ROS 1, signed seconds in ROS 2.
    pub(crate) fn time(&mut self) -> Result<Time, DecodeError> {
        let seconds = if self.is_cdr { i64::from(self.i32()?) } else { i64::from(self.u32()?) };
        Ok(Time::from_ros(seconds, self.u32()?))
    }

    /// A fixed-size array of doubles.
    pub(crate) fn f64_array<const N: usize>(&mut self) -> Result<[f64; N], DecodeError> {
        let mut array = [0.0; N];
        for value in &mut array {
            *value = self.f64()?;
        }
        Ok(array)
    }

    /// The length of a sequence whose elements take at least `element_bytes` each. It is an error if the
    /// elements do not fit into the rest of the message.
    pub(crate) fn sequence_length(&mut self, element_bytes: usize) -> Result<usize, DecodeError> {
        let length = self.u32()? as usize;
        if length.checked_mul(element_bytes).is_none_or(|bytes| bytes > self.data.len() - self.position) {
            return Err(DecodeError("the length of an array in it exceeds the message"));
        }
        Ok(length)
    }

    /// Text; invalid UTF-8 is replaced.
    pub(crate) fn string(&mut self) -> Result<Cow<'a, str>, DecodeError> {
        let length = self.sequence_length(1)?;
        let mut bytes = self.take(length)?;
        if self.is_cdr
            && let [text @ .., 0] = bytes
        {
            bytes = text;
        }
        Ok(String::from_utf8_lossy(bytes))
    }

    /// `count` bytes, without a length before them.
    pub(crate) fn byte_array(&mut self, count: usize) -> Result<Vec<u8>, DecodeError> {
        Ok(self.take(count)?.to_vec())
    }

    /// A sequence of bytes.
    pub(crate) fn byte_sequence(&mut self) -> Result<Vec<u8>, DecodeError> {
        let length = self.sequence_length(1)?;
        Ok(self.take(length)?.to_vec())
    }

    /// A sequence of floats.
    pub(crate) fn f32_sequence(&mut self) -> Result<Vec<f32>, DecodeError> {
        let length = self.sequence_length(4)?;
        let (floats, _) = self.take(4 * length)?.as_chunks::<4>();
        Ok(if self.big_endian {
            floats.iter().map(|bytes| f32::from_be_bytes(*bytes)).collect()
        } else {
            floats.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
        })
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        let end = self.position.checked_add(count).ok_or(TOO_SHORT)?;
        let bytes = self.data.get(self.position..end).ok_or(TOO_SHORT)?;
        self.position = end;
        Ok(bytes)
    }

    fn aligned_array<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        if self.is_cdr {
            self.position = self.position.next_multiple_of(N);
        }
        let bytes = self.data.get(self.position..).and_then(|rest| rest.first_chunk::<N>());
        let bytes = *bytes.ok_or(TOO_SHORT)?;
        self.position += N;
        Ok(bytes)
    }
}
