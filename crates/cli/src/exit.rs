//! How the program ends: one table for all verbs.

use std::process::ExitCode;

/// What the exit code tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ExitStatus {
    /// All that was asked for was done.
    Done = 0,
    /// It was not; what was written is whole.
    Failed = 1,
    /// The command line asks for something impossible.
    Usage = 2,
    /// Done, but something is missing: data of the input, ties between the pieces of a map, or places in a known map.
    Loss = 3,
    /// It ran to its end, but nothing of the result can be trusted.
    Untrusted = 4,
    /// Ended by Ctrl-C, SIGTERM or SIGHUP. What the verb saves then is saved.
    Interrupted = 130,
    /// Nobody reads the output any more, as with `portolan info … | head`: what a shell makes of SIGPIPE.
    ClosedPipe = 141,
}

impl ExitStatus {
    /// The table, for help pages.
    pub const TABLE: &str = "Exit codes: 0 done; 1 failed; 2 wrong usage; 3 done with loss (data of the input, ties \
        between pieces of a map, or places of a recording in a known map are missing); 4 ran to its end, but nothing of the result can be trusted \
        (clouds that do not overlap, a known map that was not found, a start that is refuted, a refinement that was \
        refused, a map that is not finite); 130 interrupted; 141 nobody read the output.";
}

impl From<ExitStatus> for ExitCode {
    fn from(status: ExitStatus) -> Self {
        Self::from(status as u8)
    }
}
