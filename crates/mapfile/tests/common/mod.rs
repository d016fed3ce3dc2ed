//! What several integration tests need.
#![allow(dead_code, clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

pub mod small_map;

use std::path::PathBuf;

/// A file or folder of the shared test data; none, and a word on stderr, where it is missing.
pub fn shared(path: &str) -> Option<PathBuf> {
    let root = std::env::var_os("PORTOLAN_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let full = root.join(path);
    if full.exists() {
        return Some(full);
    }
    assert!(std::env::var_os("CI").is_none(), "shared test data is missing: {}", full.display());
    eprintln!("skipped: {} is missing", full.display());
    None
}

/// All maps of the shared test data, in order of their names.
pub fn all_maps() -> Vec<PathBuf> {
    let mut maps = Vec::new();
    for folder in ["data/maps/reference", "data/maps/wild", "spec/testdata"] {
        let Some(folder) = shared(folder) else { continue };
        let files = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        maps.extend(files.filter(|p| p.extension().is_some_and(|e| e == "pbstream")));
    }
    maps.sort();
    maps
}
