//! What a known map is made of, and how well it is known (`known_map_2d.rs`, `known_map_3d.rs`, `occupancy.rs`, `along.rs`,
//! `own_scans.rs`).

use crate::belief::MapError;

/// Cells of the one grid, at most: 290 m by 290 m at 5 cm. Larger maps get larger cells, which bounds memory.
pub(crate) const MOST_GRID_CELLS: f64 = (1 << 25) as f64;
/// Edge of the cells in which places are proposed in 2D, and to which the joint cloud that is searched for is thinned, metres
/// (docs/experiments/2026-11-localise.md).
pub(crate) const COARSE_CELL: f64 = 0.2;
/// Evidence of a cell beyond this adds nothing, as log odds: a probability of 0.9.
pub(crate) const MOST_LOG_ODDS: f32 = 2.197_224_6;
/// What a distance field says of a cell that is not a surface, as log odds.
pub(crate) const DISTANCE_FIELD_FREE_LOG_ODDS: f32 = -1.0;

/// Edge of the largest voxels of planes, metres.
pub(crate) const PLANE_VOXEL: f32 = 1.0;
/// Edge of the cells of 3D maps that tell what is solid and what is free, metres.
pub(crate) const OCCUPANCY_CELL: f32 = 0.2;
/// Cells of 3D submaps of less than this probability are free, if nothing solid is near: what was there is gone.
pub(crate) const GONE_PROBABILITY: f32 = 0.12;
/// Beams of nodes show free space to this range, metres.
pub(crate) const FREE_BEAM_RANGE: f32 = 25.0;
/// Beams show free space up to so far in front of what they hit, metres: floors are met at grazing angles.
pub(crate) const FREE_BEAM_CLEARANCE: f32 = 0.8;
/// Cells that are less probable than this say nothing of the place along streets.
pub(crate) const SOLID_ALONG_PROBABILITY: f32 = 0.5;

/// So many nodes are asked what the map says to its own scans, evenly from all of them
/// (docs/experiments/2026-11-starts-in-3d-maps.md).
pub(crate) const OWN_SCANS: usize = 48;
/// The fraction of a scan that is explained by chance is taken for no more than this …
pub(crate) const MOST_CHANCE_FRACTION: f32 = 0.9;
/// … and for this if no node has points.
pub(crate) const USUAL_CHANCE_FRACTION: f32 = 0.6;
/// What a map is off by, as standard deviations, where it does not tell: about what maps of the halves of real 2D logs are bent
/// against those of the whole within a few metres. What 3D maps tell themselves was 0.006 to 0.039 m
/// (docs/experiments/2026-11-starts-in-3d-maps.md).
pub(crate) const USUAL_MAP_ERROR: MapError = MapError { metres: 0.035, radians: 0.008 };
/// No map is known better than this: about what the noise of ranges leaves; and turns two centimetres at ten metres. What a wrong
/// motion during a sweep does to all of it at once turns its points alike, and neither their scatter nor that of other scans shows
/// it (docs/experiments/2026-11-honest-covariance.md).
pub(crate) const LEAST_MAP_ERROR: MapError = MapError { metres: 0.005, radians: 0.002 };
/// No map is told to be worse, metres and radians.
pub(crate) const MOST_MAP_ERROR: f64 = 1.0;
