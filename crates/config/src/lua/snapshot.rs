//! Copies a Lua table out of the interpreter.

use mlua::Value as LuaValue;

use crate::error::ConfigError;
use crate::value::{Table, Value};

/// Maximum nesting of tables; also ends the copy of a table that contains itself.
const MAX_DEPTH: usize = 64;
/// Maximum number of values in all tables together, counted as often as they are reached.
const MAX_VALUES: usize = 1_000_000;

/// Maximum size of all strings and keys together, bytes, counted as often as they are reached.
const MAX_TEXT: usize = 64 << 20;

/// Copies tables without calling metamethods.
pub(super) struct Snapshot<'a> {
    file: &'a str,
    path: Vec<String>,
    values: usize,
    text: usize,
}

impl<'a> Snapshot<'a> {
    /// For the table returned by a file.
    pub fn new(file: &'a str) -> Self {
        Self { file, path: Vec::new(), values: 0, text: 0 }
    }

    /// The array part (keys 1, 2, … up to the first nil) and the string keys; other keys are not data of
    /// the dialect.
    pub fn table(&mut self, table: &mlua::Table) -> Result<Table, ConfigError> {
        if self.path.len() >= MAX_DEPTH {
            return Err(
                self.unusable(format!("tables nested deeper than {MAX_DEPTH}; does one contain itself?"))
            );
        }
        let mut copy = Table::default();
        for index in 1_usize.. {
            let value: LuaValue = table.raw_get(index).map_err(|error| self.unusable(error.to_string()))?;
            if value.is_nil() {
                break;
            }
            self.path.push(index.to_string());
            copy.array.push(self.value(value)?);
            self.path.pop();
        }
        for pair in table.pairs::<LuaValue, LuaValue>() {
            let (key, value) = pair.map_err(|error| self.unusable(error.to_string()))?;
            let LuaValue::String(key) = key else { continue };
            let key = key.to_str().map_err(|_| self.unusable("a key is not UTF-8".to_owned()))?;
            self.count(&key)?;
            let key = key.to_owned();
            self.path.push(key.clone());
            let value = self.value(value)?;
            self.path.pop();
            copy.entries.insert(key, value);
        }
        Ok(copy)
    }

    fn value(&mut self, value: LuaValue) -> Result<Value, ConfigError> {
        self.values += 1;
        if self.values > MAX_VALUES {
            return Err(self.unusable(format!("more than {MAX_VALUES} values")));
        }
        Ok(match value {
            LuaValue::Boolean(boolean) => Value::Boolean(boolean),
            LuaValue::Integer(integer) => Value::Number(integer as f64),
            LuaValue::Number(number) => Value::Number(number),
            LuaValue::String(string) => match string.to_str() {
                Ok(text) => {
                    self.count(&text)?;
                    Value::Text(text.to_owned())
                }
                Err(_) => return Err(self.unusable("the string is not UTF-8".to_owned())),
            },
            LuaValue::Table(table) => Value::Table(self.table(&table)?),
            other => Value::Other(other.type_name()),
        })
    }

    fn count(&mut self, text: &str) -> Result<(), ConfigError> {
        self.text += text.len();
        if self.text > MAX_TEXT {
            return Err(self.unusable(format!("more than {} MiB of text", MAX_TEXT >> 20)));
        }
        Ok(())
    }

    fn unusable(&self, reason: String) -> ConfigError {
        let shown: Vec<_> = self.path.iter().take(8).map(String::as_str).collect();
        ConfigError::Unusable { file: self.file.to_owned(), path: shown.join("."), reason }
    }
}
