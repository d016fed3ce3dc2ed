//! Plane or space.

/// Whether mapping happens in the plane or in space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub enum Dimension {
    /// In the plane: planar scans, 2D grids.
    Two,
    /// In space: clouds, hybrid grids.
    Three,
}
