//! Gets and sets single options by path.

use crate::bounds::Bounds;
use crate::catalogue::{Entry, entries_of, resolve};
use crate::error::ConfigError;
use crate::lua::evaluate_number;
use crate::node::{Leaf, Mark, NodeMut, NodeRef, OptionSpec, Section, section_to_value};
use crate::options::Options;
use crate::value::{Value, parse_lua_number};

impl Options {
    /// Sets one option, `path=value`.
    ///
    /// The path is the full one (`map_builder.pose_graph.constraint_builder.min_score`) or any end of it that
    /// fits only one option (`constraint_builder.min_score`). Values are written as in Lua, strings also
    /// without quotes: `true`, `0.6`, `math.rad(20)`, `math.huge`, `base_link`; angles also as `20deg`.
    /// Setting an option of an absent table creates the table; `path=nil` removes a table that may be absent.
    ///
    /// # Errors
    /// If the text is not a setting, its path fits no option or several, or the value does not fit.
    pub fn set(&mut self, setting: &str) -> Result<(), ConfigError> {
        let no_setting = || ConfigError::NoSetting { text: setting.to_owned() };
        let (path, value) = setting.split_once('=').ok_or_else(no_setting)?;
        if path.trim().is_empty() {
            return Err(no_setting());
        }
        let path = &resolve(path)?.path;
        let value = value.trim();
        with_node(self, path, path, &mut |spec, node| assign_text(path, spec, node, value))
    }

    /// The value at a path, given as for [`Options::set`]; a table as a table, `None` for an absent one.
    ///
    /// # Errors
    /// If the path fits no option or several.
    pub fn get(&self, path: &str) -> Result<Option<Value>, ConfigError> {
        let doc = resolve(path)?;
        Ok(find(self, &doc.path))
    }

    /// Every option that is present with its value, in the order of the files.
    pub fn entries(&self) -> Vec<Entry> {
        entries_of(self)
    }

    /// The entries whose value is not the default.
    pub fn changed_entries(&self) -> Vec<Entry> {
        let defaults = entries_of(&Options::default());
        self.entries().into_iter().filter(|entry| !defaults.contains(entry)).collect()
    }
}

