//! Handles Ctrl-C, SIGTERM and SIGHUP. Normally a signal ends the program at once, and its temporary files are removed.
//! While a [`Saving`] exists, the first signal requests to stop and save, and the second one ends the program.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::exit::ExitStatus;
use crate::progress::print_line;

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static SAVING: AtomicUsize = AtomicUsize::new(0);

/// Installs the signal handler.
pub fn watch(quiet: bool) {
    let installed = ctrlc::set_handler(move || {
        let again = INTERRUPTED.swap(true, Ordering::SeqCst);
        if again || SAVING.load(Ordering::SeqCst) == 0 {
            portolan_unfinished::remove_all();
            std::process::exit(ExitStatus::Interrupted as i32);
        }
        if !quiet {
            // On another thread: a blocked stderr must not delay the handling of the next signal.
            std::thread::spawn(|| {
                print_line("stopping: the results so far are saved; interrupt once more to stop at once")
            });
        }
    });
    if let Err(error) = installed {
        tracing::warn!("Ctrl-C will not save anything: {error}");
    }
    outlive_limits_of_files();
}

/// Handles SIGXFSZ, so that a file that exceeds the file size limit of the process (`ulimit -f`) is a write error, as
/// with a full disk, and does not end the process.
#[cfg(unix)]
fn outlive_limits_of_files() {
    let handled = std::sync::Arc::new(AtomicBool::new(false));
    if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, handled) {
        tracing::warn!("exceeding a limit on the size of files will end the program: {error}");
    }
}

#[cfg(not(unix))]
fn outlive_limits_of_files() {}

/// Whether the user has requested to stop.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}

/// While this value lives, there are partial results to save: the first signal only sets [`interrupted`].
pub struct Saving(());

impl Saving {
    /// Begins a section with partial results to save.
    pub fn begin() -> Self {
        SAVING.fetch_add(1, Ordering::SeqCst);
        Self(())
    }
}

impl Drop for Saving {
    fn drop(&mut self) {
        SAVING.fetch_sub(1, Ordering::SeqCst);
    }
}
