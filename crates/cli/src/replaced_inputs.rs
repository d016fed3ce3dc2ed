//! Refuses command lines whose output file is also an input: a typing error would destroy a map or a recording.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, Command};
use portolan::job::is_same_file;

use crate::error::CliError;

/// Arguments that are paths of files to write.
const OUTPUTS: [&str; 6] = ["output", "csv", "histogram", "picture", "save_map", "cloud"];

/// Verbs that modify a map or pose graph; they may write over their input.
const IN_PLACE: [&str; 4] = ["edit", "optimize", "migrate", "repair"];

/// Refuses a command line that reads and writes the same file.
///
/// # Errors
/// [`CliError::Usage`] with the path of the file.
pub fn refuse(command: &Command, found: &ArgMatches) -> Result<(), CliError> {
    if let Some((name, found)) = found.subcommand() {
        if IN_PLACE.contains(&name) {
            return Ok(());
        }
        return command.find_subcommand(name).map_or(Ok(()), |command| refuse(command, found));
    }
    let paths = |is_output: bool| {
        let named = command.get_arguments().map(|argument| argument.get_id().as_str());
        let wanted = named.filter(move |id| OUTPUTS.contains(id) == is_output);
        let values = wanted.filter_map(|id| found.try_get_raw(id).ok().flatten()).flatten();
        values.map(PathBuf::from).filter(|path| path.is_file()).collect::<Vec<_>>()
    };
    let inputs = paths(false);
    match paths(true).into_iter().find(|output| inputs.iter().any(|input| is_same_file(input, output))) {
        Some(output) => Err(CliError::Usage(replaced(&output))),
        None => Ok(()),
    }
}

fn replaced(output: &Path) -> String {
    format!(
        "{} is an input, and would be replaced by the output: give the output another name",
        output.display()
    )
}
