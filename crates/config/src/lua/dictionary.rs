//! Reads a table key by key, with Cartographer's conversion rules and its check that every key is used.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use super::dump::dump;
use crate::error::ConfigError;
use crate::value::{Table, Value};

/// A table that counts how often each of its string keys was read.
///
/// For tables whose keys depend on their contents, such as the stages of a pipeline. Every key must be read
/// exactly once. [`Dictionary::finish`] of the outermost dictionary reports the keys that were not, in all
/// dictionaries that were taken from it. [`Dictionary::has_key`] does not count as reading.
#[derive(Clone, Debug)]
pub struct Dictionary(Rc<Inner>);

#[derive(Debug)]
struct Inner {
    path: String,
    table: Table,
    reads: BTreeMap<String, Cell<u32>>,
    children: RefCell<Vec<Dictionary>>,
}

impl Dictionary {
    /// Creates a dictionary of a table, for instance of [`Evaluation::table`](super::Evaluation).
    pub fn new(table: Table) -> Self {
        Self::at(String::new(), table)
    }

    fn at(path: String, table: Table) -> Self {
        let reads = table.entries.keys().map(|key| (key.clone(), Cell::new(0))).collect();
        Self(Rc::new(Inner { path, table, reads, children: RefCell::default() }))
    }

    /// The string keys, ascending.
    pub fn keys(&self) -> Vec<String> {
        self.0.table.entries.keys().cloned().collect()
    }

    /// Whether there is such a string key; does not count as reading it.
    pub fn has_key(&self, key: &str) -> bool {
        self.0.table.entries.contains_key(key)
    }

    /// A string, or a number as text.
    pub fn string(&self, key: &str) -> Result<String, ConfigError> {
        self.read(key, "string", Value::as_text)
    }

    /// A number, or a string that is one.
    pub fn number(&self, key: &str) -> Result<f64, ConfigError> {
        self.read(key, "number", Value::as_number)
    }

    /// A number truncated towards zero.
    pub fn integer(&self, key: &str) -> Result<i32, ConfigError> {
        self.read(key, "integer", Value::as_integer)
    }

    /// A number truncated towards zero that must not be negative.
    pub fn non_negative_integer(&self, key: &str) -> Result<usize, ConfigError> {
        let value = self.integer(key)?;
        usize::try_from(value).map_err(|_| ConfigError::Negative { key: self.path_of(key), value })
    }

    /// A boolean; other types are not converted.
    pub fn boolean(&self, key: &str) -> Result<bool, ConfigError> {
        self.read(key, "boolean", Value::as_bool)
    }

    /// A nested dictionary, which is checked together with this one.
    pub fn dictionary(&self, key: &str) -> Result<Dictionary, ConfigError> {
        let table = self.read(key, "table", |value| value.as_table().cloned())?;
        Ok(self.adopt(self.path_of(key), table))
    }

    /// The array part as strings.
    pub fn array_of_strings(&self) -> Result<Vec<String>, ConfigError> {
        self.array("string", Value::as_text)
    }

    /// The array part as numbers.
    pub fn array_of_numbers(&self) -> Result<Vec<f64>, ConfigError> {
        self.array("number", Value::as_number)
    }

    /// The array part as dictionaries, which are checked together with this one.
    pub fn array_of_dictionaries(&self) -> Result<Vec<Dictionary>, ConfigError> {
        let tables = self.array("table", |value| value.as_table().cloned())?;
        let adopt =
            |(index, table): (usize, Table)| self.adopt(self.path_of(&(index + 1).to_string()), table);
        Ok(tables.into_iter().enumerate().map(adopt).collect())
    }

    /// Returns an error for every key, here and in the dictionaries taken from here, that was not read
    /// exactly once.
    pub fn finish(&self) -> Result<(), ConfigError> {
        let mut errors = Vec::new();
        self.collect_wrong_use(&mut errors);
        ConfigError::combine(errors)
    }

    fn collect_wrong_use(&self, errors: &mut Vec<ConfigError>) {
        for (key, reads) in &self.0.reads {
            if reads.get() != 1 {
                errors.push(ConfigError::WrongUse { key: self.path_of(key), times: reads.get() });
            }
        }
        for child in self.0.children.borrow().iter() {
            child.collect_wrong_use(errors);
        }
    }

    fn adopt(&self, path: String, table: Table) -> Dictionary {
        let child = Self::at(path, table);
        self.0.children.borrow_mut().push(child.clone());
        child
    }

    fn path_of(&self, key: &str) -> String {
        if self.0.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.0.path) }
    }

    fn read<T>(
        &self,
        key: &str,
        expected: &str,
        convert: impl Fn(&Value) -> Option<T>,
    ) -> Result<T, ConfigError> {
        let value =
            self.0.table.entries.get(key).ok_or_else(|| ConfigError::MissingKey {
                key: key.to_owned(),
                dictionary: self.to_string(),
            })?;
        if let Some(reads) = self.0.reads.get(key) {
            reads.set(reads.get().saturating_add(1));
        }
        convert(value).ok_or_else(|| self.wrong_type(key, expected, value))
    }

    fn array<T>(&self, expected: &str, convert: impl Fn(&Value) -> Option<T>) -> Result<Vec<T>, ConfigError> {
        let each = |(index, value): (usize, &Value)| {
            convert(value).ok_or_else(|| self.wrong_type(&(index + 1).to_string(), expected, value))
        };
        self.0.table.array.iter().enumerate().map(each).collect()
    }

    fn wrong_type(&self, key: &str, expected: &str, value: &Value) -> ConfigError {
        ConfigError::WrongType {
            path: self.path_of(key),
            expected: expected.to_owned(),
            found: value.type_name().to_owned(),
            place: None,
        }
    }
}

impl std::fmt::Display for Dictionary {
    /// Writes the text form of Cartographer.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&dump(&self.0.table))
    }
}
