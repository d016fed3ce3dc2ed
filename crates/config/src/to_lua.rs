//! Writes options as a Lua file.

use std::fmt::Write;

use crate::lua::lua_literal;
use crate::node::{Mark, NodeRef, Section};
use crate::options::Options;

impl Options {
    /// A complete Lua configuration that needs no other file and loads back to equal options. The table
    /// `portolan`, which other programs refuse, is written only if a file without it would be read to
    /// different options.
    pub fn to_lua(&self) -> String {
        let mut text = String::from("options = {\n");
        let keep_portolan = self.portolan != Options::of_files().portolan;
        write_section(self, 1, &|key| key != "portolan" || keep_portolan, &mut text);
        text.push_str("}\n\nreturn options\n");
        text
    }
}

fn write_section(section: &dyn Section, depth: usize, keep: &dyn Fn(&str) -> bool, text: &mut String) {
    let indentation = "  ".repeat(depth);
    for (index, spec) in section.specs().iter().enumerate().filter(|(_, spec)| keep(spec.key)) {
        let nested = match section.field(index) {
            Some(NodeRef::Leaf(leaf)) => {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{indentation}{} = {},", spec.key, lua_literal(&leaf.to_value()));
                continue;
            }
            Some(NodeRef::Section(nested)) if spec.mark == Mark::Flattened => {
                write_section(nested, depth, keep, text);
                continue;
            }
            Some(NodeRef::Section(nested)) => Some(nested),
            Some(NodeRef::Optional(optional)) => optional.present(),
            None => None,
        };
        if let Some(nested) = nested {
            let _ = writeln!(text, "{indentation}{} = {{", spec.key);
            write_section(nested, depth + 1, keep, text);
            let _ = writeln!(text, "{indentation}}},");
        }
    }
}
