//! The macros that define options.
//!
//! One entry of [`options!`](crate::define) is the only place where an option is written:
//!
//! ```text
//! options! {
//!     /// What the table is for.
//!     MotionFilterOptions {
//!         /// What the option does. Raise it when ….
//!         max_time_seconds: f64 = 5.0, "s", Bounds::at_least(0.0).or_infinite();
//!         ^ Lua key         type  default unit  bounds
//!     }
//! }
//! ```
//!
//! The entry generates the struct field and its rustdoc, the default, the bounds check, the line of the
//! reference page, `explain`, the dotted path for `get` and `set`, reading from Lua and JSON, writing Lua,
//! the listing and the fingerprint. A nested table is an entry without unit and bounds; a table that may be
//! absent has the type `Option<…>`. `=> optional` after an entry means that a Lua file may leave the key out
//! without a warning; `=> flattened` means that the keys of the nested table are directly in the enclosing
//! one.

/// Defines a table of options; see the [module documentation](crate::define).
macro_rules! options {
    (
        $(#[doc = $table_doc:literal])+
        $name:ident {
            $(
                $(#[doc = $doc:literal])+
                $field:ident : $type:ty = $default:expr $(, $unit:literal, $bounds:expr)? $(=> $mark:ident)?;
            )*
        }
    ) => {
        $(#[doc = $table_doc])+
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name {
            $(
                $(#[doc = $doc])+
                #[doc = ""]
                #[doc = concat!("Default `", stringify!($default), "`" $(, ", unit: ", $unit, ", bounds: `", stringify!($bounds), "`")?, ".")]
                pub $field: $type,
            )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $crate::node::Section for $name {
            fn doc(&self) -> &'static str {
                concat!($($table_doc, "\n"),+)
            }

            fn specs(&self) -> &'static [$crate::node::OptionSpec] {
                const SPECS: &[$crate::node::OptionSpec] = &[$(
                    $crate::node::OptionSpec::new(stringify!($field), concat!($($doc, "\n"),+))
                        $(.with($unit, $bounds))?
                        $(.marked($crate::define::mark!($mark)))?,
                )*];
                SPECS
            }

            fn field(&self, index: usize) -> Option<$crate::node::NodeRef<'_>> {
                let fields: [&dyn $crate::node::Field; [$(stringify!($field)),*].len()] = [$(&self.$field),*];
                fields.get(index).map(|field| field.node())
            }

            fn field_mut(&mut self, index: usize) -> Option<$crate::node::NodeMut<'_>> {
                let fields: [&mut dyn $crate::node::Field; [$(stringify!($field)),*].len()] =
                    [$(&mut self.$field),*];
                fields.into_iter().nth(index).map(|field| field.node_mut())
            }
        }

        impl $crate::node::Field for $name {
            fn node(&self) -> $crate::node::NodeRef<'_> {
                $crate::node::NodeRef::Section(self)
            }
            fn node_mut(&mut self) -> $crate::node::NodeMut<'_> {
                $crate::node::NodeMut::Section(self)
            }
        }

        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                $crate::node::section_to_value(self).serialize(serializer)
            }
        }
    };
}

/// The mark of an entry of [`options!`].
macro_rules! mark {
    (optional) => {
        $crate::node::Mark::Optional
    };
    (flattened) => {
        $crate::node::Mark::Flattened
    };
}

/// Defines an option with a fixed set of names, which are strings in Lua.
macro_rules! choices {
    (
        $(#[doc = $doc:literal])+
        $name:ident { $( $(#[doc = $variant_doc:literal])+ $variant:ident = $text:literal, )+ }
    ) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name { $( $(#[doc = $variant_doc])+ $variant, )+ }

        impl $name {
            /// All names that a configuration may contain.
            pub const NAMES: &'static [&'static str] = &[$($text),+];

            /// The name in a configuration.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $text,)+ }
            }
        }

        impl $crate::node::Leaf for $name {
            fn type_name(&self) -> String {
                format!("one of {}", [$(concat!("\"", $text, "\"")),+].join(", "))
            }
            fn to_value(&self) -> $crate::value::Value {
                $crate::value::Value::Text(self.name().to_owned())
            }
            fn assign(&mut self, value: &$crate::value::Value) -> bool {
                let $crate::value::Value::Text(text) = value else { return false };
                match text.as_str() {
                    $($text => *self = Self::$variant,)+
                    _ => return false,
                }
                true
            }
        }

        impl $crate::node::Field for $name {
            fn node(&self) -> $crate::node::NodeRef<'_> {
                $crate::node::NodeRef::Leaf(self)
            }
            fn node_mut(&mut self) -> $crate::node::NodeMut<'_> {
                $crate::node::NodeMut::Leaf(self)
            }
        }

        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(self.name())
            }
        }
    };
}

pub(crate) use {choices, mark, options};
