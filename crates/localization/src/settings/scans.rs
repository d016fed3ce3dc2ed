//! Which scans and points are kept (`scan_2d.rs`, `scan_3d.rs`, `recent.rs`, `paired.rs`).

/// Distance between kept scans, metres.
pub(crate) const KEPT_SCAN_METRES: f64 = 0.4;
/// Rotation after which a scan shows another view, radians: it is then kept. Two matches are also
/// independent after such a rotation, and another sweep is kept to renew the map.
pub(crate) const NEW_VIEW_RADIANS: f64 = 0.35;
/// Maximum number of recent scans that are kept.
pub(crate) const KEPT_SCANS: usize = 12;

/// Edge of the voxels to which a 2D scan is thinned, metres.
pub(crate) const VOXEL_2D: f32 = 0.1;
/// Maximum number of points of a 2D scan.
pub(crate) const MOST_POINTS_2D: usize = 180;
/// Maximum number of points of the joint cloud of all kept 2D scans.
pub(crate) const MOST_JOINT_POINTS_2D: usize = 320;

/// Edge of the voxels to which a 3D scan is thinned, metres.
pub(crate) const VOXEL_3D: f32 = 0.25;
/// Maximum number of points of a 3D scan for registration.
pub(crate) const MOST_POINTS_3D: usize = 600;
/// Range of the points that judge places in 3D, metres.
pub(crate) const JUDGED_RANGE: f32 = 18.0;
/// Height of the slices over which points that judge places in 3D are evenly distributed, metres: points on
/// floors fit anywhere.
pub(crate) const JUDGED_SLICE: f32 = 0.3;
/// Maximum number of points that judge places in 3D.
pub(crate) const MOST_JUDGED_POINTS: usize = 220;
/// Range of the joint cloud of all kept 3D scans, metres.
pub(crate) const JOINT_RANGE_3D: f32 = 30.0;
/// Maximum number of points of the joint cloud for registration.
pub(crate) const MOST_JOINT_POINTS_3D: usize = 900;
/// Maximum number of points of the joint cloud for the search along streets.
pub(crate) const MOST_THINNED_JOINT_POINTS: usize = 8000;

/// Edge of the cells in which the ends of beams count once when two places are compared, metres:
/// neighbouring beams and consecutive scans see the same objects
/// (docs/experiments/2026-11-believing-places.md).
pub(crate) const PAIRED_CELL: f32 = 1.0;
/// Fraction of the points in a cell above which the cell counts for one of two places, or as unknown to the
/// map; dimensionless.
pub(crate) const PAIRED_MAJORITY: f32 = 0.5;
