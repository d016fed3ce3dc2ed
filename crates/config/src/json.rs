//! Reads and writes options as JSON.

use serde_json::Value as Json;

use crate::error::ConfigError;
use crate::options::Options;
use crate::value::{Table, Value};

impl Options {
    /// Indented JSON of all options; tables that are absent are left out. Infinities are the strings
    /// `"math.huge"` and `"-math.huge"`.
    pub fn to_json(&self) -> String {
        // Values contain only string keys and finite numbers, so writing them cannot fail.
        serde_json::to_string_pretty(&self.to_value()).unwrap_or_default()
    }
}

/// A JSON object as a table.
pub(crate) fn parse(text: &str) -> Result<Table, ConfigError> {
    let json: Json =
        serde_json::from_str(text).map_err(|error| ConfigError::Json { reason: error.to_string() })?;
    match value(json) {
        Some(Value::Table(table)) => Ok(table),
        _ => Err(ConfigError::Json { reason: "the outermost value must be an object".to_owned() }),
    }
}

/// Null means no value, as nil in Lua.
fn value(json: Json) -> Option<Value> {
    Some(match json {
        Json::Null => return None,
        Json::Bool(boolean) => Value::Boolean(boolean),
        Json::Number(number) => Value::Number(number.as_f64()?),
        Json::String(text) => match text.as_str() {
            "math.huge" => Value::Number(f64::INFINITY),
            "-math.huge" => Value::Number(f64::NEG_INFINITY),
            _ => Value::Text(text),
        },
        Json::Array(items) => {
            Value::Table(Table { array: items.into_iter().filter_map(value).collect(), ..Table::default() })
        }
        Json::Object(entries) => {
            let entries = entries.into_iter().filter_map(|(key, json)| Some((key, value(json)?)));
            Value::Table(Table { entries: entries.collect(), ..Table::default() })
        }
    })
}
