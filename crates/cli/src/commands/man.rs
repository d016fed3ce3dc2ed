//! `portolan man`: makes manual pages from the same source as `--help`.

use std::path::{Path, PathBuf};

use crate::error::{CliError, Outcome};
use crate::output::print_bytes;

/// Print the manual page, or write one page per verb into a folder.
#[derive(clap::Args)]
pub struct ManArgs {
    /// Folder to write `portolan.1`, `portolan-map.1`, … into.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
}

pub fn run(args: &ManArgs) -> Result<Outcome, CliError> {
    let command = crate::command_line();
    match &args.output {
        Some(folder) => write_pages(command, folder)?,
        None => {
            let mut page = Vec::new();
            clap_mangen::Man::new(command).render(&mut page)?;
            print_bytes(&page)?;
        }
    }
    Ok(Outcome::Done)
}

fn write_pages(command: clap::Command, folder: &Path) -> Result<(), CliError> {
    let failed = |source| CliError::File { path: folder.to_owned(), source };
    std::fs::create_dir_all(folder).map_err(failed)?;
    clap_mangen::generate_to(command, folder).map_err(failed)
}
