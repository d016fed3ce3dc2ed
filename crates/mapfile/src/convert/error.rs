//! What can go wrong between files and maps.

use portolan_grids::GridError;
use portolan_sensor::CompressedPointCloudError;

use portolan_pbstream::IdInFile;
use portolan_pbstream::PbstreamError;

/// Why a map could not be read from a file or written to one.
#[derive(Debug, thiserror::Error)]
pub enum MapConversionError {
    /// The file itself.
    #[error(transparent)]
    File(#[from] PbstreamError),
    /// A 3D map where a 2D map is wanted.
    #[error("this is a 3D map, and a 2D map is wanted; a 3D map is continued with a 3D recording")]
    ThreeD,
    /// A 2D map where a 3D map is wanted.
    #[error("2D map where a 3D map is wanted")]
    TwoD,
    /// A trajectory twice.
    #[error("the map has trajectory {0} twice; `repair` keeps one of them")]
    DuplicateTrajectory(i32),
    /// A trajectory that was asked for.
    #[error("the map has no trajectory {0}")]
    NoSuchTrajectory(i32),
    /// A negative id in a file, or one in memory that a file cannot hold.
    #[error("the {what} ({}, {}) has an id that is not possible", .id.0, .id.1)]
    Id {
        /// What has it.
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
    },
    /// A trajectory in memory with a number that a file cannot hold.
    #[error("a map file cannot hold {0} as the number of a trajectory, node or submap")]
    IdTooLarge(u32),
    /// A pose that is missing, not finite or no rotation.
    #[error(
        "the {what} ({}, {}) has a pose that is missing or not valid; `repair` leaves it out",
        .id.0, .id.1
    )]
    Pose {
        /// What has it.
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
    },
    /// A place that is not on the Earth.
    #[error(
        "the {what} ({}, {}) lies {metres:.1e} m from the origin of the map, farther than anything on the Earth; \
         `portolan edit` takes such parts out",
        .id.0, .id.1
    )]
    FarAway {
        /// What lies there.
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
        /// How far.
        metres: f64,
    },
    /// Something without its content.
    #[error("the {what} ({}, {}) has no content; `repair` leaves it out", .id.0, .id.1)]
    Content {
        /// What lacks it.
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
    },
    /// A grid of a kind that is not known.
    #[error("proto::Submap2D has grid with unknown type. (submap ({}, {}))", .0.0, .0.1)]
    GridType(IdInFile),
    /// A cell that does not fit 16 bits.
    #[error("submap ({}, {}) has the cell value {value}, which is outside of 0 to 65535", .submap.0, .submap.1)]
    CellValue {
        /// The submap.
        submap: IdInFile,
        /// The value.
        value: i32,
    },
    /// A grid that cannot be.
    #[error("submap ({}, {}): {source}", .submap.0, .submap.1)]
    Grid {
        /// The submap.
        submap: IdInFile,
        /// What is wrong.
        source: GridError,
    },
    /// A point cloud that cannot be packed or unpacked.
    #[error("node ({}, {}): {source}", .node.0, .node.1)]
    PointCloud {
        /// The node.
        node: IdInFile,
        /// What is wrong.
        source: CompressedPointCloudError,
    },
}
