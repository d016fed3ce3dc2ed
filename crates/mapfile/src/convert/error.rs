//! Errors of conversion between files and maps in memory.

use portolan_grids::GridError;
use portolan_sensor::CompressedPointCloudError;

use portolan_pbstream::IdInFile;
use portolan_pbstream::PbstreamError;

/// Why a map could not be read from a file or written to one.
#[derive(Debug, thiserror::Error)]
pub enum MapConversionError {
    /// The file cannot be read or written.
    #[error(transparent)]
    File(#[from] PbstreamError),
    /// A 3D map instead of a 2D map.
    #[error("this is a 3D map, and a 2D map is wanted; a 3D map is continued with a 3D recording")]
    ThreeD,
    /// A 2D map instead of a 3D map.
    #[error("2D map where a 3D map is wanted")]
    TwoD,
    /// A trajectory occurs twice.
    #[error("the map has trajectory {0} twice; `repair` keeps one of them")]
    DuplicateTrajectory(i32),
    /// A requested trajectory is missing.
    #[error("the map has no trajectory {0}")]
    NoSuchTrajectory(i32),
    /// A negative id in a file, or one in memory that a file cannot hold.
    #[error("the {what} ({}, {}) has an id that is not possible", .id.0, .id.1)]
    Id {
        /// Kind of part: node, submap, …
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
    },
    /// The number of a trajectory, node or submap in memory that a file cannot hold.
    #[error("a map file cannot hold {0} as the number of a trajectory, node or submap")]
    IdTooLarge(u32),
    /// A pose that is missing, not finite or has no valid rotation.
    #[error(
        "the {what} ({}, {}) has a pose that is missing or not valid; `repair` leaves it out",
        .id.0, .id.1
    )]
    Pose {
        /// Kind of part: node, submap, …
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
    },
    /// A pose at coordinates that are not possible on the Earth.
    #[error(
        "the {what} ({}, {}) is {metres:.1e} m from the origin of the map, farther than anything on the Earth; \
         `portolan edit` removes such parts",
        .id.0, .id.1
    )]
    FarAway {
        /// Kind of part: node or submap.
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
        /// Distance from the origin of the map, metres.
        metres: f64,
    },
    /// A part without its content.
    #[error("the {what} ({}, {}) has no content; `repair` leaves it out", .id.0, .id.1)]
    Content {
        /// Kind of part: node or submap.
        what: &'static str,
        /// Trajectory and index.
        id: IdInFile,
    },
    /// A grid of unknown type.
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
    /// An invalid grid.
    #[error("submap ({}, {}): {source}", .submap.0, .submap.1)]
    Grid {
        /// The submap.
        submap: IdInFile,
        /// Cause.
        source: GridError,
    },
    /// A point cloud that cannot be compressed or decompressed.
    #[error("node ({}, {}): {source}", .node.0, .node.1)]
    PointCloud {
        /// The node.
        node: IdInFile,
        /// Cause.
        source: CompressedPointCloudError,
    },
}
