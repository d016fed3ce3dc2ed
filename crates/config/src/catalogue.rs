//! All options of a tree with their paths, and search for one by a full or short path.

use std::sync::LazyLock;

use crate::bounds::Bounds;
use crate::error::ConfigError;
use crate::lua::lua_literal;
use crate::nearest::nearest;
use crate::node::{Mark, NodeRef, Section};
use crate::options::Options;
use crate::value::Value;
use crate::without_effect::without_effect;

/// Description of one option or table.
#[derive(Clone, Debug, PartialEq)]
pub struct OptionDoc {
    /// Full dotted path, `map_builder.pose_graph.optimize_every_n_nodes`.
    pub path: String,
    /// Type in words; `table` for tables.
    pub type_name: String,
    /// Unit, empty if there is none.
    pub unit: &'static str,
    /// Default as Lua text; `absent` if the table is absent by default.
    pub default: String,
    /// Bounds of numbers.
    pub bounds: Bounds,
    /// What the option does and when to raise it; if it has no effect, why.
    pub doc: String,
    /// Why it is accepted without effect; `None` if it has one.
    pub without_effect: Option<&'static str>,
    /// Whether it is a table of options.
    pub is_table: bool,
}

impl OptionDoc {
    /// Whether the value is a number, so that unit and bounds are meaningful.
    pub fn is_number(&self) -> bool {
        self.type_name == "number" || self.type_name == "integer"
    }
}

/// One node of a walk over a tree of options.
pub(crate) struct Visit<'a> {
    /// Full dotted path.
    pub path: &'a str,
    /// Its description.
    pub spec: &'a crate::node::OptionSpec,
    /// The option or table.
    pub node: NodeRef<'a>,
    /// Whether the node exists. False within a table that is absent; the values are then its defaults.
    pub present: bool,
}

/// Visits every table and option in the order of their definition, tables before their contents. Absent
/// tables are visited, too, with their defaults.
pub(crate) fn walk(section: &dyn Section, visitor: &mut dyn FnMut(&Visit<'_>)) {
    walk_section(section, "", true, visitor);
}

fn walk_section(section: &dyn Section, prefix: &str, present: bool, visitor: &mut dyn FnMut(&Visit<'_>)) {
    for (index, spec) in section.specs().iter().enumerate() {
        let Some(node) = section.field(index) else { continue };
        if let (Mark::Flattened, NodeRef::Section(nested)) = (spec.mark, &node) {
            walk_section(*nested, prefix, present, visitor);
            continue;
        }
        let path = join(prefix, spec.key);
        match node {
            NodeRef::Leaf(_) => visitor(&Visit { path: &path, spec, node, present }),
            NodeRef::Section(nested) => {
                visitor(&Visit { path: &path, spec, node: NodeRef::Section(nested), present });
                walk_section(nested, &path, present, visitor);
            }
            NodeRef::Optional(optional) => {
                let here = present && optional.present().is_some();
                visitor(&Visit { path: &path, spec, node: NodeRef::Optional(optional), present: here });
                match optional.present() {
                    Some(nested) => walk_section(nested, &path, here, visitor),
                    None => walk_section(optional.template().as_ref(), &path, false, visitor),
                }
            }
        }
    }
}

/// `prefix.key`, or the key alone at the top.
pub(crate) fn join(prefix: &str, key: &str) -> String {
    if prefix.is_empty() { key.to_owned() } else { format!("{prefix}.{key}") }
}

/// Every option and table of [`Options`] with its default, in the order of the files.
pub fn catalogue() -> &'static [OptionDoc] {
    static CATALOGUE: LazyLock<Vec<OptionDoc>> = LazyLock::new(|| catalogue_of(&Options::default()));
    &CATALOGUE
}

/// The catalogue of any tree; its values are the defaults.
pub(crate) fn catalogue_of(section: &dyn Section) -> Vec<OptionDoc> {
    let mut docs = Vec::new();
    walk(section, &mut |visit| {
        let (type_name, default, is_table) = match &visit.node {
            NodeRef::Leaf(leaf) => (leaf.type_name(), lua_literal(&leaf.to_value()), false),
            NodeRef::Section(_) => ("table".to_owned(), "see below".to_owned(), true),
            NodeRef::Optional(optional) => {
                let default = if optional.present().is_some() { "see below" } else { "absent" };
                ("table".to_owned(), default.to_owned(), true)
            }
        };
        docs.push(OptionDoc {
            path: visit.path.to_owned(),
            type_name,
            unit: visit.spec.unit,
            default,
            bounds: visit.spec.bounds,
            doc: documentation(visit),
            without_effect: without_effect(visit.path),
            is_table,
        });
    });
    docs
}

fn documentation(visit: &Visit<'_>) -> String {
    let doc = tidy(visit.spec.doc);
    match without_effect(visit.path) {
        Some(reason) => format!("{doc} Accepted without effect: {reason}."),
        None => doc,
    }
}

/// The lines of a doc comment as one paragraph.
pub(crate) fn tidy(doc: &str) -> String {
    doc.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Description of the option given by its full path or by an end of it that fits only one option. Case is
/// ignored, so that `POSE_GRAPH.constraint_builder.min_score` works as well.
pub fn explain(path: &str) -> Option<OptionDoc> {
    resolve(path).ok().cloned()
}

/// Description of every option whose path ends like this.
pub fn explain_all(path: &str) -> Vec<OptionDoc> {
    candidates(&normalise(path)).into_iter().cloned().collect()
}

/// The one option or table that a path refers to.
pub(crate) fn resolve(path: &str) -> Result<&'static OptionDoc, ConfigError> {
    let wanted = normalise(path);
    let found = candidates(&wanted);
    match found.as_slice() {
        [only] => Ok(only),
        [] => Err(ConfigError::UnknownKey {
            path: path.to_owned(),
            nearest: nearest_path(&wanted),
            place: None,
        }),
        several => Err(ConfigError::Ambiguous {
            path: path.to_owned(),
            candidates: several.iter().map(|doc| doc.path.clone()).collect(),
        }),
    }
}

/// The path in lower case, without spaces, without the prefix of the whole table in files (`options.`) and
/// without that of the top-level keys (`bridge.`).
fn normalise(path: &str) -> String {
    let lower = path.trim().to_lowercase();
    let inner = lower.strip_prefix("options.").unwrap_or(&lower);
    inner.strip_prefix("bridge.").unwrap_or(inner).to_owned()
}

fn candidates(wanted: &str) -> Vec<&'static OptionDoc> {
    if let Some(exact) = catalogue().iter().find(|doc| doc.path == wanted) {
        return vec![exact];
    }
    catalogue().iter().filter(|doc| ends_with_segments(&doc.path, wanted)).collect()
}

