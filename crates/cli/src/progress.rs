//! Progress on stderr: a bar on a terminal, otherwise a line every 10 s; nothing with `--quiet`.

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use crate::output::without_control;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Minimum interval between lines when stderr is not a terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Progress of one long operation.
pub struct Progress {
    bar: Option<ProgressBar>,
    title: String,
    lines: bool,
    last_line: Instant,
    last_update: Instant,
}

impl Progress {
    /// Begins an operation of `total` units (bytes, seconds, …).
    pub fn start(title: &str, total: u64, quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = (!quiet && terminal).then(|| {
            let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(8));
            if let Ok(style) =
                ProgressStyle::with_template("{prefix} [{bar:30}] {percent:>3}% {msg} left {eta}")
            {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.set_prefix(title.to_owned());
            bar
        });
        let now = Instant::now();
        Self { bar, title: title.to_owned(), lines: !quiet && !terminal, last_line: now, last_update: now }
    }

    /// Whether an update is due. Callers ask before they format a message, which is more expensive.
    pub fn is_due(&mut self) -> bool {
        let due = self.last_update.elapsed() >= Duration::from_millis(100);
        if due {
            self.last_update = Instant::now();
        }
        due && (self.bar.is_some() || self.lines)
    }

    /// Shows the position and a message.
    pub fn update(&mut self, position: u64, total: u64, message: String) {
        if let Some(bar) = &self.bar {
            bar.set_length(total);
            bar.set_position(position);
            bar.set_message(message);
        } else if self.lines && self.last_line.elapsed() >= LINE_INTERVAL {
            self.last_line = Instant::now();
            let percent = (100 * position).checked_div(total).unwrap_or(0);
            print_line(&format!("{} {percent}% {message}", self.title));
        }
    }

    /// Removes the bar.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Prints a line on stderr. Errors are ignored, because a closed or full stderr must not end the program.
pub fn print_line(line: &str) {
    let _ = std::io::stderr().lock().write_all(format!("{}\n", without_control(line)).as_bytes());
}
