//! Errors of editing a map.

use std::path::PathBuf;

use crate::convert::MapConversionError;
use portolan_geometry::FARTHEST_COORDINATE;
use portolan_pbstream::IdInFile;
use portolan_pbstream::PbstreamError;

/// Errors of editing a map.
#[derive(Debug, thiserror::Error)]
pub enum EditError {
    /// The map could not be written.
    #[error(transparent)]
    Output(PbstreamError),
    /// Reading failed.
    #[error("{}: {source}", path.display())]
    File {
        /// The map.
        path: PathBuf,
        /// Cause.
        source: PbstreamError,
    },
    /// A part of a map cannot be used.
    #[error("{}: {source}", path.display())]
    Content {
        /// The map.
        path: PathBuf,
        /// Cause.
        source: Box<MapConversionError>,
    },
    /// A map that must be repaired first.
    #[error("{}: {reason}; `repair` the map first", path.display())]
    Broken {
        /// The map.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A trajectory is missing.
    #[error("there is no trajectory {id} in the map; it has: {known}")]
    NoTrajectory {
        /// Number asked for.
        id: i32,
        /// Numbers of the existing trajectories.
        known: String,
    },
    /// Two trajectories would have the same number.
    #[error("two trajectories would have the number {0}")]
    SameTrajectory(i32),
    /// A submap or node is missing.
    #[error("there is no {what} {},{} in the map; there are {known}", id.0, id.1)]
    NoPart {
        /// `submap` or `node`.
        what: &'static str,
        /// Id asked for.
        id: IdInFile,
        /// Existing ids.
        known: String,
    },
    /// Nothing would be left.
    #[error("nothing would be left of the map")]
    Empty,
    /// A 2D map together with a 3D map, or a 2D map moved out of its plane.
    #[error("{0}")]
    Dimension(&'static str),
    /// A map moved farther than distances on the Earth: positions would lose precision.
    #[error("a map can be moved by {0:.0} km at most, and to no place farther from its origin", FARTHEST_COORDINATE / 1e3)]
    TooFar,
    /// A part of a map is at coordinates that are not possible on the Earth.
    #[error(
        "a part of the map is {0:.1e} m from its origin, farther than anything on the Earth: remove it first"
    )]
    FarAway(f64),
    /// Maps of different format versions.
    #[error("the maps have the format versions {0} and {1}; `migrate` the older one first")]
    Versions(u32, u32),
    /// A loop closure does not exist.
    #[error("there is no loop closure between submap {},{} and node {},{}", submap.0, submap.1, node.0, node.1)]
    NoLoop {
        /// The submap.
        submap: IdInFile,
        /// The node.
        node: IdInFile,
    },
    /// The node was not found in the submap.
    #[error(
        "node {},{} was not found in submap {},{}: {why}; else give the pose of the node in the submap",
        node.0, node.1, submap.0, submap.1
    )]
    NotFound {
        /// The submap.
        submap: IdInFile,
        /// The node.
        node: IdInFile,
        /// Why it was not found, with its best score if there is one.
        why: String,
    },
    /// The scans of a merged map do not agree on its pose in the other map.
    #[error(
        "{}: its pose in the other map was not found: its scans fit nowhere, or in more than one place (not found: \
         trajectory {})",
        path.display(),
        trajectories.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    )]
    NotPlaced {
        /// The map.
        path: PathBuf,
        /// Its trajectories that could not be placed.
        trajectories: Vec<i32>,
    },
    /// No common direction of walls was found.
    #[error("the map shows no walls of a common direction; give the angle")]
    NoWalls,
    /// The poses could not be optimised.
    #[error("the poses could not be optimised: {0}")]
    Optimization(String),
    /// Imported poses do not belong to the map.
    #[error("{0}")]
    Poses(String),
}
