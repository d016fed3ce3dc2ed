//! 2D or 3D.

/// Whether mapping happens in 2D or in 3D.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub enum Dimension {
    /// In 2D: planar scans, 2D grids.
    #[serde(rename = "Two")]
    TwoD,
    /// In 3D: clouds, hybrid grids.
    #[serde(rename = "Three")]
    ThreeD,
}
