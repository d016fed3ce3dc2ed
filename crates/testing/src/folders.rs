//! Paths of the repository and its build folder.

use std::path::{Path, PathBuf};

/// The folder of the repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The build folder (`target`), found from the running test program.
pub fn target() -> PathBuf {
    let program = std::env::current_exe().unwrap_or_default();
    let deps = program.ancestors().find(|folder| folder.ends_with("deps"));
    // target/debug/deps
    let target = deps.and_then(Path::parent).and_then(Path::parent);
    target.map_or_else(|| repository().join("target"), Path::to_owned)
}
