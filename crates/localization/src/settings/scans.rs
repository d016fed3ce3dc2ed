//! What is kept of scans (`scan_2d.rs`, `scan_3d.rs`, `recent.rs`, `paired.rs`).

/// Scans are kept after this way, metres …
pub(crate) const KEPT_SCAN_METRES: f64 = 0.4;
/// … or after a turn that shows other things, radians. Two matches are independent after such a turn, too, and of sweeps that are
/// kept to renew a map so much is another view.
pub(crate) const NEW_VIEW_RADIANS: f64 = 0.35;
/// So many scans of the recent way are kept.
pub(crate) const KEPT_SCANS: usize = 12;

/// Points of a 2D scan are thinned to voxels of this edge, metres …
pub(crate) const VOXEL_2D: f32 = 0.1;
/// … and to this number.
pub(crate) const MOST_POINTS_2D: usize = 180;
/// Points of the joint cloud of all kept 2D scans, at most.
pub(crate) const MOST_JOINT_POINTS_2D: usize = 320;

/// Points of a 3D scan are thinned to voxels of this edge, metres …
pub(crate) const VOXEL_3D: f32 = 0.25;
/// … and for registration to this number.
pub(crate) const MOST_POINTS_3D: usize = 600;
/// Points that judge places in 3D lie in this range, metres, …
pub(crate) const JUDGED_RANGE: f32 = 18.0;
/// … are chosen evenly over slices of this height, metres, because floors fit anywhere, …
pub(crate) const JUDGED_SLICE: f32 = 0.3;
/// … and are so many at most.
pub(crate) const MOST_JUDGED_POINTS: usize = 220;
/// The joint cloud of all kept 3D scans reaches so far, metres.
pub(crate) const JOINT_RANGE_3D: f32 = 30.0;
/// Its points for registration, at most.
pub(crate) const MOST_JOINT_POINTS_3D: usize = 900;
/// Its points that tell the place along streets, at most.
pub(crate) const MOST_THINNED_JOINT_POINTS: usize = 8000;

/// Neighbouring beams and scans after each other see the same things: what ends in one cell of this edge, metres, counts once
/// (docs/experiments/2026-11-believing-places.md).
pub(crate) const PAIRED_CELL: f32 = 1.0;
/// More than this fraction of the points in a cell speak for one of two places, or lie where the map knows nothing.
pub(crate) const PAIRED_MAJORITY: f32 = 0.5;
