//! What several integration tests need.
#![allow(dead_code, clippy::unwrap_used, clippy::panic)]

pub mod small_map;

use std::path::PathBuf;

use portolan_testing::{real_data, spec_data};

/// All maps of the real data, in order of their names.
pub fn all_maps() -> Vec<PathBuf> {
    let mut maps = Vec::new();
    let folders = [real_data("maps/reference"), real_data("maps/wild"), spec_data("")];
    for folder in folders.into_iter().flatten() {
        let files = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        maps.extend(files.filter(|p| p.extension().is_some_and(|e| e == "pbstream")));
    }
    maps.sort();
    maps
}
