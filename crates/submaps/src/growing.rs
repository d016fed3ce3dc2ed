//! What submaps of either dimension have in common while they grow.

use portolan_geometry::{Point3f, Rigid3};

/// A submap that takes scans.
pub trait GrowingSubmap {
    /// What a scan is inserted as.
    type Scan;
    /// Pose in the local map.
    fn local_from_submap(&self) -> Rigid3;
    /// Scans inserted so far.
    fn num_range_data(&self) -> u32;
    /// Where the scan was taken, in the local map.
    fn scan_origin_in_local(scan: &Self::Scan) -> Point3f;
    /// Inserts a scan given in the local map. False if it could not be drawn, because the grid would have
    /// become too large.
    fn insert(&mut self, scan: &Self::Scan) -> bool;
    /// No more scans will come: makes it ready for searching.
    fn finish(&mut self);
}
