//! Finds the line of a Lua file that sets a key, for messages.

use crate::error::Place;
use crate::lua::Evaluation;

/// The place in the user's own files that sets the key at the end of a path: the only such line, or the only
/// one that also names the table; otherwise only the file. Built-in files are never reported.
pub(crate) fn locate(evaluation: &Evaluation, path: &str) -> Option<Place> {
    let mut segments = path.rsplit('.');
    let key = segments.next()?;
    let table = segments.next();
    let mut places: Vec<(Place, bool)> = Vec::new();
    for source in evaluation.sources.iter().filter(|source| !source.built_in) {
        let text = String::from_utf8_lossy(&source.content);
        for (index, line) in text.lines().enumerate() {
            let code = line.split("--").next().unwrap_or(line);
            if gives(code, key) {
                let place = Place { file: source.path.clone(), line: Some(index + 1) };
                let names_table =
                    table.is_some_and(|table| code.to_lowercase().contains(&format!("{table}.{key}")));
                places.push((place, names_table));
            }
        }
    }
    let naming: Vec<_> = places.iter().filter(|(_, names_table)| *names_table).collect();
    match (naming.as_slice(), places.as_slice()) {
        ([(place, _)], _) | (_, [(place, _)]) => Some(place.clone()),
        (_, []) => None,
        (_, [(first, _), rest @ ..]) => {
            let same_file = rest.iter().all(|(place, _)| place.file == first.file);
            same_file.then(|| Place { file: first.file.clone(), line: None })
        }
    }
}

/// Whether a line assigns to a key: the whole word, followed by a single equals sign.
fn gives(code: &str, key: &str) -> bool {
    let is_word = |character: char| character.is_alphanumeric() || character == '_';
    code.match_indices(key).any(|(start, _)| {
        let before = code.get(..start).and_then(|text| text.chars().next_back());
        let after = code.get(start + key.len()..).unwrap_or("");
        let value = after.trim_start_matches(['"', '\'', ']', ' ', '\t']);
        !before.is_some_and(is_word)
            && !after.starts_with(is_word)
            && value.starts_with('=')
            && !value.starts_with("==")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_assignments_of_the_whole_word_count() {
        assert!(gives("  min_score = 0.6,", "min_score"));
        assert!(gives("POSE_GRAPH.constraint_builder.min_score=0.6", "min_score"));
        assert!(gives("t[\"min_score\"] = 1", "min_score"));
        assert!(!gives("global_min_score = 1", "min_score"));
        assert!(!gives("if min_score == 1 then", "min_score"));
        assert!(!gives("x = min_score", "min_score"));
    }
}
