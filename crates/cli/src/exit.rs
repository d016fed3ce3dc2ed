//! Exit codes of all verbs.

use std::process::ExitCode;

/// Exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ExitStatus {
    /// The result is complete.
    Done = 0,
    /// The command failed; files that it wrote are complete.
    Failed = 1,
    /// Wrong usage of the command line.
    Usage = 2,
    /// Done, but something is missing: data of the input, constraints between the pieces of a map, or the pose of a
    /// recording in a known map.
    Loss = 3,
    /// The command ran to its end, but its whole result is unreliable.
    Untrusted = 4,
    /// Ended by Ctrl-C, SIGTERM or SIGHUP. Verbs that save partial results have saved them.
    Interrupted = 130,
    /// The reader of the output has closed the pipe, as with `portolan info … | head`: the code that a shell returns for
    /// SIGPIPE.
    ClosedPipe = 141,
}

impl ExitStatus {
    /// Table of exit codes for help pages.
    pub const TABLE: &str = "Exit codes: 0 done; 1 failed; 2 wrong usage; 3 done with loss (missing are data of \
        the input, constraints between pieces of a map, or poses of a recording in a known map); 4 ran to its end, \
        but nothing of the result can be trusted (clouds that do not overlap, a recording that was not localised in \
        a known map, a start that scans contradict, a refinement that was rejected, a map that is not finite); \
        130 interrupted; 141 broken pipe (the output was closed by its reader).";
}

impl From<ExitStatus> for ExitCode {
    fn from(status: ExitStatus) -> Self {
        Self::from(status as u8)
    }
}
