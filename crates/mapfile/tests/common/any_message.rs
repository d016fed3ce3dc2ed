//! Any message of the schema, encoded from its description, without the code that is tested.

use std::collections::BTreeMap;

use portolan_numeric::SplitMix64;
use portolan_pbstream::proto::DESCRIPTORS;
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorSet};

/// Deeper than this messages are empty.
const MAX_DEPTH: u32 = 6;

/// All messages of the schema by their full names.
pub struct Schema {
    messages: BTreeMap<String, DescriptorProto>,
}

/// A source of anything.
pub struct RandomBytes(SplitMix64);

impl RandomBytes {
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    fn next(&mut self) -> u64 {
        self.0.bits()
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
}

impl Schema {
    pub fn load() -> Self {
        let mut messages = BTreeMap::new();
        for file in FileDescriptorSet::decode(DESCRIPTORS).unwrap().file {
            for message in file.message_type.clone() {
                collect(file.package(), message, &mut messages);
            }
        }
        Self { messages }
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.messages.keys().map(String::as_str)
    }

    /// The bytes of a message with some of its fields, in the order and form in which encoders write.
    pub fn any(&self, name: &str, random: &mut RandomBytes) -> Vec<u8> {
        self.any_at(name, random, 0)
    }

    fn any_at(&self, name: &str, random: &mut RandomBytes, depth: u32) -> Vec<u8> {
        let mut bytes = Vec::new();
        if depth > MAX_DEPTH {
            return bytes;
        }
        let message = &self.messages[name];
        let mut fields: Vec<&FieldDescriptorProto> = message.field.iter().collect();
        fields.sort_by_key(|f| f.number());
        // Of the fields of a oneof at most one is there.
        let chosen: Vec<u64> = message.oneof_decl.iter().map(|_| random.next()).collect();
        for field in &fields {
            if let Some(oneof) = field.oneof_index {
                let members = fields.iter().filter(|f| f.oneof_index == Some(oneof));
                let members: Vec<i32> = members.map(|f| f.number()).collect();
                if members[(chosen[oneof as usize] % members.len() as u64) as usize] != field.number() {
                    continue;
                }
            }
            if random.below(4) > 0 {
                self.field(field, random, depth, &mut bytes);
            }
        }
        bytes
    }

    fn field(&self, field: &FieldDescriptorProto, random: &mut RandomBytes, depth: u32, out: &mut Vec<u8>) {
        let number = field.number() as u32;
        let is_list = field.label() == Label::Repeated;
        match field.r#type() {
            Type::Message => {
                for _ in 0..if is_list { random.below(3) } else { 1 } {
                    let inner = self.any_at(field.type_name().trim_start_matches('.'), random, depth + 1);
                    put_bytes(out, number, &inner);
                }
            }
            Type::String | Type::Bytes => {
                let text: String =
                    (0..=random.below(5)).map(|_| ['a', 'ß', '\0', '9'][random.below(4) as usize]).collect();
                put_bytes(out, number, text.as_bytes());
            }
            scalar if is_list => {
                let mut packed = Vec::new();
                (0..=random.below(5)).for_each(|_| put_scalar(&mut packed, scalar, random));
                put_bytes(out, number, &packed);
            }
            scalar => {
                let mut value = Vec::new();
                put_scalar(&mut value, scalar, random);
                // Zero is written by leaving the field out.
                if value.iter().any(|b| *b != 0) {
                    put_varint(out, u64::from(number << 3 | wire_type(scalar)));
                    out.extend(value);
                }
            }
        }
    }
}

fn collect(scope: &str, message: DescriptorProto, into: &mut BTreeMap<String, DescriptorProto>) {
    let name = format!("{scope}.{}", message.name());
    message.nested_type.iter().for_each(|nested| collect(&name, nested.clone(), into));
    into.insert(name, message);
}

fn wire_type(scalar: Type) -> u32 {
    match scalar {
        Type::Double => 1,
        Type::Float => 5,
        _ => 0,
    }
}

fn put_scalar(out: &mut Vec<u8>, scalar: Type, random: &mut RandomBytes) {
    let any = random.next() >> random.below(64);
    match scalar {
        // Any bits but those of minus zero, which encoders take for zero.
        Type::Double => out.extend((any & !(1 << 63)).to_le_bytes()),
        Type::Float => out.extend((any as u32 & !(1 << 31)).to_le_bytes()),
        Type::Bool => out.push(any as u8 & 1),
        Type::Uint32 | Type::Sint32 => put_varint(out, u64::from(any as u32)),
        // Negative numbers take ten bytes.
        Type::Int32 | Type::Enum => put_varint(out, i64::from(any as i32).cast_unsigned()),
        Type::Int64 | Type::Uint64 => put_varint(out, any),
        other => panic!("the generator does not know {other:?}"),
    }
}

pub fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

pub fn put_bytes(out: &mut Vec<u8>, number: u32, content: &[u8]) {
    put_varint(out, u64::from(number) << 3 | 2);
    put_varint(out, content.len() as u64);
    out.extend_from_slice(content);
}
