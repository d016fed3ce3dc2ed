//! The verb that was probably meant.

use clap::CommandFactory;
use clap::error::{ContextKind, ContextValue, ErrorKind};

use crate::Cli;

/// A misspelt verb with the nearest ones instead of those that share most letters.
pub fn with_nearest_verb(mut error: clap::Error) -> clap::Error {
    let wrong = match error.get(ContextKind::InvalidSubcommand) {
        Some(ContextValue::String(wrong)) if error.kind() == ErrorKind::InvalidSubcommand => wrong.clone(),
        _ => return error,
    };
    let command = Cli::command();
    let verbs =
        command.get_subcommands().map(|verb| (distance(&wrong, verb.get_name()), verb.get_name().to_owned()));
    let mut near: Vec<(usize, String)> = verbs.filter(|(distance, _)| *distance <= 2).collect();
    near.sort();
    let nearest = near.first().map_or(0, |(distance, _)| *distance);
    let names: Vec<String> =
        near.into_iter().filter(|(distance, _)| *distance == nearest).map(|(_, name)| name).collect();
    if !names.is_empty() {
        error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(names));
    }
    error
}

/// Letters to be put in, taken out, replaced or exchanged with their neighbour (optimal string alignment).
fn distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut rows = vec![(0..=b.len()).collect::<Vec<usize>>()];
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let replaced = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            let mut least = replaced.min(rows[i - 1][j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                least = least.min(rows[i - 2][j - 2] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exchanged_letters_are_one_mistake() {
        assert_eq!((distance("mpa", "map"), distance("mpa", "compat")), (1, 3));
        assert_eq!((distance("", "map"), distance("edit", "edit")), (3, 0));
    }
}
