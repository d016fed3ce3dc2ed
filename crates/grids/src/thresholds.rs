//! From which probabilities on cells count as solid and as free.

/// Cells of 2D grids of a larger probability are solid.
pub const SOLID_CELL: f32 = 0.6;

/// Known cells of 2D grids of a smaller probability are free.
pub const FREE_CELL: f32 = 0.4;

/// In a 2D grid of signed distances cells nearer to a surface than so many cells are solid.
pub const SURFACE_CELLS: f32 = 0.75;

/// Cells of hybrid grids of a larger probability are solid.
pub const SOLID_VOXEL: f32 = 0.55;
