//! Thresholds of occupied ("solid") and free cells.

/// Probability above which cells of 2D grids are solid.
pub const SOLID_CELL: f32 = 0.6;

/// Probability below which known cells of 2D grids are free.
pub const FREE_CELL: f32 = 0.4;

/// Distance to the surface, in cells, below which cells of a 2D grid of signed distances are solid.
pub const SURFACE_CELLS: f32 = 0.75;

/// Probability above which cells of hybrid grids are solid.
pub const SOLID_VOXEL: f32 = 0.55;
