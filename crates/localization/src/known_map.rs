//! Interface of saved maps in which scans are localised: what differs between 2D and 3D.

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

/// Largest distance of a map from the origin, metres: there, single precision has steps of a centimetre.
const FARTHEST: f64 = 1e5;

/// Why localisation in a map is impossible.
#[derive(Debug, thiserror::Error)]
pub enum KnownMapError {
    /// It has no submaps.
    #[error("the map is empty: it has no submap")]
    Empty,
    /// Its submaps have no grids: the user removed them, or the file is damaged.
    #[error("the map has {0} submaps, but none of them has a grid: scans cannot be matched to it")]
    NoGrids(usize),
    /// No cell of its grids is solid.
    #[error("the map has no occupied cells: its grids show no wall that scans could be matched to")]
    NoWalls,
    /// It is so far from the origin that single precision cannot distinguish cells.
    #[error(
        "the map is {:.0} km from the origin of its frame, which is too far for grids: transform it to a frame whose origin is near",
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
    /// Rejects a map that is not near the origin.
    pub(crate) fn require_near_origin<S: Space>(state: &GraphState<S>) -> Result<(), Self> {
        let places = state.submaps.keys().filter_map(|id| state.map_from_submap(*id));
        let metres = NearFrame::around(places.map(|pose| pose.translation.vector)).origin().norm();
        if metres < FARTHEST { Ok(()) } else { Err(Self::Far(metres)) }
    }
}

/// Search window around a guess, metres and radians to either side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Along each axis.
    pub metres: f64,
    /// About each axis.
    pub radians: f64,
}

/// A part of the map, seen from above: a square around a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Centre in the map, metres.
    pub centre: Vector2,
    /// Half of the edge, metres.
    pub metres: f64,
}

/// A scan matched to the map.
#[derive(Clone, Copy, Debug)]
pub struct ScanMatch {
    /// `map_from_scan`.
    pub pose: Rigid3,
    /// Information of the pose; zero along degenerate directions.
    pub information: Matrix6,
    /// Agreement of the map with the scan at this pose.
    pub agreement: ScanAgreement,
}

/// A saved map in which scans can be localised.
///
/// Frames of scans are level: z points up as in the local map, the origin is that of the tracking frame, in 2D at
/// height 0.
pub trait KnownMap: Sized + Send + Sync + 'static {
    /// The space of local SLAM, 2D or 3D.
    type Space: Space;
    /// A scan in its frame, in the form in which it is matched and judged.
    type Scan: Clone + Send + Sync;
    /// All recent scans as one cloud, in the frame of the newest.
    type Joint: Send + Sync;
    /// Degrees of freedom of the scanner.
    const FREEDOM: Freedom;
    /// Standard deviation of the position up to which contradictions of a scan count, metres: less than the
    /// edge of the cells in which they are counted.
    const CERTAIN_PLACE: f64;
    /// Longest pause between searches of the whole map while no place is known and scans show something new,
    /// seconds. It is the duration of a search, so that localisation keeps up with the recording.
    const LONGEST_PAUSE: f64;

    /// The compiled functions of a localizer in such a map.
    fn localizer_work() -> &'static LocalizerWork<Self>;

    /// Error of the map, which remains in the pose although scans fit.
    fn error(&self) -> MapError {
        USUAL_MAP_ERROR
    }
    /// Pose of the frame of a scan in the local map.
    fn local_from_scan(local_from_tracking: &Rigid3) -> Rigid3;
    /// The points that a node keeps, in the tracking frame.
    fn points_in_tracking(node: &NodeData) -> PointCloud;
    /// Makes a scan of returns, which are in its frame and in the order in which they were measured.
    fn scan(&self, returns: &PointCloud) -> Self::Scan;
    /// The joint cloud of the recent scans.
    fn joint(&self, recent: &RecentScans<Self::Scan>) -> Self::Joint;
    /// Proposes poses where the joint scan may have been taken, in an area or anywhere in the map, at any
    /// heading, the best first.
    fn propose(
        &self,
        joint: &Self::Joint,
        area: Option<Area>,
        is_known: &(dyn Fn(&Rigid3) -> bool + Sync),
    ) -> Vec<Rigid3>;
    /// The pose in a window around a guess at which the joint scan fits best.
    fn refine_pose(&self, joint: &Self::Joint, guess: &Rigid3, window: Window) -> Rigid3;
    /// Matches a scan in a window around a guess.
    fn find(&self, scan: &Self::Scan, guess: &Rigid3, window: Window) -> ScanMatch;
    /// The judging points of a scan, in its frame, each with the state of the map at the
    /// end of its beam at a pose.
    fn beam_ends<'a>(
        &'a self,
        scan: &'a Self::Scan,
        pose: &Rigid3,
    ) -> impl Iterator<Item = (&'a Point3f, BeamEnd)>;
    /// Agreement of the map with a scan at a pose.
    fn agreement(&self, scan: &Self::Scan, pose: &Rigid3) -> ScanAgreement;
    /// The form in which a scan is kept to renew the map; none where nodes keep enough of it. The returns
    /// are in the local map.
    fn kept_sweep(_scan: &LocalScan, _place: &Rigid3) -> Option<KeptSweep> {
        None
    }
    /// Renews the pose graph that holds this map by a trajectory that was localised in it and added to it,
    /// and by its kept sweeps.
    fn renew(&self, graph: &mut PoseGraph<Self::Space>, new: TrajectoryId, sweeps: &[&KeptSweep]) -> Renewal;
    /// An empty counter that compares scans with the map cell by cell.
    fn change_counter(&self) -> Box<dyn ChangeCounter>;
}
