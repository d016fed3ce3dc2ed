//! Reference page of all options.

use std::fmt::Write;

use crate::catalogue::{OptionDoc, catalogue, tidy};
use crate::node::Section;
use crate::options::Options;

/// All options as a Markdown page: for each table its options with default, unit, bounds and description.
pub fn reference() -> String {
    let mut page = String::from(
        "# Options\n\n\
         Every option that a configuration file or `--set` can give, with its default. Paths may be \
         shortened from the left as long as they fit only one option: \
         `constraint_builder.min_score=0.6`. Lengths are metres, angles radians, times seconds.\n",
    );
    write_table(&mut page, "Top level", &tidy(Options::default().doc()), &top_level());
    for table in catalogue().iter().filter(|doc| doc.is_table) {
        let title = format!("`{}`", table.path);
        let absent = if table.default == "absent" {
            " The values below apply when the table is given without them."
        } else {
            ""
        };
        write_table(&mut page, &title, &format!("{}{absent}", table.doc), &children(&table.path));
    }
    page
}

fn top_level() -> Vec<&'static OptionDoc> {
    catalogue().iter().filter(|doc| !doc.path.contains('.')).collect()
}

fn children(path: &str) -> Vec<&'static OptionDoc> {
    let is_child = |doc: &&OptionDoc| doc.path.rsplit_once('.').is_some_and(|(parent, _)| parent == path);
    catalogue().iter().filter(is_child).collect()
}

fn write_table(page: &mut String, title: &str, doc: &str, options: &[&OptionDoc]) {
    let mut text = format!(
        "\n## {title}\n\n{doc}\n\n| option | type | default | bounds | what it does |\n|---|---|---|---|---|\n"
    );
    for option in options {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {} | {} |",
            option.path.rsplit('.').next().unwrap_or(&option.path),
            escape(&option.type_name),
            default_cell(option),
            if option.is_number() { option.bounds.to_string() } else { String::new() },
            escape(&option.doc)
        );
    }
    page.push_str(&text);
}

fn default_cell(option: &OptionDoc) -> String {
    if option.is_table {
        return option.default.clone();
    }
    let unit = if option.is_number() { format!(" {}", option.unit) } else { String::new() };
    format!("`{}`{unit}", option.default)
}

fn escape(text: &str) -> String {
    text.replace('|', "\\|")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::walk;
    use crate::node::NodeRef;
    use crate::options::MapBuilderServerOptions;

    fn undocumented(section: &dyn Section) -> Vec<String> {
        let mut paths = Vec::new();
        walk(section, &mut |visit| {
            let table_doc = match &visit.node {
                NodeRef::Section(nested) => nested.doc(),
                _ => visit.spec.doc,
            };
            if tidy(visit.spec.doc).is_empty() || tidy(table_doc).is_empty() {
                paths.push(visit.path.to_owned());
            }
        });
        paths
    }

    #[test]
    fn every_option_and_table_is_documented() {
        assert_eq!(undocumented(&Options::default()), Vec::<String>::new());
        assert_eq!(undocumented(&MapBuilderServerOptions::default()), Vec::<String>::new());
    }

    #[test]
    fn the_page_has_a_row_for_every_option_in_its_table() {
        let page = reference();
        for doc in catalogue() {
            let (table, key) = doc.path.rsplit_once('.').unwrap_or(("", &doc.path));
            let title =
                if table.is_empty() { "## Top level\n".to_owned() } else { format!("## `{table}`\n") };
            let start = page.find(&title).unwrap_or_else(|| panic!("no chapter for {}", doc.path));
            let chapter = page[start + 3..].split("\n## ").next().unwrap();
            let row = chapter.lines().find(|line| line.starts_with(&format!("| `{key}` |"))).unwrap();
            assert!(row.contains(&escape(&doc.doc)) && row.matches(" | ").count() == 4, "{row}");
        }
    }

    #[test]
    fn rows_contain_defaults_units_and_bounds() {
        let page = reference();
        assert!(page.contains("| `resolution` | number | `0.05` m | >= 0.001 |"), "{page}");
        assert!(page.contains("| `pure_localization_trimmer` | table | absent |"));
    }
}
