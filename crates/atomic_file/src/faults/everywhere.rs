//! Fault injection test: results are written while the disk fails at each operation in turn, and the files that remain
//! are checked.
#![allow(clippy::unwrap_used)] // in tests this is how errors are shown

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use super::{Fault, fail_at, mend};

/// Error of a run that could not write its results.
pub type Failure = Box<dyn std::error::Error>;

/// Run whose results are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Run {
    /// Run whose files are in the folder before the disk fails.
    Earlier,
    /// Run during which the disk fails.
    Later,
}

/// Contents of files by name.
type Files = BTreeMap<String, Vec<u8>>;

/// [`fail_at_every`] with step 1: the disk fails at every operation.
///
/// # Panics
/// As [`fail_at_every`].
pub fn fail_everywhere(
    faults: &[Fault],
    compared: fn(&str, Vec<u8>) -> Option<Vec<u8>>,
    write: impl Fn(&Path, Run) -> Result<(), Failure>,
) -> u64 {
    fail_at_every(1, faults, compared, write)
}

/// Repeats a later run that overwrites the files of an earlier run, and lets the disk fail at every `step`-th operation
/// in turn. Returns the number of operations of the later run.
///
/// `compared` maps name and content of a file to the part that is the same in every run; none excludes the file. A
/// small file takes four operations: with an odd step each of them fails in some file.
///
/// # Panics
/// If one of these does not hold:
/// - A run that fails returns an error with the cause and a path in the folder.
/// - A run that succeeds in spite of a fault leaves all its files.
/// - Each file is that of the earlier or of the later run; there is no other file, and none that both runs write is
///   missing.
/// - After the last kind of fault the same run succeeds when it is repeated.
pub fn fail_at_every(
    step: usize,
    faults: &[Fault],
    compared: fn(&str, Vec<u8>) -> Option<Vec<u8>>,
    write: impl Fn(&Path, Run) -> Result<(), Failure>,
) -> u64 {
    let folder = || tempfile::tempdir().unwrap();
    let (before, after) = (folder(), folder());
    fail_at(u64::MAX, Fault::Full);
    write(before.path(), Run::Earlier).unwrap();
    copy(before.path(), after.path());
    fail_at(u64::MAX, Fault::Full);
    write(after.path(), Run::Later).unwrap();
    let operations = mend();
    let contents = |folder: &Path| contents(folder, compared);
    let (earlier, later) = (contents(before.path()), contents(after.path()));
    for (fault, at) in
        faults.iter().flat_map(|fault| (0..operations).step_by(step).map(move |at| (fault, at)))
    {
        let output = folder();
        let place = format!("{fault:?} at {at}");
        copy(before.path(), output.path());
        fail_at(at, *fault);
        let written = write(output.path(), Run::Later);
        fail_at(u64::MAX, Fault::Full);
        let left = contents(output.path());
        match written {
            Ok(()) => assert!(left == later, "{place}: nothing is said of {:?}", different(&left, &later)),
            Err(error) => {
                let text = error.to_string();
                let has_cause = text.contains("os error") || text.contains("space");
                assert!(has_cause, "{place}: no cause: {text}");
                let folder = output.path().to_string_lossy();
                assert!(text.contains(&*folder), "{place}: no name: {text}");
            }
        }
        for (name, bytes) in &left {
            let is_whole = [&earlier, &later].iter().any(|files| files.get(name) == Some(bytes));
            assert!(is_whole, "{place}: {name} is of neither run");
        }
        for name in earlier.keys().filter(|name| later.contains_key(*name)) {
            assert!(left.contains_key(name), "{place}: {name} is gone");
        }
        if Some(fault) != faults.last() {
            continue;
        }
        let written = write(output.path(), Run::Later).map_err(|error| error.to_string());
        assert!(written.is_ok(), "{place}: not once more: {written:?}");
        let again = contents(output.path());
        assert!(again == later, "{place}: once more, other {:?}", different(&again, &later));
    }
    let output = folder();
    copy(before.path(), output.path());
    fail_at(0, Fault::InterruptedAndShort);
    write(output.path(), Run::Later).unwrap();
    mend();
    let short = contents(output.path());
    assert!(short == later, "short writes: {:?}", different(&short, &later));
    operations
}

fn contents(folder: &Path, compared: fn(&str, Vec<u8>) -> Option<Vec<u8>>) -> Files {
    let entries = fs::read_dir(folder).unwrap().map(Result::unwrap);
    let file = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().unwrap();
        let content = compared(&name, fs::read(entry.path()).unwrap())?;
        Some((name, content))
    };
    entries.filter_map(file).collect()
}

fn copy(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

/// Names of files that differ or are missing on one side.
fn different<'a>(a: &'a Files, b: &'a Files) -> Vec<&'a String> {
    a.keys().chain(b.keys()).filter(|name| a.get(*name) != b.get(*name)).collect()
}
