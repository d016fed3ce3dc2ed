//! `portolan completions`: tab completion for shells.

use crate::error::{CliError, Outcome};
use crate::output::print_bytes;

/// Print the completion script of a shell: `source <(portolan completions bash)`.
#[derive(clap::Args)]
pub struct CompletionsArgs {
    /// Shell to print the script for.
    shell: clap_complete::Shell,
}

pub fn run(args: &CompletionsArgs) -> Result<Outcome, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut crate::command_line(), "portolan", &mut script);
    print_bytes(&script)?;
    Ok(Outcome::Done)
}
