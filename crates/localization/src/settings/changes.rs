//! Where a recording contradicts a map (`changes.rs`, `known_cells.rs`, `placed_scan.rs`, `voxel_changes.rs`), and how the map is
//! renewed by it (`renewal.rs`, `renewal_3d.rs`).

use portolan_mapping::Replacement;

use super::maps::FREE_BEAM_CLEARANCE;

/// A cell has changed if so many scans say so, …
pub(crate) const CHANGING_SCANS: u16 = 4;
/// … this fraction of those that say anything, …
pub(crate) const CHANGING_FRACTION: f64 = 0.75;
/// … from two places at least so far apart, metres: somebody who stands for a moment is seen from one place.
pub(crate) const VIEWPOINTS: f64 = 1.0;
/// The standard deviation to which a place is certain enough for contradictions to count there in 2D, metres …
pub(crate) const CERTAIN_PLACE_2D: f64 = 0.08;
/// … and in 3D: less than the cells in which they are counted.
pub(crate) const CERTAIN_PLACE_3D: f64 = 0.12;

/// Edge of the cells in which contradictions are counted in 2D, metres.
pub(crate) const CHANGE_CELL_2D: f64 = 0.1;
/// So far, metres, what is new lies from all that was solid, and beams go on behind what is gone: scans, walls and their places in the
/// map err together by a third of it ([`CERTAIN_PLACE_2D`] and the 3.5 cm of the map).
pub(crate) const CLEARANCE: f64 = 0.25;
/// Beams count to this range in 2D, metres: headings of maps and matches err by 0.008 rad, a third of the clearance there.
pub(crate) const CHANGE_RANGE_2D: f64 = 10.0;
/// Smaller regions are left out in 2D, square metres: three cells in a row are an edge that moved with the map's own error.
pub(crate) const LEAST_CHANGED_AREA: f64 = 0.035;

/// Beams count to this range in 3D, metres: headings of maps and matches err by 0.008 rad, half a cell there.
pub(crate) const CHANGE_RANGE_3D: f32 = 12.0;
/// A beam goes through a surface if it meets it more steeply than this, as the sine of the angle; else it goes along it.
pub(crate) const STEEP_SINE: f32 = 0.3;
/// Steps along a beam, metres …
pub(crate) const BEAM_STEP: f32 = 0.1;
/// … and voxels to which scans are thinned.
pub(crate) const COUNTED_VOXEL: f32 = 0.1;
/// Of beams that are kept no more than this counts, metres.
pub(crate) const KEPT_BEAM: f32 = CHANGE_RANGE_3D + FREE_BEAM_CLEARANCE + 0.1;
/// Voxels to which sweeps that are kept are thinned, metres.
pub(crate) const KEPT_VOXEL: f32 = 0.15;
/// Sweeps are kept so far apart, metres, or where they show another view.
pub(crate) const KEPT_SWEEP_METRES: f64 = 0.6;
/// Smaller regions are left out in 3D, cells in all …
pub(crate) const LEAST_CHANGED_CELLS: usize = 8;
/// … and seen from above.
pub(crate) const LEAST_CHANGED_COLUMNS: usize = 3;

/// Edge of the cells in which areas are counted in 2D, metres.
pub(crate) const AREA_CELL: f64 = 0.1;
/// A submap that shows less than this of what a 2D map does not know is not worth its size, square metres.
pub(crate) const LEAST_NEW_AREA: f64 = 4.0;
/// What only a submap that is removed knows, at most, square metres.
pub(crate) const MOST_ALONE: f64 = 0.1;
/// Two submaps show each place, as local SLAM draws them.
pub(crate) const REPLACEMENT_2D: Replacement = Replacement {
    newest: 2,
    least_seen: 2.0,
    most_alone: MOST_ALONE,
    least_share: 0.0,
    most_share_alone: 0.0,
};
/// The same in 3D: surfaces are never met in quite the same cells again, so that fractions of a submap count as well.
pub(crate) const REPLACEMENT_3D: Replacement =
    Replacement { least_share: 0.1, most_share_alone: 0.005, ..REPLACEMENT_2D };
/// A submap replaces an older one of which it knows at least this fraction, if other submaps know the rest.
pub(crate) const REPLACED_FRACTION: f64 = 0.5;
/// What has changed is drawn into older submaps with what they do not know so far around, metres: what stood somewhere hid what is
/// inside of it.
pub(crate) const AROUND_CHANGED: f64 = 0.5;
/// Points of older scans lie beside cells that are gone, metres.
pub(crate) const BESIDE_GONE: f64 = 0.1;
/// Edge of the cells in which is counted what a 3D map does not know, metres: no surface is in a cell, or beside one, by chance.
pub(crate) const NEW_CELL: f32 = 0.5;
/// A submap that shows fewer of them is not worth its size: 10 m² of surfaces.
pub(crate) const LEAST_NEW_CELLS: usize = 40;
