//! Common interface of 2D and 3D submaps while they grow.

use portolan_geometry::{Point3f, Rigid3};

/// A submap that takes scans.
pub trait GrowingSubmap {
    /// Type of the scans that are inserted.
    type Scan;
    /// Pose in the local map.
    fn local_from_submap(&self) -> Rigid3;
    /// Scans inserted so far.
    fn num_range_data(&self) -> u32;
    /// Position of the scanner, in the local map.
    fn scan_origin_in_local(scan: &Self::Scan) -> Point3f;
    /// Inserts a scan given in the local map. False if it could not be inserted, because the grid would have
    /// become too large.
    fn insert(&mut self, scan: &Self::Scan) -> bool;
    /// Completes the submap: no more scans follow, and it becomes ready for searching.
    fn finish(&mut self);
}
