//! Writes primitive values in ROS 1 serialisation or little-endian CDR.

use portolan_geometry::Time;

/// Why a message cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct EncodeError(pub(crate) &'static str);

/// Appends primitives one after the other to a serialised message.
pub(crate) struct WireWriter {
    bytes: Vec<u8>,
    is_cdr: bool,
}

/// CDR's encapsulation header; alignment counts from its end.
const CDR_HEADER: [u8; 4] = [0, 1, 0, 0];

macro_rules! primitive {
    ($name:ident, $type:ty) => {
        pub(crate) fn $name(&mut self, value: $type) {
            self.align(size_of::<$type>());
            self.bytes.extend_from_slice(&value.to_le_bytes());
        }
    };
}

impl WireWriter {
    /// Starts a message in `buffer`, whose content is discarded.
    pub(crate) fn new(is_cdr: bool, mut buffer: Vec<u8>) -> Self {
        buffer.clear();
        if is_cdr {
            buffer.extend_from_slice(&CDR_HEADER);
        }
        Self { bytes: buffer, is_cdr }
    }

    /// The serialised message.
    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Whether primitives are aligned and strings end with NUL.
    pub(crate) fn is_cdr(&self) -> bool {
        self.is_cdr
    }

    primitive!(u8, u8);
    primitive!(i8, i8);
    primitive!(u16, u16);
    primitive!(u32, u32);
    primitive!(f32, f32);
    primitive!(f64, f64);

    pub(crate) fn bool(&mut self, value: bool) {
        self.u8(u8::from(value));
    }

    pub(crate) fn time(&mut self, time: Time) -> Result<(), EncodeError> {
        let (seconds, nanoseconds) = time.to_ros();
        let word =
            if self.is_cdr { i32::try_from(seconds).map(i32::cast_unsigned) } else { u32::try_from(seconds) };
        self.u32(word.map_err(|_| EncodeError("its stamp is outside what a ROS stamp can hold"))?);
        self.u32(nanoseconds);
        Ok(())
    }

    pub(crate) fn f64_array(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.f64(*value));
    }

    /// An array of exactly `N` doubles; an empty slice stands for zeros.
    pub(crate) fn f64_array_of<const N: usize>(&mut self, values: &[f64]) -> Result<(), EncodeError> {
        match values.len() {
            0 => self.f64_array(&[0.0; N]),
            length if length == N => self.f64_array(values),
            _ => return Err(EncodeError("a covariance in it has a wrong number of elements")),
        }
        Ok(())
    }

    pub(crate) fn length(&mut self, length: usize) -> Result<(), EncodeError> {
        self.u32(u32::try_from(length).map_err(|_| EncodeError("an array in it is longer than 4 GiB"))?);
        Ok(())
    }

    pub(crate) fn string(&mut self, text: &str) -> Result<(), EncodeError> {
        self.length(text.len() + usize::from(self.is_cdr))?;
        self.bytes.extend_from_slice(text.as_bytes());
        if self.is_cdr {
            self.bytes.push(0);
        }
        Ok(())
    }

    pub(crate) fn byte_sequence(&mut self, bytes: &[u8]) -> Result<(), EncodeError> {
        self.length(bytes.len())?;
        self.bytes.extend_from_slice(bytes);
        Ok(())
    }

    pub(crate) fn f32_sequence(&mut self, values: &[f32]) -> Result<(), EncodeError> {
        self.length(values.len())?;
        self.bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        Ok(())
    }

    fn align(&mut self, size: usize) {
        if self.is_cdr {
            let aligned = (self.bytes.len() - CDR_HEADER.len()).next_multiple_of(size);
            self.bytes.resize(aligned + CDR_HEADER.len(), 0);
        }
    }
}
