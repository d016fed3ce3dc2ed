//! What a saved map has to be able to for scans to be found in it: what differs between 2D and 3D.

use portolan_geometry::{NearFrame, Point3f, Rigid3, Vector2};
use portolan_grids::{BeamEnd, GridError, ScanAgreement};
use portolan_mapping::{FromAboveError, GraphState, NodeData, PoseGraph, Space, TrajectoryId};
use portolan_matching::MatcherOptionError;
use portolan_sensor::PointCloud;

use crate::belief::{Freedom, MapError, Matrix6};
use crate::changes::ChangeCounter;
use crate::finder::LocalScan;
use crate::localizer::LocalizerWork;
use crate::recent::RecentScans;
use crate::renewal::Renewal;
use crate::settings::maps::USUAL_MAP_ERROR;
use crate::voxel_changes::KeptSweep;

/// Single precision has steps of a centimetre so far from the origin, metres.
const FARTHEST: f64 = 1e5;

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
    /// It lies where single precision cannot tell cells apart.
    #[error(
        "the map lies {:.0} km from the origin of its frame, where grids have no place: bring it into a frame near it",
        .0 / 1e3
    )]
    Far(f64),
    /// A grid cannot be made.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// A matcher cannot be made.
    #[error(transparent)]
    Matcher(#[from] MatcherOptionError),
}

impl From<FromAboveError> for KnownMapError {
    fn from(error: FromAboveError) -> Self {
        match error {
            FromAboveError::Empty => Self::NoWalls,
            FromAboveError::Grid(error) => Self::Grid(error),
            FromAboveError::Matcher(error) => Self::Matcher(error),
        }
    }
}

impl KnownMapError {
    /// Refuses a map that does not lie near the origin.
    pub(crate) fn unless_near<S: Space>(state: &GraphState<S>) -> Result<(), Self> {
        let places = state.submaps.keys().filter_map(|id| state.map_from_submap(*id));
        let metres = NearFrame::around(places.map(|pose| pose.translation.vector)).origin().norm();
        if metres < FARTHEST { Ok(()) } else { Err(Self::Far(metres)) }
    }
}

/// How far around a guess a scan is searched, metres and radians to either side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Along each axis.
    pub metres: f64,
    /// About each axis.
    pub radians: f64,
}

/// A part of the map, seen from above: what lies within so many metres of a place along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// The place in the map, metres.
    pub centre: Vector2,
    /// To each side.
    pub metres: f64,
}

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
/// Frames of scans are level: z points up as in the local map, the origin is that of the tracking frame, in 2D at
/// height 0.
pub trait KnownMap: Sized + Send + Sync + 'static {
    /// Where local SLAM works.
    type Space: Space;
    /// A scan in its frame, as it is matched and judged.
    type Scan: Clone + Send + Sync;
    /// All scans of the recent way as one, in the frame of the newest.
    type Joint: Send + Sync;
    /// How the scanner moves.
    const FREEDOM: Freedom;
    /// The standard deviation to which a place is certain enough for contradictions to count there, metres: less than the cells
    /// in which they are counted.
    const CERTAIN_PLACE: f64;
    /// While no place is known, the whole map is searched at least so often where something new was seen, seconds: as long as
    /// a search costs, so that a recording is localised no slower than it was made.
    const LONGEST_PAUSE: f64;

    /// What a localizer in such a map does.
    fn localizer_work() -> &'static LocalizerWork<Self>;

    /// How far places in the map are off although scans fit.
    fn error(&self) -> MapError {
        USUAL_MAP_ERROR
    }
    /// The frame of a scan in the local map.
    fn local_from_scan(local_from_tracking: &Rigid3) -> Rigid3;
    /// The points that a node keeps, in the tracking frame.
    fn points_in_tracking(node: &NodeData) -> PointCloud;
    /// The scan of these returns, which are in its frame in the order in which they were measured.
    fn scan(&self, returns: &PointCloud) -> Self::Scan;
    /// The recent scans as one.
    fn joint(&self, recent: &RecentScans<Self::Scan>) -> Self::Joint;
    /// Poses in an area, or anywhere in the map, where the joint scan may have been taken, at any heading, the best first.
    fn propose(
        &self,
        joint: &Self::Joint,
        area: Option<Area>,
        is_known: &(dyn Fn(&Rigid3) -> bool + Sync),
    ) -> Vec<Rigid3>;
    /// The pose in a window around a guess where the joint scan fits best.
    fn settle(&self, joint: &Self::Joint, guess: &Rigid3, window: Window) -> Rigid3;
    /// Finds a scan in a window around a guess.
    fn find(&self, scan: &Self::Scan, guess: &Rigid3, window: Window) -> ScanMatch;
    /// The points that judge a scan, in its frame, with what the map says to each where the scan lies at a pose.
    fn beam_ends<'a>(
        &'a self,
        scan: &'a Self::Scan,
        pose: &Rigid3,
    ) -> impl Iterator<Item = (&'a Point3f, BeamEnd)>;
    /// What the map says to a scan at a pose.
    fn agreement(&self, scan: &Self::Scan, pose: &Rigid3) -> ScanAgreement;
    /// What a scan is kept as, to renew the map by; none where nodes keep enough of it. The returns are in the local map.
    fn kept_sweep(_scan: &LocalScan, _place: &Rigid3) -> Option<KeptSweep> {
        None
    }
    /// Renews the pose graph that holds this map by a trajectory that was localised in it and added to it, and by the scans
    /// that were kept of it.
    fn renew(&self, graph: &mut PoseGraph<Self::Space>, new: TrajectoryId, sweeps: &[&KeptSweep]) -> Renewal;
    /// Where scans are compared with the map cell by cell.
    fn change_counter(&self) -> Box<dyn ChangeCounter>;
}