/// Calls `act` with the node at a full path; absent tables on the path are created.
fn with_node(
    section: &mut dyn Section,
    path: &str,
    full_path: &str,
    act: &mut dyn FnMut(&OptionSpec, NodeMut<'_>) -> Result<(), ConfigError>,
) -> Result<(), ConfigError> {
    let (key, rest) = path.split_once('.').map_or((path, None), |(key, rest)| (key, Some(rest)));
    let unknown = || ConfigError::UnknownKey { path: full_path.to_owned(), nearest: None, place: None };
    let index = index_of(section, key).ok_or_else(unknown)?;
    let spec = section.specs().get(index).ok_or_else(unknown)?;
    match (section.field_mut(index).ok_or_else(unknown)?, rest) {
        (NodeMut::Section(nested), _) if spec.mark == Mark::Flattened => {
            with_node(nested, path, full_path, act)
        }
        (node, None) => act(spec, node),
        (NodeMut::Section(nested), Some(rest)) => with_node(nested, rest, full_path, act),
        (NodeMut::Optional(optional), Some(rest)) => {
            let was_absent = optional.present().is_none();
            let result = with_node(optional.or_default(), rest, full_path, act);
            if was_absent && result.is_err() {
                optional.clear();
            }
            result
        }
        (NodeMut::Leaf(_), Some(_)) => Err(unknown()),
    }
}

/// Index of the entry of a key, or of the flattened table that contains it.
fn index_of(section: &dyn Section, key: &str) -> Option<usize> {
    section.specs().iter().enumerate().position(|(index, spec)| match spec.mark {
        Mark::Flattened => {
            matches!(section.field(index), Some(NodeRef::Section(nested)) if index_of(nested, key).is_some())
        }
        _ => spec.key == key,
    })
}

fn find(section: &dyn Section, path: &str) -> Option<Value> {
    let (key, rest) = path.split_once('.').map_or((path, None), |(key, rest)| (key, Some(rest)));
    let index = index_of(section, key)?;
    let flattened = section.specs().get(index)?.mark == Mark::Flattened;
    let inner = |nested: &dyn Section| match rest {
        _ if flattened => find(nested, path),
        Some(rest) => find(nested, rest),
        None => Some(section_to_value(nested)),
    };
    match section.field(index)? {
        NodeRef::Leaf(leaf) => rest.is_none().then(|| leaf.to_value()),
        NodeRef::Section(nested) => inner(nested),
        NodeRef::Optional(optional) => inner(optional.present()?),
    }
}

fn assign_text(path: &str, spec: &OptionSpec, node: NodeMut<'_>, text: &str) -> Result<(), ConfigError> {
    let wrong_type = |expected: &str| ConfigError::WrongType {
        path: path.to_owned(),
        expected: expected.to_owned(),
        found: format!("`{text}`"),
        place: None,
    };
    match node {
        NodeMut::Section(_) => Err(wrong_type("a table; set one of its options")),
        NodeMut::Optional(optional) => match text {
            "nil" | "none" | "absent" => {
                optional.clear();
                Ok(())
            }
            "{}" | "default" => {
                optional.or_default();
                Ok(())
            }
            _ => Err(wrong_type("a table; set one of its options, or nil to take it away")),
        },
        NodeMut::Leaf(leaf) => {
            let type_name = leaf.type_name();
            let value = match type_name.as_str() {
                "boolean" => boolean(text),
                "integer" => {
                    number(text, spec.unit).filter(|number| number.fract() == 0.0).map(Value::Number)
                }
                "number" => number(text, spec.unit).map(Value::Number),
                _ => Some(Value::Text(unquoted(text).to_owned())),
            };
            let value = value.ok_or_else(|| wrong_type(&type_name))?;
            assign_checked(path, leaf, &value, &spec.bounds).ok_or_else(|| wrong_type(&type_name))?
        }
    }
}

/// Assigns a value of the right type that is within its bounds; `None` if the type is wrong.
fn assign_checked(
    path: &str,
    leaf: &mut dyn Leaf,
    value: &Value,
    bounds: &Bounds,
) -> Option<Result<(), ConfigError>> {
    let out_of_bounds = |value: f64| {
        Some(Err(ConfigError::OutOfBounds { path: path.to_owned(), value, bounds: *bounds, place: None }))
    };
    if let Value::Number(number) = value
        && !bounds.contain(*number)
    {
        return out_of_bounds(*number);
    }
    let before = leaf.to_value();
    if !leaf.assign(value) {
        return None;
    }
    // Rounding to single precision may move a value out of its bounds.
    match leaf.to_value() {
        Value::Number(number) if !bounds.contain(number) => {
            let _restored = leaf.assign(&before);
            out_of_bounds(number)
        }
        _ => Some(Ok(())),
    }
}

fn boolean(text: &str) -> Option<Value> {
    match text {
        "true" => Some(Value::Boolean(true)),
        "false" => Some(Value::Boolean(false)),
        _ => None,
    }
}

fn number(text: &str, unit: &str) -> Option<f64> {
    if let Some(number) = parse_lua_number(text) {
        return Some(number);
    }
    if unit == "rad"
        && let Some(degrees) = text.strip_suffix("deg").or_else(|| text.strip_suffix('°'))
    {
        return parse_lua_number(degrees).map(f64::to_radians);
    }
    evaluate_number(text)
}

fn unquoted(text: &str) -> &str {
    let inner = |quote: char| text.strip_prefix(quote).and_then(|rest| rest.strip_suffix(quote));
    inner('"').or_else(|| inner('\'')).unwrap_or(text)
}
