//! `portolan config explain`: explains options.

use portolan_config::{OptionDoc, Options, catalogue, explain_all};
use serde::Serialize;

use crate::error::{CliError, Outcome};
use crate::output::{print, print_json};

/// Width of explanations, characters.
const WIDTH: usize = 96;

/// Explain an option: type, unit, bounds, default, what it does and when to raise it.
///
/// KEY may be shortened from the left and may name a table; all matching options are shown. If none matches,
/// KEY is searched in names and explanations.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan config explain constraint_builder.min_score\n  \
    portolan config explain TRAJECTORY_BUILDER.trajectory_builder_2d.submaps")]
pub struct ExplainArgs {
    /// Option or table, for example `min_score` or `pose_graph.constraint_builder`.
    key: String,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Explanation<'a> {
    path: &'a str,
    #[serde(rename = "type")]
    type_name: &'a str,
    unit: &'a str,
    default: &'a str,
    bounds: Option<String>,
    doc: &'a str,
    options: Vec<&'a str>,
}

pub fn run(args: &ExplainArgs) -> Result<Outcome, CliError> {
    let docs = explain_all(&args.key);
    if docs.is_empty() {
        let found = search(&args.key);
        if !found.is_empty() && !args.json {
            print(&found)?;
            return Ok(Outcome::Done);
        }
        let nearest = Options::default().get(&args.key).err().map(|error| error.to_string());
        let unknown = || format!("unknown option `{}`", args.key);
        return Err(CliError::Usage(nearest.unwrap_or_else(unknown)));
    }
    if args.json {
        let explanations: Vec<Explanation> = docs.iter().map(explanation).collect();
        print_json(&explanations)?;
    } else {
        let texts: Vec<String> = docs.iter().map(text).collect();
        print(&texts.join("\n"))?;
    }
    Ok(Outcome::Done)
}

/// Lists the options whose name or explanation contains a word, with the beginning of the explanation.
fn search(word: &str) -> String {
    let word = word.to_lowercase();
    let has_word = |doc: &&OptionDoc| {
        !word.is_empty()
            // A path is not searched as a word: for a misspelt path the nearest one is suggested.
            && !word.contains('.')
            && (doc.path.to_lowercase().contains(&word) || doc.doc.to_lowercase().contains(&word))
    };
    let line = |doc: &OptionDoc| format!("{}\n    {}\n", doc.path, preview(&doc.doc));
    catalogue().iter().filter(has_word).map(line).collect()
}

/// The beginning of an explanation, up to the first '.', ':' or ';' at the end of a word; of these only a
/// full stop is kept.
fn preview(text: &str) -> &str {
    let mark = text.match_indices(['.', ':', ';']).find(|(at, mark)| {
        let rest = text.get(at + mark.len()..).unwrap_or_default();
        rest.is_empty() || rest.starts_with(char::is_whitespace)
    });
    let end = mark.map_or(text.len(), |(at, mark)| if mark == "." { at + mark.len() } else { at });
    text.get(..end).unwrap_or(text)
}

fn explanation(doc: &OptionDoc) -> Explanation<'_> {
    Explanation {
        path: &doc.path,
        type_name: &doc.type_name,
        unit: doc.unit,
        default: &doc.default,
        bounds: bounds(doc),
        doc: &doc.doc,
        options: children(doc).map(|child| child.path.as_str()).collect(),
    }
}

fn bounds(doc: &OptionDoc) -> Option<String> {
    (doc.is_number() && !doc.bounds.is_any()).then(|| doc.bounds.to_string())
}

/// Options directly in a table.
fn children(doc: &OptionDoc) -> impl Iterator<Item = &'static OptionDoc> {
    let is_child =
        |child: &&OptionDoc| child.path.rsplit_once('.').is_some_and(|(table, _)| table == doc.path);
    catalogue().iter().filter(is_child)
}

fn text(doc: &OptionDoc) -> String {
    let mut text = format!("{}\n", doc.path);
    if doc.is_table {
        text.push_str(if doc.default == "absent" { "  table, absent by default\n" } else { "  table\n" });
    } else {
        let has_unit = doc.is_number() && !doc.unit.is_empty();
        let unit = if has_unit { format!(" {}", doc.unit) } else { String::new() };
        let bounds = bounds(doc).map(|bounds| format!(", {bounds}")).unwrap_or_default();
        text.push_str(&format!("  {}{bounds}; default {}{unit}\n", doc.type_name, doc.default));
    }
    for line in wrapped(&doc.doc, WIDTH - 2) {
        text.push_str(&format!("  {line}\n"));
    }
    for child in children(doc) {
        let key = child.path.rsplit('.').next().unwrap_or(&child.path);
        let default = if child.is_table { "…" } else { &child.default };
        text.push_str(&format!("    {key} = {default}\n"));
    }
    text
}

/// Wraps text between words into lines of at most `width` characters.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_broken_between_words() {
        assert_eq!(wrapped("one two  three", 7), ["one two", "three"]);
        assert_eq!(wrapped("immeasurable", 3), ["immeasurable"]);
    }

    #[test]
    fn previews_end_at_the_first_clause_and_not_within_a_number() {
        assert_eq!(preview("At least 0.8 of all. Others wait."), "At least 0.8 of all.");
        assert_eq!(preview("Of `a::b`, 1;2: all"), "Of `a::b`, 1;2");
        assert_eq!(preview("Zero is off; 0.5 m is usual."), "Zero is off");
        assert_eq!(preview("Up to 2.5 m."), "Up to 2.5 m.");
        assert_eq!(preview("without a mark"), "without a mark");
    }
}
