//! Writes values as Lua text: Cartographer's dump byte for byte, and exact literals.

use crate::error::ConfigError;
use crate::value::{Table, Value};

/// A table in the text form of Cartographer: array values first, then string keys ascending, numbers
/// with six decimals, a comma after every entry, two spaces for each level.
pub fn dump(table: &Table) -> String {
    let mut text = String::new();
    dump_table(table, 0, &mut text);
    text
}

/// Output of `cartographer_print_configuration`: `return <dump>`, or `<path> = <dump>` of the table at a
/// dotted path. Ends with a line feed.
pub fn print_configuration(table: &Table, subdictionary: Option<&str>) -> Result<String, ConfigError> {
    let Some(path) = subdictionary.filter(|path| !path.is_empty()) else {
        return Ok(format!("return {}\n", dump(table)));
    };
    let mut at = table;
    for key in path.split('.') {
        at = match at.entries.get(key) {
            Some(Value::Table(nested)) => nested,
            Some(other) => {
                return Err(ConfigError::WrongType {
                    path: path.to_owned(),
                    expected: "table".to_owned(),
                    found: other.type_name().to_owned(),
                    place: None,
                });
            }
            None => {
                return Err(ConfigError::MissingKey { key: key.to_owned(), dictionary: dump(at) });
            }
        };
    }
    Ok(format!("{path} = {}\n", dump(at)))
}

fn dump_table(table: &Table, depth: usize, text: &mut String) {
    if table.array.is_empty() && table.entries.is_empty() {
        text.push_str("{}");
        return;
    }
    text.push_str("{\n");
    let indentation = "  ".repeat(depth + 1);
    for value in &table.array {
        text.push_str(&indentation);
        dump_value(value, depth + 1, text);
        text.push_str(",\n");
    }
    for (key, value) in &table.entries {
        text.push_str(&indentation);
        text.push_str(key);
        text.push_str(" = ");
        dump_value(value, depth + 1, text);
        text.push_str(",\n");
    }
    text.push_str(&"  ".repeat(depth));
    text.push('}');
}

fn dump_value(value: &Value, depth: usize, text: &mut String) {
    match value {
        Value::Boolean(boolean) => text.push_str(if *boolean { "true" } else { "false" }),
        Value::Number(number) => text.push_str(&dump_number(*number)),
        Value::Text(string) => text.push_str(&lua_string(string)),
        Value::Table(table) => dump_table(table, depth, text),
        Value::Other(name) => text.push_str(name),
    }
}

fn dump_number(number: f64) -> String {
    if number.is_finite() { format!("{number:.6}") } else { not_finite(number).to_owned() }
}

fn not_finite(number: f64) -> &'static str {
    match number {
        _ if number.is_nan() && number.is_sign_negative() => "-nan",
        _ if number.is_nan() => "nan",
        _ if number > 0.0 => "math.huge",
        _ => "-math.huge",
    }
}

/// A string as Lua 5.2's `%q` writes it.
pub(crate) fn lua_string(string: &str) -> String {
    let mut quoted = String::with_capacity(string.len() + 2);
    quoted.push('"');
    let mut characters = string.chars().peekable();
    while let Some(character) = characters.next() {
        match character {
            '"' | '\\' | '\n' => {
                quoted.push('\\');
                quoted.push(character);
            }
            _ if character.is_ascii_control() => {
                let code = u32::from(character);
                let digit_follows = characters.peek().is_some_and(char::is_ascii_digit);
                quoted.push_str(&if digit_follows { format!("\\{code:03}") } else { format!("\\{code}") });
            }
            _ => quoted.push(character),
        }
    }
    quoted.push('"');
    quoted
}

/// A single value as Lua text that evaluates to exactly the same value.
pub(crate) fn lua_literal(value: &Value) -> String {
    match value {
        Value::Number(number) if number.is_nan() => "0 / 0".to_owned(),
        Value::Number(number) if number.is_infinite() => not_finite(*number).to_owned(),
        Value::Number(number) if *number != 0.0 && !(1e-4..1e15).contains(&number.abs()) => {
            format!("{number:e}")
        }
        Value::Number(number) => number.to_string(),
        Value::Table(table) => dump(table),
        Value::Boolean(boolean) => boolean.to_string(),
        Value::Text(text) => lua_string(text),
        Value::Other(name) => (*name).to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_as_by_format_q() {
        assert_eq!(lua_string("a\"b\\c\nd"), "\"a\\\"b\\\\c\\\nd\"");
        assert_eq!(lua_string("\r1\0x\u{7f}"), "\"\\0131\\0x\\127\"");
        assert_eq!(lua_string("ä"), "\"ä\"");
    }

    #[test]
    fn literals_are_exact() {
        for number in [0.1, 1e300, -5e-324, 1.0 / 3.0, 0.0, 40.0, 1e15, 123_456_789.0] {
            let text = lua_literal(&Value::Number(number));
            assert_eq!(text.parse::<f64>().unwrap(), number, "{text}");
        }
    }

    #[test]
    fn empty_tables_and_numbers_that_are_not_finite() {
        assert_eq!(dump(&Table::default()), "{}");
        assert_eq!(dump_number(f64::NEG_INFINITY), "-math.huge");
        assert_eq!(dump_number(-0.0), "-0.000000");
        assert_eq!(dump_number(1e20), "100000000000000000000.000000");
    }
}
