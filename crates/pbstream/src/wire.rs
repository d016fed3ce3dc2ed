//! Reads and writes protobuf fields without a schema: to find the kind of a message and to print unknown
//! fields.

/// The content of one field, as encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WireValue<'a> {
    /// Wire type 0.
    Varint(u64),
    /// Wire type 1.
    Fixed64(u64),
    /// Wire type 2: text, bytes, a message or packed numbers.
    Bytes(&'a [u8]),
    /// Wire type 5.
    Fixed32(u32),
}

/// The fields of a serialised message in file order. Damaged data end the iteration with `Err`.
#[derive(Clone, Debug)]
pub struct Fields<'a> {
    rest: &'a [u8],
}

/// The bytes are not a protobuf message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a protobuf message")]
pub struct WireError;

impl<'a> Fields<'a> {
    /// The fields in `message`.
    pub fn new(message: &'a [u8]) -> Self {
        Self { rest: message }
    }

    fn field(&mut self) -> Option<(u32, WireValue<'a>)> {
        let tag = varint(&mut self.rest)?;
        let number = u32::try_from(tag >> 3).ok().filter(|n| (1..1 << 29).contains(n))?;
        let value = match tag & 7 {
            0 => WireValue::Varint(varint(&mut self.rest)?),
            1 => WireValue::Fixed64(u64::from_le_bytes(*self.chunk::<8>()?)),
            2 => {
                let length = usize::try_from(varint(&mut self.rest)?).ok()?;
                let (bytes, rest) = self.rest.split_at_checked(length)?;
                self.rest = rest;
                WireValue::Bytes(bytes)
            }
            5 => WireValue::Fixed32(u32::from_le_bytes(*self.chunk::<4>()?)),
            _ => return None,
        };
        Some((number, value))
    }

    fn chunk<const N: usize>(&mut self) -> Option<&'a [u8; N]> {
        let (chunk, rest) = self.rest.split_first_chunk::<N>()?;
        self.rest = rest;
        Some(chunk)
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<(u32, WireValue<'a>), WireError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let field = self.field();
        if field.is_none() {
            self.rest = &[];
        }
        Some(field.ok_or(WireError))
    }
}

/// All content of the length-delimited fields with one number, concatenated: protobuf merges repeated
/// occurrences of a message by joining their bytes.
pub fn joined(message: &[u8], number: u32) -> Vec<u8> {
    let mut joined = Vec::new();
    for (found, value) in Fields::new(message).map_while(Result::ok) {
        if let (true, WireValue::Bytes(bytes)) = (found == number, value) {
            joined.extend_from_slice(bytes);
        }
    }
    joined
}

/// The last variable-length number of a field; zero if there is none, as in protobuf.
pub fn last_varint(message: &[u8], number: u32) -> u64 {
    let fields = Fields::new(message).map_while(Result::ok);
    let values = fields.filter_map(|(found, value)| match value {
        WireValue::Varint(v) if found == number => Some(v),
        _ => None,
    });
    values.last().unwrap_or(0)
}

/// The message without the fields with one number; the rest is copied byte for byte.
pub fn without_field(message: &[u8], number: u32) -> Vec<u8> {
    let mut kept = Vec::with_capacity(message.len());
    let mut fields = Fields::new(message);
    loop {
        let before = fields.rest;
        let Some(Ok((found, _))) = fields.next() else { return kept };
        if found != number {
            let length = before.len() - fields.rest.len();
            kept.extend_from_slice(before.get(..length).unwrap_or_default());
        }
    }
}

/// Appends a variable-length number.
pub fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Appends a field with a variable-length number; zero is encoded by omitting the field.
pub fn put_varint_field(out: &mut Vec<u8>, number: u32, value: u64) {
    if value != 0 {
        put_varint(out, u64::from(number) << 3);
        put_varint(out, value);
    }
}

/// Appends a length-delimited field.
pub fn put_bytes_field(out: &mut Vec<u8>, number: u32, content: &[u8]) {
    put_varint(out, u64::from(number) << 3 | 2);
    put_varint(out, content.len() as u64);
    out.extend_from_slice(content);
}

/// Takes one variable-length number from the front of `bytes`.
pub fn varint(bytes: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = bytes.split_first()?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reads_every_wire_type() {
        let bytes = [8, 0xac, 2, 0x12, 1, b'x', 0x1d, 1, 0, 0, 0, 0x21, 2, 0, 0, 0, 0, 0, 0, 0];
        let fields: Result<Vec<_>, _> = Fields::new(&bytes).collect();
        assert_eq!(
            fields.unwrap(),
            [
                (1, WireValue::Varint(300)),
                (2, WireValue::Bytes(b"x")),
                (3, WireValue::Fixed32(1)),
                (4, WireValue::Fixed64(2))
            ]
        );
        assert_eq!(Fields::new(&[0x12, 5, 1]).collect::<Vec<_>>(), [Err(WireError)]);
    }

    #[test]
    fn fields_are_taken_out_and_put_in() {
        let mut message = Vec::new();
        put_varint_field(&mut message, 1, 300);
        put_bytes_field(&mut message, 2, b"ab");
        put_varint_field(&mut message, 1, 5);
        put_varint_field(&mut message, 1, 0);
        put_bytes_field(&mut message, 2, b"cd");
        assert_eq!(joined(&message, 2), b"abcd");
        assert_eq!((last_varint(&message, 1), last_varint(&message, 7)), (5, 0));
        let rest = without_field(&message, 1);
        assert_eq!(rest, [0x12, 2, b'a', b'b', 0x12, 2, b'c', b'd']);
        assert_eq!(without_field(&rest, 9), rest);
    }

    proptest! {
        #[test]
        fn any_bytes_terminate(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(Fields::new(&bytes).count() <= bytes.len());
        }
    }
}
