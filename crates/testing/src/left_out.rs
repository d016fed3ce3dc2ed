//! Records skipped tests in a list that is shown at the end of a run.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use crate::folders::target;

/// Whether long tests are skipped: with `PORTOLAN_TESTS=fast`. A long test begins with
/// `if is_fast() { return; }`.
pub fn is_fast() -> bool {
    match std::env::var("PORTOLAN_TESTS").as_deref() {
        Ok("fast") => {
            left_out("long, PORTOLAN_TESTS=fast");
            true
        }
        Err(_) | Ok("" | "whole") => false,
        Ok(other) => panic!("PORTOLAN_TESTS is {other}: fast and whole are known"),
    }
}

/// Reports that the running test skips something: on stderr, bypassing the capture of the test harness, and in
/// `target/left-out.txt`.
pub fn left_out(what: &str) {
    let line = format!("left out: {}: {what}\n", running_test());
    // The harness captures `eprint`, but not writes to the stream itself. A list that cannot be written does not fail
    // the test.
    let _ = std::io::stderr().write_all(line.as_bytes());
    let _ = append(&target().join("left-out.txt"), &line);
}

fn append(list: &Path, line: &str) -> std::io::Result<()> {
    OpenOptions::new().create(true).append(true).open(list)?.write_all(line.as_bytes())
}

/// Name of test program and test, as in `map::settings_change_the_map`.
fn running_test() -> String {
    let program = std::env::current_exe().unwrap_or_default();
    let name = program.file_stem().unwrap_or_default().to_string_lossy();
    // The file name ends in a dash and the hash of the build.
    let name = name.rsplit_once('-').map_or(&*name, |(name, _)| name);
    let thread = std::thread::current();
    format!("{name}::{}", thread.name().unwrap_or("a thread without a name"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_list_grows() {
        let folder = tempfile::tempdir().unwrap();
        let list = folder.path().join("list.txt");
        append(&list, "one\n").unwrap();
        append(&list, "two\n").unwrap();
        assert_eq!(std::fs::read_to_string(list).unwrap(), "one\ntwo\n");
        assert!(running_test().starts_with("portolan_testing::"), "{}", running_test());
    }
}
