//! Columns of points, with the names and number types of various programs.

use crate::cloud::{Attributes, PointCloud};

/// Type of a number in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// One byte with a sign.
    I8,
    /// One byte.
    U8,
    /// Two bytes with a sign.
    I16,
    /// Two bytes.
    U16,
    /// Four bytes with a sign.
    I32,
    /// Four bytes.
    U32,
    /// Eight bytes with a sign.
    I64,
    /// Eight bytes.
    U64,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl Scalar {
    /// Size in bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Decodes the number from the first bytes; 0 if there are too few.
    pub fn decode(self, bytes: &[u8], is_big: bool) -> f64 {
        match self {
            Self::I8 => bytes.first().map_or(0.0, |b| f64::from(b.cast_signed())),
            Self::U8 => bytes.first().map_or(0.0, |b| f64::from(*b)),
            Self::I16 => f64::from(i16::from_le_bytes(array(bytes, is_big))),
            Self::U16 => f64::from(u16::from_le_bytes(array(bytes, is_big))),
            Self::I32 => f64::from(i32::from_le_bytes(array(bytes, is_big))),
            Self::U32 => f64::from(u32::from_le_bytes(array(bytes, is_big))),
            Self::I64 => i64::from_le_bytes(array(bytes, is_big)) as f64,
            Self::U64 => u64::from_le_bytes(array(bytes, is_big)) as f64,
            Self::F32 => f64::from(f32::from_le_bytes(array(bytes, is_big))),
            Self::F64 => f64::from_le_bytes(array(bytes, is_big)),
        }
    }
}

fn array<const N: usize>(bytes: &[u8], is_big: bool) -> [u8; N] {
    let mut value = [0; N];
    if let Some(source) = bytes.get(..N) {
        value.copy_from_slice(source);
    }
    if is_big {
        value.reverse();
    }
    value
}

/// Meaning of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    X,
    Y,
    Z,
    Intensity,
    Time,
    Red,
    Green,
    Blue,
    /// Red, green and blue in the lower three bytes.
    PackedColor,
}

impl Role {
    /// Meaning of the name of a column, as used by many programs.
    pub fn of(name: &str) -> Option<Self> {
        let name = name.to_ascii_lowercase();
        let name = name.strip_prefix("scalar_").unwrap_or(&name);
        Some(match name {
            "x" => Self::X,
            "y" => Self::Y,
            "z" => Self::Z,
            "intensity" | "i" | "reflectance" | "reflectivity" | "remission" => Self::Intensity,
            "time" | "t" | "gps_time" | "gpstime" | "timestamp" | "time_stamp" => Self::Time,
            "red" | "r" | "diffuse_red" => Self::Red,
            "green" | "g" | "diffuse_green" => Self::Green,
            "blue" | "b" | "diffuse_blue" => Self::Blue,
            "rgb" | "rgba" => Self::PackedColor,
            _ => return None,
        })
    }
}

/// Position and meaning of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Column {
    pub role: Role,
    /// Index of the column, or offset from the start of a row in bytes.
    pub at: usize,
    pub scalar: Scalar,
}

/// All columns that are used.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Columns {
    xyz: [Column; 3],
    intensity: Option<Column>,
    time: Option<Column>,
    color: Option<[Column; 3]>,
    packed: Option<Column>,
}

impl Columns {
    /// Assigns columns by their meaning; none without x, y and z.
    pub fn of(columns: &[Column]) -> Option<Self> {
        let find = |role| columns.iter().find(|column| column.role == role).copied();
        let color = || Some([find(Role::Red)?, find(Role::Green)?, find(Role::Blue)?]);
        Some(Self {
            xyz: [find(Role::X)?, find(Role::Y)?, find(Role::Z)?],
            intensity: find(Role::Intensity),
            time: find(Role::Time),
            color: color(),
            packed: find(Role::PackedColor),
        })
    }

    pub fn attributes(&self) -> Attributes {
        Attributes {
            intensity: self.intensity.is_some(),
            time: self.time.is_some(),
            color: self.color.is_some() || self.packed.is_some(),
        }
    }

    /// Adds a row with the columns from `value`; returns whether its coordinates are finite.
    pub fn push(&self, value: impl Fn(&Column) -> f64, out: &mut PointCloud) -> bool {
        let position = self.xyz.each_ref().map(&value);
        if position.iter().any(|v| !v.is_finite()) {
            return false;
        }
        let number = |column: &Option<Column>| column.as_ref().map_or(0.0, &value);
        let color = match (&self.color, &self.packed) {
            (Some(columns), _) => columns.map(|column| eight_bits(value(&column), column.scalar)),
            (None, Some(column)) => unpack(value(column), column.scalar),
            (None, None) => [0; 3],
        };
        out.push(position, number(&self.intensity) as f32, number(&self.time), color);
        true
    }
}

/// Converts a colour of 8 bits, 16 bits, or from 0 to 1 to 8 bits.
fn eight_bits(value: f64, scalar: Scalar) -> u8 {
    let scaled = match scalar {
        Scalar::U16 => value / 257.0,
        Scalar::F32 | Scalar::F64 => value * 255.0,
        _ => value,
    };
    scaled.round().clamp(0.0, 255.0) as u8
}

/// Decodes the colours of PCD, which are stored in the bits of a float, or in an integer.
fn unpack(value: f64, scalar: Scalar) -> [u8; 3] {
    let bits = match scalar {
        Scalar::F32 | Scalar::F64 => (value as f32).to_bits(),
        _ => value as i64 as u32,
    };
    [(bits >> 16) as u8, (bits >> 8) as u8, bits as u8]
}
