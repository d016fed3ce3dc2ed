//! What a known map consists of and how accurate it is assumed to be (`known_map_2d.rs`, `known_map_3d.rs`,
//! `occupancy.rs`, `along.rs`, `own_scans.rs`).

use crate::belief::MapError;

/// Maximum number of cells of the fused 2D grid: 290 m by 290 m at 5 cm. Larger maps get larger cells, which
/// bounds memory.
pub(crate) const MOST_GRID_CELLS: f64 = (1 << 25) as f64;
/// Edge of the cells in which places are proposed in 2D, and to which the joint cloud for that search is
/// thinned, metres (docs/experiments/2026-11-localise.md).
pub(crate) const COARSE_CELL: f64 = 0.2;
/// Limit of the log odds of a cell, to either side: a probability of 0.9. Further evidence changes nothing.
pub(crate) const MOST_LOG_ODDS: f32 = 2.197_224_6;
/// Log odds assigned to a cell of a distance field (TSDF) that is not at a surface.
pub(crate) const DISTANCE_FIELD_FREE_LOG_ODDS: f32 = -1.0;

/// Edge of the largest voxels of planes, metres.
pub(crate) const PLANE_VOXEL: f32 = 1.0;
/// Edge of the occupancy cells (solid, free, unknown) of 3D maps, metres.
pub(crate) const OCCUPANCY_CELL: f32 = 0.2;
/// Probability below which a cell of a 3D submap counts as free, unless something solid is near: the object
/// that was there is gone.
pub(crate) const GONE_PROBABILITY: f32 = 0.12;
/// Range up to which beams of nodes mark free space, metres.
pub(crate) const FREE_BEAM_RANGE: f32 = 25.0;
/// Distance in front of the hit at which a beam stops marking free space, metres: floors are met at grazing
/// incidence.
pub(crate) const FREE_BEAM_CLEARANCE: f32 = 0.8;
/// Probability below which a cell is not used to find the position along streets.
pub(crate) const SOLID_ALONG_PROBABILITY: f32 = 0.5;

/// Number of nodes whose scans are matched to their own map, to measure its error and its fraction explained
/// by chance. They are evenly spaced over all nodes (docs/experiments/2026-11-starts-in-3d-maps.md).
pub(crate) const OWN_SCANS: usize = 48;
/// Upper limit of the fraction of a scan that a map is taken to explain by chance; dimensionless.
pub(crate) const MOST_CHANCE_FRACTION: f32 = 0.9;
/// Fraction of a scan explained by chance if no node has points, so that it cannot be measured;
/// dimensionless.
pub(crate) const USUAL_CHANCE_FRACTION: f32 = 0.6;
/// Error of a map where it cannot be measured, as standard deviations: about the deformation, within a few
/// metres, of maps made of the halves of real 2D logs against maps of the whole logs. The errors measured
/// from 3D maps themselves were 0.006 to 0.039 m (docs/experiments/2026-11-starts-in-3d-maps.md).
pub(crate) const USUAL_MAP_ERROR: MapError = MapError { metres: 0.035, radians: 0.008 };
/// Lower limit of the error of a map. The translation is about what range noise leaves. The rotation moves a
/// point at ten metres by two centimetres: a wrong motion during a sweep rotates all its points alike, and
/// neither their scatter nor that of other scans shows it (docs/experiments/2026-11-honest-covariance.md).
pub(crate) const LEAST_MAP_ERROR: MapError = MapError { metres: 0.005, radians: 0.002 };
/// Upper limit of the error of a map, metres and radians.
pub(crate) const MOST_MAP_ERROR: f64 = 1.0;
