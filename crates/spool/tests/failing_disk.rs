//! Records that wait on a disk that fails at any operation: all of them are there, or it is said that they are not.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use portolan_atomic_file::faults::{Fault, fail_at, mend};
use portolan_spool::Spool;

/// Three blocks, and some that are in memory.
const COUNT: usize = 100_000;

fn records() -> impl Iterator<Item = f64> {
    (0..COUNT).map(|index| index as f64)
}

fn filled(folder: &Path) -> Spool<f64> {
    let mut spool = Spool::in_folder(folder);
    records().for_each(|record| spool.push(record));
    spool
}

// One test, because the disk is that of the whole process.
#[test]
fn lost_items_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    fail_at(u64::MAX, Fault::Full);
    let spool = filled(folder.path());
    let writing = 4;
    assert!(spool.iter().eq(records()) && spool.failure().is_none());
    let operations = mend();
    assert_eq!(operations, writing + 3, "a file, three blocks that are written and read");
    for (fault, at) in [Fault::Full, Fault::Broken, Fault::BrokenOnce]
        .into_iter()
        .flat_map(|fault| (0..operations).map(move |at| (fault, at)))
    {
        fail_at(at, fault);
        let spool = filled(folder.path());
        assert_eq!(spool.failure().is_some(), at < writing, "{fault:?} at {at}");
        let read: Vec<f64> = spool.iter().collect();
        let copy = spool.clone();
        mend();
        assert_eq!((spool.len(), spool.last().copied()), (COUNT, records().last()));
        assert!(
            read.iter().copied().zip(records()).all(|(read, record)| read == record),
            "{fault:?} at {at}"
        );
        assert_eq!(spool.whole().is_ok(), read.len() == COUNT, "{fault:?} at {at}");
        assert_eq!(copy.whole().is_ok(), spool.whole().is_ok(), "{fault:?} at {at}: a copy");
        if let Err(error) = spool.whole() {
            let text = error.to_string();
            assert!(text.contains("cannot be read again") && text.contains("os error"), "{text}");
        }
        // Data that could not be read once may be readable later.
        assert!(spool.iter().eq(records()), "{fault:?} at {at}: the disk is mended");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
    fail_at(0, Fault::InterruptedAndShort);
    let spool = filled(folder.path());
    assert!(spool.iter().eq(records()) && spool.whole().is_ok() && spool.failure().is_none());
    assert!(mend() > 1_000_000);
}
