//! Results on stdout and in files.

use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

use serde::Serialize;

use portolan_atomic_file::{AtomicFile, ResultFolder};
pub use portolan_numeric::counted;
use portolan_pbstream::Finding;

use crate::error::{CliError, Outcome};
use crate::progress::print_line;

/// Prints a result; a line feed is appended unless it ends with one.
///
/// # Errors
/// If stdout cannot be written to: the result was not delivered.
pub fn print(text: &str) -> Result<(), CliError> {
    let line_feed = if text.ends_with('\n') { "" } else { "\n" };
    print_bytes(format!("{}{line_feed}", without_control(text)).as_bytes())
}

/// Escapes control characters of terminals, because names of frames and topics come from untrusted files.
pub fn without_control(text: &str) -> Cow<'_, str> {
    let controls = |c: char| c.is_control() && !matches!(c, '\n' | '\t' | '\r');
    if !text.contains(controls) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| if controls(c) { c.escape_default().collect() } else { String::from(c) };
    Cow::Owned(text.chars().map(shown).collect())
}

/// Prints a result as bytes.
///
/// # Errors
/// As [`print`].
pub fn print_bytes(bytes: &[u8]) -> Result<(), CliError> {
    let mut out = std::io::stdout().lock();
    out.write_all(bytes)?;
    Ok(out.flush()?)
}

/// Outcome of a command that wrote a map which has kept this damage of its sources. The damage is reported on stderr.
pub fn outcome_of_map(output: &Path, damage: &[Finding]) -> Outcome {
    let Some(first) = damage.first() else { return Outcome::Done };
    let count: u64 = damage.iter().map(|finding| finding.count).sum();
    let more = if count > 1 { format!(" (and {} more)", count - 1) } else { String::new() };
    print_line(&format!(
        "{}: has the same damage as the map it was made from: {first}{more}; `portolan repair` removes damaged parts",
        output.display()
    ));
    Outcome::DataLost
}

/// Prints a summary of a command whose results are files. If it cannot be printed the command still succeeds, because
/// the files are written.
pub fn print_summary(text: &str) {
    match print(text) {
        Err(CliError::Output(error)) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            print_line(&format!("the summary cannot be written to the standard output: {error}"));
        }
        _ => {}
    }
}

/// Prints a result as indented JSON.
pub fn print_json(value: &impl Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value).map_err(|error| CliError::Failed(error.to_string()))?;
    print(&text)
}

/// Writes a file that appears under its name only when it is complete.
pub fn write_file(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), CliError> {
    let mut file = AtomicFile::create(path)?;
    match write(&mut file) {
        Ok(()) => Ok(file.commit()?),
        Err(source) => Err(file.error(source).into()),
    }
}

/// Creates a folder for results. If it is still empty when the value is dropped, it is removed again.
///
/// # Errors
/// The folder cannot be created or written to.
pub fn make_folder(path: &Path) -> Result<ResultFolder, CliError> {
    ResultFolder::make(path).map_err(|source| CliError::File { path: path.to_owned(), source })
}
