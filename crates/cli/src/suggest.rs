//! Suggests the nearest verb for a misspelt one.

use clap::CommandFactory;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use portolan_config::edit_distance;

use crate::Cli;

/// Maximum edit distance of suggested verbs, letters.
const FAR: usize = 2;

/// For an unknown verb, replaces clap's suggestions by the verbs with the smallest edit distance.
pub fn with_nearest_verb(mut error: clap::Error) -> clap::Error {
    let wrong = match error.get(ContextKind::InvalidSubcommand) {
        Some(ContextValue::String(wrong)) if error.kind() == ErrorKind::InvalidSubcommand => wrong.clone(),
        _ => return error,
    };
    let command = Cli::command();
    let verbs = command
        .get_subcommands()
        .map(|verb| (edit_distance(&wrong, verb.get_name(), FAR), verb.get_name().to_owned()));
    let mut near: Vec<(usize, String)> = verbs.filter(|(distance, _)| *distance <= FAR).collect();
    near.sort();
    let nearest = near.first().map_or(0, |(distance, _)| *distance);
    let names: Vec<String> =
        near.into_iter().filter(|(distance, _)| *distance == nearest).map(|(_, name)| name).collect();
    if !names.is_empty() {
        error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(names));
    }
    error
}
