//! What can go wrong with files of point clouds.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Why a cloud could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum CloudError {
    /// The file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is of no known format.
    #[error("{} is no point cloud that Portolan knows: {detail}", path.display())]
    UnknownFormat {
        /// Which file.
        path: PathBuf,
        /// What was found, and what is known.
        detail: String,
    },
    /// The file does not keep to its format.
    #[error("{} is damaged or unusual: {detail}", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// Points or options that the format cannot hold.
    #[error("cannot write {}: {detail}", path.display())]
    Unwritable {
        /// Which file.
        path: PathBuf,
        /// Why, and what to do.
        detail: String,
    },
    /// The size of voxels makes no sense.
    #[error("voxels must be 0.0001 to 1000 m large, not {0}")]
    VoxelSize(f64),
    /// A temporary file could not be written or read.
    #[error("a temporary file in {} failed: {source}", folder.display())]
    Temporary {
        /// The folder it is in.
        folder: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl CloudError {
    pub(crate) fn damaged(path: &Path, detail: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_owned(), detail: detail.into() }
    }

    pub(crate) fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { path: path.to_owned(), source }
    }

    /// A temporary file in `folder` could not be written or read.
    pub fn temporary(folder: &Path, source: std::io::Error) -> Self {
        Self::Temporary { folder: folder.to_owned(), source }
    }

    pub(crate) fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.to_owned(), source }
    }
}

/// Something that was repaired or left out while reading: counted, never silent.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Repair {
    /// What was wrong and what was done about it.
    pub what: String,
    /// How often.
    pub count: u64,
    /// Whether data were lost by it.
    pub lost_data: bool,
}

/// Counts repairs by kind.
#[derive(Clone, Debug, Default)]
pub(crate) struct Repairs(BTreeMap<(&'static str, bool), u64>);

impl Repairs {
    pub fn add(&mut self, what: &'static str, lost_data: bool, count: u64) {
        if count > 0 {
            let counted = self.0.entry((what, lost_data)).or_default();
            *counted = counted.saturating_add(count);
        }
    }

    pub fn list(&self) -> Vec<Repair> {
        let repair = |((what, lost_data), count): (&(&str, bool), &u64)| Repair {
            what: (*what).to_owned(),
            count: *count,
            lost_data: *lost_data,
        };
        self.0.iter().map(repair).collect()
    }
}

/// Counted for points whose coordinates are not numbers.
pub(crate) const NOT_FINITE: &str = "points whose coordinates are not numbers were left out";
