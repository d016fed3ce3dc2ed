//! Ctrl-C, SIGTERM and SIGHUP. Usually one ends the program at once, and its temporary files are removed. While
//! something is worth saving ([`Saving`]) the first one asks to stop and save, and the second ends the program.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::exit::ExitStatus;
use crate::progress::say;

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static SAVING: AtomicUsize = AtomicUsize::new(0);

/// Begins to heed signals.
pub fn watch(quiet: bool) {
    let installed = ctrlc::set_handler(move || {
        let again = INTERRUPTED.swap(true, Ordering::SeqCst);
        if again || SAVING.load(Ordering::SeqCst) == 0 {
            portolan_unfinished::remove_all();
            std::process::exit(ExitStatus::Interrupted as i32);
        }
        if !quiet {
            // Not on this thread: a stderr that nobody reads must not keep the next signal waiting.
            std::thread::spawn(|| say("stopping: what was done is saved; once more to stop at once"));
        }
    });
    if let Err(error) = installed {
        tracing::warn!("Ctrl-C will not save anything: {error}");
    }
    outlive_limits_of_files();
}

/// A file that would grow beyond what the system allows a process (`ulimit -f`) is an error of that file, as a full disk is: with a
/// handler the signal does not end the process.
#[cfg(unix)]
fn outlive_limits_of_files() {
    let handled = std::sync::Arc::new(AtomicBool::new(false));
    if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, handled) {
        tracing::warn!("a limit on the size of files will end the program: {error}");
    }
}

#[cfg(not(unix))]
fn outlive_limits_of_files() {}

/// Whether the user asked to stop.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}

/// As long as this lives, what is done is worth saving: the first signal only sets [`interrupted`].
pub struct Saving(());

impl Saving {
    /// Begins now.
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
