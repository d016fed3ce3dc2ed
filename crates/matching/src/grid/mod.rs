//! Occupancy on regular grids: value codes, the planar grids and what is drawn into them.
//!
//! Planar cell indices run against the axes of the map: the first one along −y, the second along −x,
//! starting at the corner with the largest coordinates.

mod cells;
mod error;
mod insert_probability;
mod insert_tsdf;
mod limits;
mod normals;
mod parts;
mod planar;
mod probability;
mod ray;
mod texture;
mod tsdf;
pub mod value;

pub use error::{GridError, InserterOptionError};
pub use insert_probability::{InsertReport, ProbabilityInserter, ProbabilityInserterOptions};
pub use insert_tsdf::{TsdfInserter, TsdfInserterOptions};
pub use limits::{CellBox, CellIndex, MapLimits, lround};
pub use normals::{NormalEstimationOptions, estimate_normals, sort_by_direction};
pub use parts::{GridParts, GridRepairs, TsdfParts};
pub use planar::Grid2d;
pub use probability::ProbabilityGrid;
pub use ray::for_each_cell_on_ray;
pub use texture::Texture;
pub use tsdf::Tsdf2d;

pub(crate) use cells::CellGrid;
pub(crate) use insert_probability::is_finite;