fn ends_with_segments(path: &str, end: &str) -> bool {
    path.strip_suffix(end).is_some_and(|rest| !end.is_empty() && (rest.is_empty() || rest.ends_with('.')))
}

/// The known path that a misspelt one probably means: the nearest among all path ends with the same number of
/// segments; if there is none, a path that has the same last key elsewhere.
pub(crate) fn nearest_path(wanted: &str) -> Option<String> {
    let segments = wanted.split('.').count();
    let ends: Vec<&str> = catalogue().iter().filter_map(|doc| last_segments(&doc.path, segments)).collect();
    if let Some(end) = nearest(wanted, ends.iter().copied()) {
        let full = catalogue().iter().filter(|doc| ends_with_segments(&doc.path, end));
        let mut full = full.map(|doc| doc.path.clone());
        return match (full.next(), full.next()) {
            (Some(only), None) => Some(only),
            _ => Some(end.to_owned()),
        };
    }
    let key = wanted.rsplit('.').next()?;
    let elsewhere = candidates(key).first().map(|doc| doc.path.clone());
    elsewhere.or_else(|| {
        let keys = catalogue().iter().filter_map(|doc| doc.path.rsplit('.').next());
        let near = nearest(key, keys)?;
        candidates(near).first().map(|doc| doc.path.clone())
    })
}

fn last_segments(path: &str, count: usize) -> Option<&str> {
    let start = path.rmatch_indices('.').nth(count.checked_sub(1)?).map(|(dot, _)| dot + 1);
    match start {
        Some(start) => path.get(start..),
        None => (path.split('.').count() == count).then_some(path),
    }
}

/// An option and its value, for listings.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Full dotted path.
    pub path: String,
    /// The value.
    pub value: Value,
    /// Unit, empty if there is none.
    pub unit: &'static str,
}

impl std::fmt::Display for Entry {
    /// `path = value` with the value as Lua text.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} = {}", self.path, lua_literal(&self.value))
    }
}

/// Every option that is present, in the order of the files.
pub(crate) fn entries_of(section: &dyn Section) -> Vec<Entry> {
    let mut entries = Vec::new();
    walk(section, &mut |visit| {
        if let (NodeRef::Leaf(leaf), true) = (&visit.node, visit.present) {
            entries.push(Entry {
                path: visit.path.to_owned(),
                value: leaf.to_value(),
                unit: visit.spec.unit,
            });
        }
    });
    entries
}
