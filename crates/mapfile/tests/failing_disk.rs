//! Maps written to a disk that fails at any write: an error, and no file that looks done.
#![allow(clippy::unwrap_used, clippy::panic)]

mod common;

use std::path::Path;

use common::small_map::SmallMap;
use portolan_atomic_file::faults::{Fault, fail_at, mend};
use portolan_mapfile::{MapDraft, MigrateOptions, migrate, repair};
use portolan_pbstream::ReadLimits;

fn write_all(from: &Path, folder: &Path) -> Result<(), String> {
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    repair(from, &folder.join("repaired.pbstream"), ReadLimits::default()).map_err(|e| failed(&e))?;
    let draft = MapDraft::open(from, ReadLimits::default()).map_err(|e| failed(&e))?;
    draft.write(folder.join("edited.pbstream")).map_err(|e| failed(&e))?;
    let migrated = folder.join("migrated.pbstream");
    migrate(from, &migrated, MigrateOptions::default()).map_err(|e| failed(&e)).map(drop)
}

fn contents(folder: &Path) -> Vec<(std::ffi::OsString, Vec<u8>)> {
    let read = |entry: std::fs::DirEntry| (entry.file_name(), std::fs::read(entry.path()).unwrap());
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| read(e.unwrap())).collect();
    files.sort();
    files
}

// One test, because the disk is that of the whole process.
#[test]
fn a_failing_disk_leaves_complete_files_or_none() {
    let folder = tempfile::tempdir().unwrap();
    let from = folder.path().join("from.pbstream");
    SmallMap::new(true).write(&from);
    let good = folder.path().join("good");
    std::fs::create_dir(&good).unwrap();
    fail_at(u64::MAX, Fault::Full);
    write_all(&from, &good).unwrap();
    let operations = mend();
    let good = contents(&good);
    assert!(operations >= 9 && good.len() == 3, "{operations}");
    for fault in [Fault::Full, Fault::Broken, Fault::BrokenOnce] {
        for at in 0..operations {
            let output = tempfile::tempdir().unwrap();
            std::fs::write(output.path().join("migrated.pbstream"), "of before").unwrap();
            fail_at(at, fault);
            let failed = write_all(&from, output.path()).unwrap_err();
            mend();
            assert!(failed.contains("os error") || failed.contains("space"), "{failed}");
            for (name, bytes) in contents(output.path()) {
                let whole = good.iter().any(|file| *file == (name.clone(), bytes.clone()));
                assert!(whole || bytes == b"of before", "{fault:?} at {at}: {name:?}");
            }
        }
    }
    let output = tempfile::tempdir().unwrap();
    fail_at(0, Fault::InterruptedAndShort);
    write_all(&from, output.path()).unwrap();
    assert!(mend() > 1000);
    assert!(contents(output.path()) == good);
}
