//! Prints messages as protobuf text, as other programs do (`tools.md §1.1`).
//!
//! It works on the bytes with the names of the schema, so that fields unknown here are printed, too.

use std::collections::HashMap;
use std::fmt::{self, Write};
use std::sync::LazyLock;

use prost::Message as _;
use prost_types::field_descriptor_proto::Type;
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet};

use portolan_numeric::format_general;

use crate::message::RawMessage;
use crate::proto::DESCRIPTORS;
use crate::proto::mapping::PoseGraph;
use crate::wire::{Fields, WireValue, varint};

/// Maximum nesting of messages in unknown data that is followed.
const MAX_DEPTH: usize = 32;

/// `cartographer.mapping.proto.` and the name of the message.
const MAPPING: &str = ".cartographer.mapping.proto.";

#[derive(Default)]
struct Schema {
    messages: HashMap<String, HashMap<u32, Field>>,
    enums: HashMap<String, HashMap<i32, String>>,
}

struct Field {
    name: String,
    kind: Type,
    /// Type name of fields that are messages or enums.
    type_name: String,
}

static SCHEMA: LazyLock<Schema> = LazyLock::new(|| {
    let mut schema = Schema::default();
    // The bytes come from our own build; if they were damaged, fields would be printed by number.
    let files = FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default();
    for file in &files.file {
        let scope = format!(".{}", file.package());
        file.message_type.iter().for_each(|m| schema.add_message(&scope, m));
        file.enum_type.iter().for_each(|e| schema.add_enum(&scope, e));
    }
    schema
});

impl Schema {
    fn add_message(&mut self, scope: &str, message: &DescriptorProto) {
        let name = format!("{scope}.{}", message.name());
        message.nested_type.iter().for_each(|m| self.add_message(&name, m));
        message.enum_type.iter().for_each(|e| self.add_enum(&name, e));
        let fields = message.field.iter().map(|f| {
            let field =
                Field { name: f.name().to_owned(), kind: f.r#type(), type_name: f.type_name().to_owned() };
            (f.number().cast_unsigned(), field)
        });
        self.messages.insert(name, fields.collect());
    }

    fn add_enum(&mut self, scope: &str, values: &EnumDescriptorProto) {
        let names = values.value.iter().map(|v| (v.number(), v.name().to_owned()));
        self.enums.insert(format!("{scope}.{}", values.name()), names.collect());
    }
}

/// A serialised message as text, one field per line. `message_type` is the full name, for example
/// `cartographer.mapping.proto.PoseGraph`; fields that are not in the schema are printed by number.
pub fn message_to_text(bytes: &[u8], message_type: &str) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = print_message(bytes, Some(&format!(".{message_type}")), 0, &mut text);
    text
}

/// A pose graph as text.
pub fn pose_graph_to_text(pose_graph: &PoseGraph) -> String {
    mapping_to_text(pose_graph, "PoseGraph")
}

/// A message of the package `cartographer.mapping.proto` as text.
pub fn mapping_to_text(message: &impl prost::Message, name: &str) -> String {
    let mut text = String::new();
    let _ = print_message(&message.encode_to_vec(), Some(&format!("{MAPPING}{name}")), 0, &mut text);
    text
}

impl RawMessage {
    /// The message as protobuf text; see [`message_to_text`].
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        let _ = self.write_text(&mut text);
        text
    }

    /// Writes the message as protobuf text piece by piece, because the text of a grid can be ten times as
    /// long as the grid.
    ///
    /// # Errors
    /// The errors of the writer.
    pub fn write_text(&self, text: &mut dyn Write) -> fmt::Result {
        let name = if self.index == 0 { "SerializationHeader" } else { "SerializedData" };
        print_message(&self.bytes, Some(&format!("{MAPPING}{name}")), 0, text)
    }
}

fn print_message(
    bytes: &[u8],
    message_type: Option<&str>,
    depth: usize,
    text: &mut dyn Write,
) -> fmt::Result {
    let known = message_type.and_then(|t| SCHEMA.messages.get(t));
    let mut fields: Vec<(u32, WireValue)> = Fields::new(bytes).map_while(Result::ok).collect();
    // Sorted by number, with unknown fields last.
    fields.sort_by_key(|(number, _)| (!known.is_some_and(|k| k.contains_key(number)), *number));
    for (number, value) in fields {
        match known.and_then(|k| k.get(&number)) {
            Some(field) => print_field(field, value, depth, text)?,
            None => print_unknown(number, value, depth, text)?,
        }
    }
    Ok(())
}

fn print_field(field: &Field, value: WireValue, depth: usize, text: &mut dyn Write) -> fmt::Result {
    match (field.kind, value) {
        (Type::Message, WireValue::Bytes(bytes)) => {
            print_block(&field.name, bytes, Some(&field.type_name), depth, text)
        }
        (Type::String | Type::Bytes, WireValue::Bytes(bytes)) => {
            line(depth, &field.name, &quoted(bytes), text)
        }
        (_, WireValue::Bytes(packed)) => print_packed(field, packed, depth, text),
        (_, value) => line(depth, &field.name, &scalar(field, value), text),
    }
}

fn print_packed(field: &Field, mut packed: &[u8], depth: usize, text: &mut dyn Write) -> fmt::Result {
    while !packed.is_empty() {
        let value = match field.kind {
            Type::Double | Type::Fixed64 | Type::Sfixed64 => {
                packed.split_first_chunk::<8>().map(|(v, rest)| {
                    packed = rest;
                    WireValue::Fixed64(u64::from_le_bytes(*v))
                })
            }
            Type::Float | Type::Fixed32 | Type::Sfixed32 => {
                packed.split_first_chunk::<4>().map(|(v, rest)| {
                    packed = rest;
                    WireValue::Fixed32(u32::from_le_bytes(*v))
                })
            }
            _ => varint(&mut packed).map(WireValue::Varint),
        };
        let Some(value) = value else { return Ok(()) };
        line(depth, &field.name, &scalar(field, value), text)?;
    }
    Ok(())
}

