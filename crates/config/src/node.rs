//! The tree of options as data: access to every table and option without knowing its type.
//!
//! The structs in [`options`](crate::options) are plain; the macro in `define` implements these traits for
//! each of them. Reading, writing, listing and checking are implemented once for the traits.

use crate::bounds::Bounds;
use crate::value::{Table, Value};

/// Handling of a key when a Lua file is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Cartographer refuses a file without it; here the default is used with a warning.
    Required,
    /// The key may be left out.
    Optional,
    /// A table whose keys are directly in the enclosing table.
    Flattened,
}

/// Description of one option.
#[derive(Clone, Copy, Debug)]
pub struct OptionSpec {
    /// Lua key, equal to the name of the field.
    pub key: &'static str,
    /// Documentation, as in the rustdoc of the field.
    pub doc: &'static str,
    /// Unit, empty for tables.
    pub unit: &'static str,
    /// Bounds; [`Bounds::ANY`] if the option is not a number.
    pub bounds: Bounds,
    /// Handling when a file is read.
    pub mark: Mark,
}

impl OptionSpec {
    /// An entry without unit and bounds that Cartographer requires.
    pub(crate) const fn new(key: &'static str, doc: &'static str) -> Self {
        Self { key, doc, unit: "", bounds: Bounds::ANY, mark: Mark::Required }
    }

    /// The entry with unit and bounds.
    pub(crate) const fn with(self, unit: &'static str, bounds: Bounds) -> Self {
        Self { unit, bounds, ..self }
    }

    /// The entry with another mark.
    pub(crate) const fn marked(self, mark: Mark) -> Self {
        Self { mark, ..self }
    }
}

/// A single value.
pub trait Leaf {
    /// Name of the type.
    fn type_name(&self) -> String;
    /// The value.
    fn to_value(&self) -> Value;
    /// Assigns a value by the accessor rules of the Lua dialect; `false` if the type does not fit.
    #[must_use]
    fn assign(&mut self, value: &Value) -> bool;
}

/// A table of options.
pub trait Section {
    /// Documentation of the table.
    fn doc(&self) -> &'static str;
    /// The entries, in the order of their definition.
    fn specs(&self) -> &'static [OptionSpec];
    /// The entry at an index of [`Section::specs`].
    fn field(&self, index: usize) -> Option<NodeRef<'_>>;
    /// The entry at an index of [`Section::specs`].
    fn field_mut(&mut self, index: usize) -> Option<NodeMut<'_>>;
}

/// A table that may be absent.
pub trait OptionalSection {
    /// The table, if present.
    fn present(&self) -> Option<&dyn Section>;
    /// The table; if absent, it is created with its defaults.
    fn or_default(&mut self) -> &mut dyn Section;
    /// Makes it absent.
    fn clear(&mut self);
    /// A table with the defaults that [`Self::or_default`] would set.
    fn template(&self) -> Box<dyn Section>;
}

/// A node of the tree.
pub enum NodeRef<'a> {
    /// A value.
    Leaf(&'a dyn Leaf),
    /// A table.
    Section(&'a dyn Section),
    /// A table that may be absent.
    Optional(&'a dyn OptionalSection),
}

/// A mutable node of the tree.
pub enum NodeMut<'a> {
    /// A value.
    Leaf(&'a mut dyn Leaf),
    /// A table.
    Section(&'a mut dyn Section),
    /// A table that may be absent.
    Optional(&'a mut dyn OptionalSection),
}

/// A field of a table of options.
pub trait Field {
    /// The node of the field.
    fn node(&self) -> NodeRef<'_>;
    /// The node of the field, mutable.
    fn node_mut(&mut self) -> NodeMut<'_>;
}

impl<S: Section + Default + 'static> OptionalSection for Option<S> {
    fn present(&self) -> Option<&dyn Section> {
        self.as_ref().map(|section| section as &dyn Section)
    }
    fn or_default(&mut self) -> &mut dyn Section {
        self.get_or_insert_with(S::default)
    }
    fn clear(&mut self) {
        *self = None;
    }
    fn template(&self) -> Box<dyn Section> {
        Box::new(S::default())
    }
}

impl<S: Section + Default + 'static> Field for Option<S> {
    fn node(&self) -> NodeRef<'_> {
        NodeRef::Optional(self)
    }
    fn node_mut(&mut self) -> NodeMut<'_> {
        NodeMut::Optional(self)
    }
}

/// Implements the traits of an option for a plain type.
macro_rules! leaf {
    ($type:ty, $name:literal, |$this:ident| $to_value:expr, |$value:ident| $from_value:expr) => {
        impl Leaf for $type {
            fn type_name(&self) -> String {
                $name.to_owned()
            }
            fn to_value(&self) -> Value {
                let $this = self;
                $to_value
            }
            fn assign(&mut self, $value: &Value) -> bool {
                let converted: Option<$type> = $from_value;
                if let Some(converted) = converted {
                    *self = converted;
                    return true;
                }
                false
            }
        }
        impl Field for $type {
            fn node(&self) -> NodeRef<'_> {
                NodeRef::Leaf(self)
            }
            fn node_mut(&mut self) -> NodeMut<'_> {
                NodeMut::Leaf(self)
            }
        }
    };
}

leaf!(bool, "boolean", |this| Value::Boolean(*this), |value| value.as_bool());
leaf!(i32, "integer", |this| Value::Number(f64::from(*this)), |value| value.as_integer());
leaf!(usize, "integer", |this| Value::Number(*this as f64), |value| value
    .as_integer()
    .and_then(|integer| usize::try_from(integer).ok()));
leaf!(f64, "number", |this| Value::Number(*this), |value| value.as_number());
leaf!(f32, "number", |this| Value::Number(shortest_f64(*this)), |value| value
    .as_number()
    .map(|number| number as f32));
leaf!(String, "string", |this| Value::Text(this.clone()), |value| value.as_text());

/// The double with the same shortest decimal text as a single-precision number, so that 0.025 is shown as
/// 0.025. It rounds to the same single-precision number.
fn shortest_f64(single: f32) -> f64 {
    match single.to_string().parse::<f64>() {
        Ok(double) if double as f32 == single => double,
        _ => f64::from(single),
    }
}

/// A table of options as a tree of values; absent tables are left out.
pub fn section_to_value(section: &dyn Section) -> Value {
    let mut table = Table::default();
    collect(section, &mut table);
    Value::Table(table)
}

fn collect(section: &dyn Section, table: &mut Table) {
    for (index, spec) in section.specs().iter().enumerate() {
        let value = match section.field(index) {
            Some(NodeRef::Leaf(leaf)) => leaf.to_value(),
            Some(NodeRef::Section(nested)) if spec.mark == Mark::Flattened => {
                collect(nested, table);
                continue;
            }
            Some(NodeRef::Section(nested)) => section_to_value(nested),
            Some(NodeRef::Optional(optional)) => match optional.present() {
                Some(nested) => section_to_value(nested),
                None => continue,
            },
            None => continue,
        };
        table.entries.insert(spec.key.to_owned(), value);
    }
}
