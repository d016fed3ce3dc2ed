//! What a saved map has to be able to for scans to be found in it: what differs between the plane and space.

use portolan_geometry::Rigid3;
use portolan_grids::{GridError, ScanAgreement};
use portolan_mapping::{NodeData, PoseGraph, Space, TrajectoryId};
use portolan_matching::MatcherOptionError;
use portolan_sensor::PointCloud;

use crate::belief::{Freedom, Matrix6};
use crate::changes::ChangeGrid;
use crate::recent::RecentScans;
use crate::renewal::Renewal;

/// Why a map cannot be localised in.
#[derive(Debug, thiserror::Error)]
pub enum KnownMapError {
    /// There is nothing in it.
    #[error("the map is empty: it has no submap")]
    Empty,
    /// Submaps without grids: somebody removed them, or the file is damaged.
    #[error("the map has {0} submaps, but not one with a grid: there is nothing to find scans in")]
    NoGrids(usize),
    /// Grids in which nothing is solid.
    #[error("nothing in the map is solid: its grids show no wall to find scans by")]
    NoWalls,
    /// A grid cannot be made.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// A matcher cannot be made.
    #[error(transparent)]
    Matcher(#[from] MatcherOptionError),
}

/// How far around a guess a scan is searched, metres and radians to either side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Along each axis.
    pub metres: f64,
    /// About each axis.
    pub radians: f64,
}

/// Where earlier scans of the way are looked for.
pub(crate) const ON_THE_WAY: Window = Window { metres: 0.1, radians: 0.03 };

/// A scan found in the map.
#[derive(Clone, Copy, Debug)]
pub struct ScanMatch {
    /// `map_from_scan`.
    pub pose: Rigid3,
    /// Information of the pose; nothing along directions that the scan leaves open.
    pub information: Matrix6,
    /// What the map says to the scan there.
    pub agreement: ScanAgreement,
}

/// A saved map in which scans can be found.
///
/// Frames of scans are level: z points up as in the local map, the origin is that of the tracking frame, in the plane at
/// height 0.
pub trait KnownMap: Sized + Send + Sync {
    /// Where local SLAM works.
    type Space: Space;
    /// A scan in its frame, as it is matched and judged.
    type Scan: Clone + Send + Sync;
    /// All scans of the recent way as one, in the frame of the newest.
    type Joint: Send + Sync;
    /// How the scanner moves.
    const FREEDOM: Freedom;
    /// While no place is known, the whole map is searched at least so often where something new was seen, seconds: as long as
    /// a search costs, so that a recording is localised no slower than it was made.
    const LONGEST_PAUSE: f64;

    /// Whether such maps can be renewed.
    const RENEWS: bool;

    /// The frame of a scan in the local map.
    fn local_from_scan(local_from_tracking: &Rigid3) -> Rigid3;
    /// The points that a node keeps, in the tracking frame.
    fn points_in_tracking(node: &NodeData) -> PointCloud;
    /// The scan of these returns, which are in its frame in the order in which they were measured.
    fn scan(&self, returns: &PointCloud) -> Self::Scan;
    /// The recent scans as one.
    fn joint(&self, recent: &RecentScans<Self::Scan>) -> Self::Joint;
    /// Poses anywhere in the map where the joint scan may have been taken, without any guess, the best first.
    fn propose(&self, joint: &Self::Joint, is_known: &(dyn Fn(&Rigid3) -> bool + Sync)) -> Vec<Rigid3>;
    /// The pose in a window around a guess where the joint scan fits best.
    fn settle(&self, joint: &Self::Joint, guess: &Rigid3, window: Window) -> Rigid3;
    /// Finds a scan in a window around a guess.
    fn find(&self, scan: &Self::Scan, guess: &Rigid3, window: Window) -> ScanMatch;
    /// What the map says to a scan at a pose.
    fn agreement(&self, scan: &Self::Scan, pose: &Rigid3) -> ScanAgreement;
    /// Renews the pose graph that holds this map by a trajectory that was localised in it and added to it; none if that is
    /// not done in such maps.
    fn renew(&self, _graph: &mut PoseGraph<Self::Space>, _new: TrajectoryId) -> Option<Renewal> {
        None
    }
    /// Where scans are compared with the map cell by cell; none if that is not done in such maps.
    fn change_grid(&self) -> Option<ChangeGrid>;
}
