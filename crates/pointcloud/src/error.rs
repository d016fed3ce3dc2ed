//! Errors of files of point clouds.

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
        /// What was found, and which formats are known.
        detail: String,
    },
    /// The file violates its format.
    #[error("{} is damaged or unusual: {detail}", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// The format cannot hold these points or options.
    #[error("cannot write {}: {detail}", path.display())]
    Unwritable {
        /// Which file.
        path: PathBuf,
        /// Why, and what to do.
        detail: String,
    },
    /// The size of voxels is out of range.
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
