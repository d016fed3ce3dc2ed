//! Values of a configuration, independent of the Lua interpreter.

use std::collections::BTreeMap;

use serde::ser::{Serialize, SerializeMap, SerializeSeq, Serializer};

/// A value of a Lua table or of a JSON document.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `true` or `false`.
    Boolean(bool),
    /// A number; all numbers of Lua 5.2 are doubles.
    Number(f64),
    /// A string.
    Text(String),
    /// A table.
    Table(Table),
    /// A value that is not data: the name of its Lua type.
    Other(&'static str),
}

/// A Lua table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Values of the keys 1, 2, … up to the first nil.
    pub array: Vec<Value>,
    /// Values of the string keys, ascending by bytes.
    pub entries: BTreeMap<String, Value>,
}

impl Value {
    /// Name of the type in Lua.
    pub fn type_name(&self) -> &'static str {
        match self {
            Self::Boolean(_) => "boolean",
            Self::Number(_) => "number",
            Self::Text(_) => "string",
            Self::Table(_) => "table",
            Self::Other(name) => name,
        }
    }

    /// A boolean; other types are not converted.
    pub fn as_bool(&self) -> Option<bool> {
        match self {
            Self::Boolean(value) => Some(*value),
            _ => None,
        }
    }

    /// A number or a string that Lua would convert to one.
    pub fn as_number(&self) -> Option<f64> {
        match self {
            Self::Number(value) => Some(*value),
            Self::Text(text) => parse_lua_number(text),
            _ => None,
        }
    }

    /// A number truncated towards zero, if it fits into 32 bits.
    pub fn as_integer(&self) -> Option<i32> {
        let number = self.as_number()?.trunc();
        (number >= f64::from(i32::MIN) && number <= f64::from(i32::MAX)).then_some(number as i32)
    }

    /// A string, or a number as Lua writes it.
    pub fn as_text(&self) -> Option<String> {
        match self {
            Self::Text(text) => Some(text.clone()),
            Self::Number(number) => Some(format_lua_number(*number)),
            _ => None,
        }
    }

    /// A table.
    pub fn as_table(&self) -> Option<&Table> {
        match self {
            Self::Table(table) => Some(table),
            _ => None,
        }
    }
}

/// A number written as a string, converted as Lua 5.2 does: decimal or hexadecimal, spaces around it
/// ignored, no `inf` or `nan`.
pub fn parse_lua_number(text: &str) -> Option<f64> {
    let trimmed = text.trim_matches([' ', '\t', '\n', '\r', '\x0b', '\x0c']);
    let (negative, digits) = match trimmed.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, trimmed.strip_prefix('+').unwrap_or(trimmed)),
    };
    let magnitude = match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        Some(hex) => f64::from(u32::from_str_radix(hex, 16).ok()?),
        None if digits.starts_with(|first: char| first.is_ascii_digit() || first == '.') => {
            digits.parse().ok()?
        }
        None => return None,
    };
    Some(if negative { -magnitude } else { magnitude })
}

/// A number as Lua 5.2's `tostring` writes it, `%.14g`.
pub fn format_lua_number(number: f64) -> String {
    if number.is_nan() {
        return if number.is_sign_negative() { "-nan" } else { "nan" }.to_owned();
    }
    if number.is_infinite() {
        return if number < 0.0 { "-inf" } else { "inf" }.to_owned();
    }
    let scientific = format!("{number:.13e}");
    let Some((mantissa, exponent)) = scientific.split_once('e') else { return scientific };
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if (-4..14).contains(&exponent) {
        let decimals = usize::try_from(13 - exponent).unwrap_or(0);
        return without_trailing_zeros(&format!("{number:.decimals$}"));
    }
    let sign = if exponent < 0 { '-' } else { '+' };
    format!("{}e{sign}{:02}", without_trailing_zeros(mantissa), exponent.abs())
}

fn without_trailing_zeros(digits: &str) -> String {
    if !digits.contains('.') {
        return digits.to_owned();
    }
    digits.trim_end_matches('0').trim_end_matches('.').to_owned()
}

impl Serialize for Value {
    /// Numbers without fraction are written as integers, infinities as the strings `"math.huge"` and
    /// `"-math.huge"` (JSON has no infinity).
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Boolean(value) => serializer.serialize_bool(*value),
            Self::Number(number) if number.is_infinite() => {
                serializer.serialize_str(if *number > 0.0 { "math.huge" } else { "-math.huge" })
            }
            Self::Number(number) if number.fract() == 0.0 && number.abs() < 1e15 => {
                serializer.serialize_i64(*number as i64)
            }
            Self::Number(number) => serializer.serialize_f64(*number),
            Self::Text(text) => serializer.serialize_str(text),
            Self::Table(table) => table.serialize(serializer),
            Self::Other(name) => serializer.serialize_str(name),
        }
    }
}

impl Serialize for Table {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.entries.is_empty() && !self.array.is_empty() {
            let mut sequence = serializer.serialize_seq(Some(self.array.len()))?;
            for value in &self.array {
                sequence.serialize_element(value)?;
            }
            return sequence.end();
        }
        let mut map = serializer.serialize_map(Some(self.entries.len() + self.array.len()))?;
        for (index, value) in self.array.iter().enumerate() {
            map.serialize_entry(&(index + 1).to_string(), value)?;
        }
        for (key, value) in &self.entries {
            map.serialize_entry(key, value)?;
        }
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_lua_writes_them() {
        for (number, text) in [
            (10.0, "10"),
            (0.1, "0.1"),
            (-2.5, "-2.5"),
            (1e15, "1e+15"),
            (1e14, "1e+14"),
            (99_999_999_999_999.0, "99999999999999"),
            (1e-5, "1e-05"),
            (0.0001, "0.0001"),
            (1.0 / 3.0, "0.33333333333333"),
            (0.0, "0"),
        ] {
            assert_eq!(format_lua_number(number), text);
        }
    }

    #[test]
    fn strings_convert_to_numbers_as_in_lua() {
        assert_eq!(parse_lua_number(" 40. "), Some(40.0));
        assert_eq!(parse_lua_number("-0x10"), Some(-16.0));
        assert_eq!(parse_lua_number("1e-3"), Some(1e-3));
        for text in ["", "inf", "nan", "a", "1 2", "0x", "--1"] {
            assert_eq!(parse_lua_number(text), None, "{text}");
        }
    }

    #[test]
    fn integers_are_truncated_and_must_fit() {
        assert_eq!(Value::Number(40.9).as_integer(), Some(40));
        assert_eq!(Value::Number(-1.5).as_integer(), Some(-1));
        assert_eq!(Value::Number(1e12).as_integer(), None);
        assert_eq!(Value::Number(f64::NAN).as_integer(), None);
    }
}
