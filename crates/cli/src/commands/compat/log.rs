//! Prints lines in the format of Cartographer's log (glog).

use std::time::{SystemTime, UNIX_EPOCH};

use crate::commands::info::utc_parts;
use crate::progress::print_line;

/// Prints a line of information on stderr, with the prefix that log readers expect:
/// `I0203 04:05:06.000007 1234 portolan] text`.
pub fn info(text: &str) {
    line('I', text);
}

/// Prints a warning.
pub fn warning(text: &str) {
    line('W', text);
}

fn line(level: char, text: &str) {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(now.as_secs()).unwrap_or(0);
    let [_, month, day, hour, minute, second] = utc_parts(seconds);
    print_line(&format!(
        "{level}{month:02}{day:02} {hour:02}:{minute:02}:{second:02}.{:06} {:5} portolan] {text}",
        now.subsec_micros(),
        std::process::id()
    ));
}