fn scalar(field: &Field, value: WireValue) -> String {
    match (field.kind, value) {
        (Type::Double, WireValue::Fixed64(bits)) => double(f64::from_bits(bits)),
        (Type::Float, WireValue::Fixed32(bits)) => float(f32::from_bits(bits)),
        (Type::Bool, WireValue::Varint(v)) => (v != 0).to_string(),
        (Type::Uint32, WireValue::Varint(v)) => (v as u32).to_string(),
        (Type::Uint64, WireValue::Varint(v)) => v.to_string(),
        (Type::Int32, WireValue::Varint(v)) => (v as i32).to_string(),
        (Type::Sint32 | Type::Sint64, WireValue::Varint(v)) => {
            ((v >> 1) as i64 ^ -((v & 1) as i64)).to_string()
        }
        (Type::Enum, WireValue::Varint(v)) => {
            let name = SCHEMA.enums.get(&field.type_name).and_then(|e| e.get(&(v as i32)));
            name.map_or_else(|| (v as i32).to_string(), String::clone)
        }
        (_, WireValue::Varint(v)) => v.cast_signed().to_string(),
        (_, value) => raw(value),
    }
}

fn raw(value: WireValue) -> String {
    match value {
        WireValue::Varint(v) => v.to_string(),
        WireValue::Fixed64(v) => format!("0x{v:016x}"),
        WireValue::Fixed32(v) => format!("0x{v:08x}"),
        WireValue::Bytes(bytes) => quoted(bytes),
    }
}

fn print_unknown(number: u32, value: WireValue, depth: usize, text: &mut dyn Write) -> fmt::Result {
    let name = number.to_string();
    match value {
        WireValue::Bytes(bytes)
            if !bytes.is_empty() && depth < MAX_DEPTH && Fields::new(bytes).all(|f| f.is_ok()) =>
        {
            print_block(&name, bytes, None, depth, text)
        }
        value => line(depth, &name, &raw(value), text),
    }
}

fn print_block(
    name: &str,
    bytes: &[u8],
    message_type: Option<&str>,
    depth: usize,
    text: &mut dyn Write,
) -> fmt::Result {
    let indent = 2 * depth;
    writeln!(text, "{:indent$}{name} {{", "")?;
    print_message(bytes, message_type, depth + 1, text)?;
    writeln!(text, "{:indent$}}}", "")
}

fn line(depth: usize, name: &str, value: &str, text: &mut dyn Write) -> fmt::Result {
    let indent = 2 * depth;
    writeln!(text, "{:indent$}{name}: {value}", "")
}

/// Formats with fifteen digits, or with seventeen if fifteen do not give the same number back.
fn double(value: f64) -> String {
    let short = format_general(value, 15);
    if value.is_nan() || short.parse() == Ok(value) { short } else { format_general(value, 17) }
}

fn float(value: f32) -> String {
    let short = format_general(f64::from(value), 6);
    if value.is_nan() || short.parse() == Ok(value) { short } else { format_general(f64::from(value), 9) }
}

fn quoted(bytes: &[u8]) -> String {
    let mut text = String::from("\"");
    for byte in bytes {
        match byte {
            b'\n' => text.push_str("\\n"),
            b'\r' => text.push_str("\\r"),
            b'\t' => text.push_str("\\t"),
            b'"' => text.push_str("\\\""),
            b'\'' => text.push_str("\\'"),
            b'\\' => text.push_str("\\\\"),
            0x20..=0x7e => text.push(char::from(*byte)),
            other => {
                let _ = write!(text, "\\{other:03o}");
            }
        }
    }
    text.push('"');
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::proto::mapping;
    use crate::proto::transform::Rigid3d;

    #[test]
    fn prints_names_numbers_and_blocks() {
        let data = mapping::serialized_data::Data::PoseGraph(mapping::PoseGraph {
            constraint: vec![mapping::pose_graph::Constraint {
                tag: 1,
                translation_weight: 0.1,
                relative_pose: Some(Rigid3d::default()),
                ..mapping::pose_graph::Constraint::default()
            }],
            ..mapping::PoseGraph::default()
        });
        let mut bytes = mapping::SerializedData { data: Some(data) }.encode_to_vec();
        bytes.extend_from_slice(&[0xa2, 6, 2, 8, 1, 0xaa, 6, 2, 0xff, b'"']);
        let text = RawMessage { index: 1, offset: 0, bytes }.to_text();
        assert_eq!(
            text,
            "pose_graph {\n  constraint {\n    relative_pose {\n    }\n    tag: INTER_SUBMAP\n    \
             translation_weight: 0.1\n  }\n}\n100 {\n  1: 1\n}\n101: \"\\377\\\"\"\n"
        );
    }

    #[test]
    fn prints_packed_numbers_one_by_one() {
        let grid = mapping::HybridGrid {
            resolution: 0.1,
            x_indices: vec![-1, 64],
            values: vec![-7],
            ..mapping::HybridGrid::default()
        };
        assert_eq!(
            mapping_to_text(&grid, "HybridGrid"),
            "resolution: 0.1\nx_indices: -1\nx_indices: 64\nvalues: -7\n"
        );
        assert_eq!([double(1.0 / 3.0), float(1.0 / 3.0)], ["0.33333333333333331", "0.333333343"]);
    }
}
