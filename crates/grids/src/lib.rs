#![doc = include_str!("../README.md")]

mod cells;
mod error;
mod grid_2d;
mod hybrid;
mod hybrid_parts;
mod insert_hybrid;
mod insert_probability;
mod insert_sectors;
mod insert_tsdf;
mod intensity;
mod joined_surfaces;
mod limits;
mod match_spread;
mod normals;
mod parts;
mod probability;
mod ray;
mod scan_agreement;
mod texture;
mod thresholds;
mod tsdf;
pub mod value;
mod voxel_map;
mod voxel_order;

#[cfg(test)]
extern crate self as portolan_grids;
#[cfg(test)]
#[path = "../tests/common/mod.rs"]
#[allow(dead_code)]
mod testing;

pub use error::{GridError, InserterOptionError};
pub use grid_2d::{CellValue, Grid2d};
pub use hybrid::{HybridGrid, VoxelLattice};
pub use hybrid_parts::{HybridGridParts, HybridGridRepairs};
pub use insert_hybrid::{HybridInserter, HybridInserterOptions};
pub use insert_probability::{InsertReport, ProbabilityInserter, ProbabilityInserterOptions, is_finite};
pub use insert_sectors::{SectorInserter, beam_spacing};
pub use insert_tsdf::{TsdfInserter, TsdfInserterOptions};
pub use intensity::{Average, IntensityGrid};
pub use limits::{CellBox, CellIndex, MapLimits, lround};
pub use match_spread::{MatchSpread, match_spread};
pub use normals::{NormalEstimationOptions, estimate_normals, sort_by_direction};
pub use parts::{GridParts, GridRepairs, TsdfParts};
pub use probability::ProbabilityGrid;
pub use ray::for_each_cell_on_ray;
pub use scan_agreement::{
    BeamEnd, ScanAgreement, beam_ends, ends_in_the_open, is_at_solid, mean_of_solid_cells, scan_agreement,
    score_difference,
};
pub use texture::Texture;
pub use thresholds::{FREE_CELL, SOLID_CELL, SOLID_VOXEL, SURFACE_CELLS};
pub use tsdf::Tsdf2d;
pub use voxel_map::{MAX_VOXEL_INDEX, VoxelIndex, VoxelMap};

pub(crate) use cells::CellGrid;
