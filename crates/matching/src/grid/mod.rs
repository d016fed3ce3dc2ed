//! Occupancy on regular grids: value codes, the planar grids and what is drawn into them.
//!
//! Planar cell indices run against the axes of the map: the first one along −y, the second along −x,
//! starting at the corner with the largest coordinates. Indices in 3D run along the axes, from the
//! origin.

mod cells;
mod error;
mod hybrid;
mod hybrid_parts;
mod insert_hybrid;
mod insert_probability;
mod insert_sectors;
mod insert_tsdf;
mod intensity;
mod limits;
mod normals;
mod parts;
mod planar;
mod probability;
mod ray;
mod scan_agreement;
mod texture;
mod tsdf;
pub mod value;
mod voxel_map;

pub use error::{GridError, InserterOptionError};
pub use hybrid::HybridGrid;
pub use hybrid_parts::{HybridGridParts, HybridGridRepairs};
pub use insert_hybrid::{HybridInserter, HybridInserterOptions};
pub use insert_probability::{InsertReport, ProbabilityInserter, ProbabilityInserterOptions};
pub use insert_sectors::{SectorInserter, beam_spacing};
pub use insert_tsdf::{TsdfInserter, TsdfInserterOptions};
pub use intensity::IntensityGrid;
pub use limits::{CellBox, CellIndex, MapLimits, lround};
pub use normals::{NormalEstimationOptions, estimate_normals, sort_by_direction};
pub use parts::{GridParts, GridRepairs, TsdfParts};
pub use planar::{CellValue, Grid2d};
pub use probability::ProbabilityGrid;
pub use ray::for_each_cell_on_ray;
pub use scan_agreement::{ScanAgreement, mean_of_solid_cells, scan_agreement, score_difference};
pub use texture::Texture;
pub use tsdf::Tsdf2d;
pub use voxel_map::{MAX_VOXEL_INDEX, VoxelIndex};

pub(crate) use cells::CellGrid;
pub(crate) use hybrid::VoxelLattice;
pub(crate) use insert_probability::is_finite;
pub(crate) use intensity::Average;
pub(crate) use voxel_map::VoxelMap;
