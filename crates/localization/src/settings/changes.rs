//! How contradictions between a recording and a map are counted (`changes.rs`, `known_cells.rs`,
//! `placed_scan.rs`, `voxel_changes.rs`), and how the recording renews the map (`renewal.rs`,
//! `renewal_3d.rs`).

use portolan_mapping::Replacement;

use super::maps::FREE_BEAM_CLEARANCE;

/// Minimum number of contradicting scans for a cell to count as changed.
pub(crate) const CHANGING_SCANS: u16 = 4;
/// Minimum fraction of contradicting scans among the scans that observe the cell; dimensionless.
pub(crate) const CHANGING_FRACTION: f64 = 0.75;
/// Minimum distance between two viewpoints of the contradicting scans, metres: a person who stands for a
/// moment is seen from one viewpoint.
pub(crate) const VIEWPOINT_DISTANCE: f64 = 1.0;
/// Standard deviation of the position up to which the contradictions of a scan count in 2D, metres.
pub(crate) const CERTAIN_PLACE_2D: f64 = 0.08;
/// Standard deviation of the position up to which the contradictions of a scan count in 3D, metres: less
/// than the edge of the cells in which they are counted.
pub(crate) const CERTAIN_PLACE_3D: f64 = 0.12;

/// Edge of the cells in which contradictions are counted in 2D, metres.
pub(crate) const CHANGE_CELL_2D: f64 = 0.1;
/// Minimum distance of a new object from all that was solid, and distance before the end of a beam from
/// which the beam no longer contradicts solid cells, metres. The errors of scans, walls and poses in the map
/// add up to a third of it ([`CERTAIN_PLACE_2D`] and the 3.5 cm of the map).
pub(crate) const CLEARANCE: f64 = 0.25;
/// Range up to which beams count in 2D, metres: headings of maps and matches are off by 0.008 rad, which is
/// a third of the clearance at this range.
pub(crate) const CHANGE_RANGE_2D: f64 = 10.0;
/// Minimum area of a changed region in 2D, square metres: three cells in a row are an edge that moved with
/// the map's own error.
pub(crate) const LEAST_CHANGED_AREA: f64 = 0.035;

/// Range up to which beams count in 3D, metres: headings of maps and matches are off by 0.008 rad, which is
/// half a cell at this range.
pub(crate) const CHANGE_RANGE_3D: f32 = 12.0;
/// Sine of the angle between beam and surface above which a beam counts as passing through the surface;
/// below it the beam runs along the surface.
pub(crate) const STEEP_SINE: f32 = 0.3;
/// Step along a beam, metres.
pub(crate) const BEAM_STEP: f32 = 0.1;
/// Edge of the voxels to which a scan is thinned before its beams are counted, metres.
pub(crate) const COUNTED_VOXEL: f32 = 0.1;
/// Length to which the beams of kept sweeps are cut, metres.
pub(crate) const KEPT_BEAM: f32 = CHANGE_RANGE_3D + FREE_BEAM_CLEARANCE + 0.1;
/// Edge of the voxels to which kept sweeps are thinned, metres.
pub(crate) const KEPT_VOXEL: f32 = 0.15;
/// Distance between kept sweeps, metres; a rotation to another view also makes a new one.
pub(crate) const KEPT_SWEEP_METRES: f64 = 0.6;
/// Minimum number of cells of a changed region in 3D.
pub(crate) const LEAST_CHANGED_CELLS: usize = 8;
/// Minimum number of columns, seen from above, of a changed region in 3D.
pub(crate) const LEAST_CHANGED_COLUMNS: usize = 3;

/// Edge of the cells in which areas are counted in 2D, metres.
pub(crate) const AREA_CELL: f64 = 0.1;
/// Minimum area unknown to a 2D map that a new submap has to show to be kept, square metres.
pub(crate) const LEAST_NEW_AREA: f64 = 4.0;
/// Maximum area that only the removed submap knows, square metres.
pub(crate) const MAX_AREA_LOST: f64 = 0.1;
/// Rule by which newer submaps replace older ones in 2D. Two submaps show each place, as in local SLAM.
pub(crate) const REPLACEMENT_2D: Replacement = Replacement {
    newest: 2,
    least_seen: 2.0,
    most_alone: MAX_AREA_LOST,
    least_share: 0.0,
    most_share_alone: 0.0,
};
/// The same rule in 3D. Surfaces never fall into quite the same cells again, so fractions of a submap count
/// as well.
pub(crate) const REPLACEMENT_3D: Replacement =
    Replacement { least_share: 0.1, most_share_alone: 0.005, ..REPLACEMENT_2D };
/// Minimum fraction of an older submap that a new submap has to know to replace it, if other submaps know
/// the rest.
pub(crate) const REPLACED_FRACTION: f64 = 0.5;
/// Distance from changed cells within which unknown cells of older submaps are filled too, metres: an object
/// hid its own interior.
pub(crate) const AROUND_CHANGED: f64 = 0.5;
/// Distance from cells that are gone within which points of older scans are removed, metres.
pub(crate) const AROUND_REMOVED: f64 = 0.1;
/// Edge of the cells in which the space unknown to a 3D map is counted, metres. It is so large that a
/// surface counts as new only if the map has none in its cell or in a neighbouring one.
pub(crate) const NEW_CELL: f32 = 0.5;
/// Minimum number of unknown cells ([`NEW_CELL`]) that a new submap has to show to be kept in 3D: 10 m² of
/// surfaces.
pub(crate) const LEAST_NEW_CELLS: usize = 40;
