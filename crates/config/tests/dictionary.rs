//! The Lua dictionary: reading rules, bookkeeping, text form.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use portolan_config::ConfigError;
use portolan_config::lua::{Dictionary, Limits, dump, evaluate_text, print_configuration};

fn table(lua: &str) -> portolan_config::Table {
    evaluate_text("test.lua", lua, &[], Limits::default()).unwrap().table
}

fn dictionary(lua: &str) -> Dictionary {
    Dictionary::new(table(&format!("return {lua}")))
}

#[test]
fn values_are_read_by_type() {
    let d = dictionary("{ i = 42, f = 3.7, n = -100, s = 'text', b = true, t = { inner = 1 }, x = '0x10' }");
    assert_eq!(d.keys(), ["b", "f", "i", "n", "s", "t", "x"]);
    assert_eq!(d.string("i").unwrap(), "42");
    assert_eq!(d.integer("f").unwrap(), 3);
    assert_eq!(d.number("x").unwrap(), 16.0);
    assert_eq!(d.string("s").unwrap(), "text");
    assert!(d.boolean("b").unwrap());
    assert_eq!(d.dictionary("t").unwrap().non_negative_integer("inner").unwrap(), 1);
    assert!(d.has_key("n") && !d.has_key("m"));
    let error = d.non_negative_integer("n").unwrap_err().to_string();
    assert!(error.contains("-100 is negative."), "{error}");
    d.finish().unwrap();
}

#[test]
fn other_types_are_refused() {
    let d = dictionary("{ i = 1, s = 'text', t = {}, f = function() end }");
    assert!(matches!(d.boolean("i"), Err(ConfigError::WrongType { .. })));
    assert!(matches!(d.number("s"), Err(ConfigError::WrongType { .. })));
    assert!(matches!(d.string("t"), Err(ConfigError::WrongType { .. })));
    assert!(matches!(d.string("f"), Err(ConfigError::WrongType { .. })));
    assert!(matches!(d.dictionary("i"), Err(ConfigError::WrongType { .. })));
}

#[test]
fn a_missing_key_shows_the_dictionary() {
    let error = dictionary("{ a = 1 }").string("missing").unwrap_err().to_string();
    assert_eq!(error, "Key 'missing' not in dictionary:\n{\n  a = 1.000000,\n}");
}

#[test]
fn every_key_must_be_read_exactly_once() {
    let d = dictionary("{ once = 1, twice = 2, never = 3, table = { inner = 4 }, 5, 6 }");
    d.number("once").unwrap();
    d.number("twice").unwrap();
    d.number("twice").unwrap();
    d.dictionary("table").unwrap();
    let ConfigError::Several { errors } = d.finish().unwrap_err() else { panic!("several errors expected") };
    let text: Vec<_> = errors.iter().map(ToString::to_string).collect();
    assert_eq!(text.len(), 3);
    assert!(text[0].starts_with("Key 'never' was used the wrong number of times."));
    assert!(text[1].starts_with("Key 'twice' was used the wrong number of times."));
    assert!(text[2].starts_with("Key 'table.inner' was used the wrong number of times."));
}

#[test]
fn arrays_end_at_the_first_nil_and_have_no_keys() {
    let strings = dictionary("{ 'a', 'b', 'c' }");
    assert_eq!(strings.array_of_strings().unwrap(), ["a", "b", "c"]);
    assert!(strings.keys().is_empty());
    let numbers = dictionary("{ 0., 1.1, 2.5, nil, 4 }").array_of_numbers().unwrap();
    assert_eq!(numbers[..3], [0.0, 1.1, 2.5]);
    assert_eq!(numbers.len(), 3);
    let d = dictionary("{ { a = 1 }, { b = 3 } }");
    let tables = d.array_of_dictionaries().unwrap();
    assert_eq!((tables[0].integer("a").unwrap(), tables[1].integer("b").unwrap()), (1, 3));
    d.finish().unwrap();
    assert!(strings.array_of_numbers().is_err());
}

const EXPECTED: &str = r#"{
  alpha = true,
  alpha1 = false,
  blub = "hello",
  blubber = 123.000000,
  ceta = {
    yolo = "hurray",
  },
  fasel = 1234.456786,
  fasel1 = -math.huge,
  fasel2 = math.huge,
}"#;

#[test]
fn the_text_form_is_that_of_the_reference_and_parses_back() {
    let lua = "{ceta={yolo='hurray'}, fasel=1234.456786, fasel1=-math.huge, fasel2=math.huge, blubber=123, \
               blub='hello', alpha=true, alpha1=false}";
    let first = table(&format!("return {lua}"));
    assert_eq!(dump(&first), EXPECTED);
    assert_eq!(table(&format!("return {EXPECTED}")), first);
}

#[test]
fn array_values_come_first() {
    let text = dictionary("{ 'blub', 3, 3.1, foo = 'ups', inner = { {}, { 1 } } }").to_string();
    let expected = "{\n  \"blub\",\n  3.000000,\n  3.100000,\n  foo = \"ups\",\n  inner = {\n    {},\n    {\n      \
                    1.000000,\n    },\n  },\n}";
    assert_eq!(text, expected);
}

#[test]
fn strings_are_quoted_as_by_lua_itself() {
    let text = r#"a\"b\\c\nd\r1\0002\t\127"#;
    let quoted = table(&format!("return {{ string.format('%q', \"{text}\") }}")).array[0].as_text().unwrap();
    assert_eq!(dump(&table(&format!("return {{ \"{text}\" }}"))), format!("{{\n  {quoted},\n}}"));
}

#[test]
fn configurations_are_printed_whole_or_in_part() {
    let table = table("return { a = { b = { c = 1 } }, d = 2 }");
    let whole = print_configuration(&table, None).unwrap();
    assert!(whole.starts_with("return {\n  a = {\n") && whole.ends_with("  d = 2.000000,\n}\n"));
    assert_eq!(print_configuration(&table, Some("a.b")).unwrap(), "a.b = {\n  c = 1.000000,\n}\n");
    assert!(print_configuration(&table, Some("a.x")).unwrap_err().to_string().contains("Key 'x' not in"));
    assert!(print_configuration(&table, Some("d")).is_err());
}
