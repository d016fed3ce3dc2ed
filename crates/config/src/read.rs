//! Fills options from a tree of values that was read from a file.

use crate::catalogue::{join, nearest_path};
use crate::error::{ConfigError, ConfigWarning, Place};
use crate::lua::lua_literal;
use crate::nearest::nearest;
use crate::node::{Leaf, Mark, NodeMut, NodeRef, OptionSpec, Section};
use crate::value::{Table, Value};

/// Handling of keys that no option has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strictness {
    /// They are errors, as in Cartographer.
    #[default]
    Error,
    /// They are ignored with a warning.
    Warn,
}

/// Function that finds the position in the files where a key is set.
pub(crate) type Locate<'a> = &'a dyn Fn(&str) -> Option<Place>;

/// Reads tables into options and collects all errors.
pub(crate) struct Reader<'a> {
    /// The main file.
    pub file: String,
    pub strictness: Strictness,
    pub locate: Locate<'a>,
    pub errors: Vec<ConfigError>,
    pub warnings: Vec<ConfigWarning>,
}

impl Reader<'_> {
    /// Reads a table at a path. Missing keys keep their default, with a warning unless they may be left out.
    /// An optional table that is missing becomes absent.
    pub fn read(&mut self, section: &mut dyn Section, table: &Table, path: &str) {
        self.read_entries(section, table, path, true);
        self.check_keys(section, table, path);
    }

    fn read_entries(&mut self, section: &mut dyn Section, table: &Table, path: &str, complete: bool) {
        for (index, spec) in section.specs().iter().enumerate() {
            let at = join(path, spec.key);
            let value = table.entries.get(spec.key);
            let required = complete && spec.mark == Mark::Required;
            match (section.field_mut(index), value) {
                (Some(NodeMut::Section(nested)), _) if spec.mark == Mark::Flattened => {
                    self.read_entries(nested, table, path, complete);
                }
                (Some(NodeMut::Leaf(leaf)), Some(value)) => self.read_leaf(leaf, spec, value, &at),
                (Some(NodeMut::Leaf(leaf)), None) if required => {
                    self.missing(&at, lua_literal(&leaf.to_value()));
                }
                (Some(NodeMut::Section(nested)), Some(Value::Table(inner))) => {
                    self.read_entries(nested, inner, &at, complete && spec.mark != Mark::Optional);
                    self.check_keys(nested, inner, &at);
                }
                (Some(NodeMut::Section(_)), None) if required => {
                    self.missing(&at, "the defaults of the whole table".to_owned());
                }
                (Some(NodeMut::Optional(optional)), Some(Value::Table(inner))) => {
                    optional.clear();
                    let nested = optional.or_default();
                    self.read_entries(nested, inner, &at, complete);
                    self.check_keys(nested, inner, &at);
                }
                (Some(NodeMut::Optional(optional)), None) => optional.clear(),
                (Some(NodeMut::Section(_) | NodeMut::Optional(_)), Some(other)) => {
                    self.wrong_type(&at, "a table".to_owned(), other);
                }
                (Some(NodeMut::Leaf(_) | NodeMut::Section(_)) | None, None) | (None, Some(_)) => {}
            }
        }
    }

    fn read_leaf(&mut self, leaf: &mut dyn Leaf, spec: &OptionSpec, value: &Value, path: &str) {
        let number = value.as_number();
        let is_integer = leaf.type_name() == "integer";
        if !leaf.assign(value) {
            match number.filter(|_| is_integer) {
                Some(value) => self.errors.push(ConfigError::OutOfBounds {
                    path: path.to_owned(),
                    value,
                    bounds: spec.bounds,
                    place: (self.locate)(path),
                }),
                None => self.wrong_type(path, leaf.type_name(), value),
            }
            return;
        }
        if let (true, Some(value), Some(integer)) = (is_integer, number, value.as_integer())
            && value.fract() != 0.0
        {
            let place = (self.locate)(path);
            self.warnings.push(ConfigWarning::Truncated { path: path.to_owned(), value, integer, place });
        }
    }

    fn missing(&mut self, path: &str, default: String) {
        let (file, path) = (self.file.clone(), path.to_owned());
        self.warnings.push(ConfigWarning::DefaultUsed { file, path, default });
    }

    fn wrong_type(&mut self, path: &str, expected: String, value: &Value) {
        let found = match value {
            Value::Table(_) | Value::Other(_) => value.type_name().to_owned(),
            _ => format!("{} {}", value.type_name(), lua_literal(value)),
        };
        let place = (self.locate)(path);
        self.errors.push(ConfigError::WrongType { path: path.to_owned(), expected, found, place });
    }

    /// Reports keys of a table that no option has.
    fn check_keys(&mut self, section: &dyn Section, table: &Table, path: &str) {
        if !table.array.is_empty() {
            let (file, count) = (self.file.clone(), table.array.len());
            let path = if path.is_empty() { "options" } else { path }.to_owned();
            self.warnings.push(ConfigWarning::Unkeyed { file, path, count });
        }
        let known = keys_of(section);
        for key in table.entries.keys().filter(|key| !known.contains(&key.as_str())) {
            let at = join(path, key);
            // The same table first, because a misspelt key is usually in the right table.
            let near = nearest(key, known.iter().copied()).map(|near| join(path, near));
            let error = ConfigError::UnknownKey {
                nearest: near.or_else(|| nearest_path(key)),
                place: (self.locate)(&at).or_else(|| Some(Place { file: self.file.clone(), line: None })),
                path: at,
            };
            match self.strictness {
                Strictness::Error => self.errors.push(error),
                Strictness::Warn => self.warnings.push(ConfigWarning::Ignored { error }),
            }
        }
    }
}

/// The keys that the table of a section may contain.
fn keys_of(section: &dyn Section) -> Vec<&'static str> {
    let mut keys = Vec::new();
    for (index, spec) in section.specs().iter().enumerate() {
        match (spec.mark, section.field(index)) {
            (Mark::Flattened, Some(NodeRef::Section(nested))) => keys.extend(keys_of(nested)),
            _ => keys.push(spec.key),
        }
    }
    keys
}
