//! Checks that all test files are part of the one test program of a crate.

use std::collections::BTreeSet;
use std::path::Path;

/// Asserts that every source file in the folder `tests` of a package is a module of `tests/all.rs`, whose text is
/// `source`. Exceptions are `all.rs` itself and the test programs listed in `own_programs`.
///
/// # Panics
///
/// If a file is no module, or the folder does not exist.
#[track_caller]
pub fn assert_files_are_modules(package: &str, source: &str, own_programs: &[&str]) {
    let modules: BTreeSet<&str> =
        source.lines().filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';')).collect();
    let is_run = |name: &str| name == "all" || modules.contains(name) || own_programs.contains(&name);
    let files =
        std::fs::read_dir(Path::new(package).join("tests")).unwrap().map(|entry| entry.unwrap().path());
    let sources = files.filter(|path| path.extension().is_some_and(|extension| extension == "rs"));
    let names = sources.map(|path| path.file_stem().unwrap().to_string_lossy().into_owned());
    let left_out: Vec<String> = names.filter(|name| !is_run(name)).collect();
    assert!(left_out.is_empty(), "no modules of tests/all.rs, so that nobody runs them: {left_out:?}");
}
