//! Ctrl-C: the first asks to stop cleanly and save, the second stops at once.

use std::sync::atomic::{AtomicBool, Ordering};

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// How a program ends that was told to stop: 128 and the number of the signal.
pub const EXIT_CODE: u8 = 130;

/// From now on Ctrl-C and SIGTERM only set [`interrupted`]; a second one ends the program.
pub fn watch() {
    let installed = ctrlc::set_handler(|| {
        if INTERRUPTED.swap(true, Ordering::SeqCst) {
            std::process::exit(i32::from(EXIT_CODE));
        }
    });
    if let Err(error) = installed {
        tracing::warn!("Ctrl-C will not save anything: {error}");
    }
}

/// Whether the user asked to stop.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}
