//! Interface of a space, 2D or 3D, so that the pose graph exists once.

use portolan_config::{ConstraintBuilderOptions, OptimizationProblemOptions, Options};
use portolan_geometry::{Dimension, Point3f, Quaternion, Rigid3, Vector2, Vector3};
use portolan_grids::ScanAgreement;
use portolan_optimization::{OptimizationData, OptimizationSummary};
use portolan_sensor::SensorId;
use portolan_submaps::SearchWindow;

use crate::mapper::MapperWork;
use crate::{Constraint, LocalSlam, LocalSlamSpace, MapperError, MatchAcceptance, NodeData, OpenShift};

/// Region in which a node is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SearchRegion {
    /// Within the search windows around the guess.
    Window {
        /// Path length between node and submap, metres; infinite if unknown.
        travelled: f64,
        /// Search window that follows from it; none: as the options say.
        window: Option<SearchWindow>,
        /// Criteria for accepting a match.
        acceptance: MatchAcceptance,
    },
    /// Anywhere in the submap, or near a guess that does not come from the pose of the node.
    WholeSubmap {
        /// Criteria for accepting a match.
        acceptance: MatchAcceptance,
        /// Search window around the guess, if a search of the whole map proposed the pose; none: anywhere.
        around_guess: Option<SearchWindow>,
    },
}

impl SearchRegion {
    /// Criteria for accepting a match.
    pub fn acceptance(&self) -> MatchAcceptance {
        match self {
            Self::Window { acceptance, .. } | Self::WholeSubmap { acceptance, .. } => *acceptance,
        }
    }
}

/// A node found in a submap.
#[derive(Clone, Debug, PartialEq)]
pub struct MatchedPose {
    /// Pose of the node (in the frame that constraints use) in the submap.
    pub submap_from_node: Rigid3,
    /// The direction along which the match does not constrain the position.
    pub open: Option<OpenShift>,
    /// Score in [0, 1].
    pub score: f32,
}

/// Result of matching a node around its guess.
#[derive(Clone, Debug, PartialEq)]
pub enum Nearby {
    /// It is at the guess, or close to it.
    Found(MatchedPose),
    /// It has to be searched.
    Unknown,
    /// It is there, but fits at more than one pose; a full search does not resolve that.
    Ambiguous,
    /// It is not within the region; a full search would not find it either.
    Absent,
}

/// A submap at its pose in the map.
pub struct SubmapInMap<'a, M> {
    /// Its pose.
    pub map_from_submap: Rigid3,
    /// The submap.
    pub submap: &'a M,
    /// Positions of its nodes in the map, metres.
    pub nodes: Vec<Vector3>,
}

/// Finds scans anywhere in a map at once.
pub trait PlaceFinder: Send + Sync {
    /// Possible poses of the first of some scans. Each scan comes with its pose in the frame of the first.
    /// The search ends after `most_lookups` look-ups of cells, with what it has found.
    fn find(&self, scans: &[(Rigid3, &NodeData)], most_lookups: u64) -> ProposedPlaces;
}

/// Possible poses of a scan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProposedPlaces {
    /// Poses in the map, in the frame that constraints use, the most likely first.
    pub poses: Vec<Rigid3>,
    /// Number of cells looked up for them: the cost of the search, independent of the machine.
    pub lookups: u64,
}

/// A space to map in: 2D or 3D. Poses cross this interface as [`Rigid3`].
pub trait Space: LocalSlamSpace {
    /// Data precomputed from a finished submap for finding nodes in it.
    type Matcher: Send + Sync + 'static;

    /// The local SLAM of this space.
    type LocalSlam: LocalSlam<Self>;

    /// The work of a mapper in this space.
    fn mapper_work() -> &'static MapperWork<Self>;

    /// 2D or 3D.
    const DIMENSION: Dimension;

    /// Whether the optimisation uses IMU samples, so that they are kept.
    const OPTIMIZES_WITH_IMU: bool = matches!(Self::DIMENSION, Dimension::ThreeD);

    /// Length of the path to either side of a node whose scans are searched in whole maps, metres.
    const STRETCH_METRES: f64;

    /// Memory for matchers that are kept between searches, bytes. In 2D building one takes a millisecond
    /// or two, keeping one a few megabytes.
    const MATCHER_CACHE_BYTES: usize = 12 << 20;

    /// Local SLAM for a new trajectory with these range sensors; options that contradict each other
    /// are an error.
    fn new_local_slam(options: &Options, range_sensors: &[SensorId]) -> Result<Self::LocalSlam, MapperError>;

    /// Pose of the submap in the local map.
    fn local_from_submap(submap: &Self::Submap) -> Rigid3;

    /// The pose that constraints relate for a tracking frame at `pose`: in 2D its gravity-aligned
    /// projection, in 3D the pose itself.
    fn graph_pose(pose: &Rigid3, gravity_alignment: &Quaternion) -> Rigid3;

    /// The inverse of [`Space::graph_pose`].
    fn tracking_pose(graph_pose: &Rigid3, gravity_alignment: &Quaternion) -> Rigid3;

    /// Builds the matcher of this submap; none if the options are invalid.
    fn build_matcher(submap: &Self::Submap, options: &ConstraintBuilderOptions) -> Option<Self::Matcher>;

    /// Memory that a matcher takes, bytes.
    fn matcher_bytes(matcher: &Self::Matcher) -> usize;

    /// Restores data of a loaded submap that files do not keep but local SLAM would have kept, from its grids
    /// and from the nodes that were inserted into it.
    fn complete_loaded(
        _submap: &mut Self::Submap,
        _nodes: &mut dyn Iterator<Item = &NodeData>,
        _options: &Options,
    ) {
    }

    /// Checks whether the node is close to its guess or proposed pose, which is cheaper than a search.
    fn find_nearby(
        _submap: &Self::Submap,
        _node: &NodeData,
        _guess_submap_from_node: &Rigid3,
        _region: &SearchRegion,
        _options: &ConstraintBuilderOptions,
    ) -> Nearby {
        Nearby::Unknown
    }

    /// Acceptance criteria where scans agree with the map as well as usual: as wanted, or in 3D the minimum
    /// score, which is the fraction of the points on planes.
    fn wanted_acceptance(wanted: MatchAcceptance, _options: &ConstraintBuilderOptions) -> MatchAcceptance {
        wanted
    }

    /// Agreement of a complete submap with the scan of a node that was inserted into it; none in 2D, where
    /// local SLAM reports it.
    fn own_agreement(
        _submap: &Self::Submap,
        _node: &NodeData,
        _submap_from_node: &Rigid3,
    ) -> Option<ScanAgreement> {
        None
    }

    /// The submap made again from the scans of all its nodes, each at its pose in the submap; none where that
    /// is not possible: scans are not kept (3D), or came from a file.
    fn redrawn(
        _submap: &Self::Submap,
        _nodes: &mut dyn Iterator<Item = (&NodeData, Rigid3)>,
    ) -> Option<Self::Submap> {
        None
    }

    /// A submap at the pose of this one, made from the scans of some of its nodes, each at its pose in the
    /// submap; none where [`Space::redrawn`] returns none.
    fn drawn_from(
        _submap: &Self::Submap,
        _nodes: &mut dyn Iterator<Item = (&NodeData, Rigid3)>,
    ) -> Option<Self::Submap> {
        None
    }

    /// Agreement of the submap with the scan of a node at a pose in it; none where it does not know the
    /// place, and in 3D.
    fn agreement(
        _submap: &Self::Submap,
        _node: &NodeData,
        _submap_from_node: &Rigid3,
    ) -> Option<ScanAgreement> {
        None
    }

    /// Whether the scan of a node at a pose in the submap has a degenerate direction; never in 3D, where the
    /// registration to planes reports it.
    fn leaves_open(_submap: &Self::Submap, _node: &NodeData, _submap_from_node: &Rigid3) -> bool {
        false
    }

    /// Searches the node in the submap and refines the match.
    fn find_node(
        matcher: &Self::Matcher,
        submap: &Self::Submap,
        node: &NodeData,
        guess_submap_from_node: &Rigid3,
        region: SearchRegion,
        options: &ConstraintBuilderOptions,
    ) -> Option<MatchedPose>;

    /// A finder of scans anywhere in many submaps at once; none where nothing can be searched, or submaps
    /// have no planes (3D).
    fn place_finder(submaps: &[SubmapInMap<'_, Self::Submap>]) -> Option<Box<dyn PlaceFinder>>;

    /// Optimises submaps, nodes, landmarks and fixed-frame origins for the best agreement of constraints and
    /// measurements.
    fn optimize(
        data: &mut OptimizationData,
        constraints: &[Constraint],
        options: &OptimizationProblemOptions,
    ) -> OptimizationSummary;

    /// Centres of the known cells of the submap in the submap's own frame, metres; `None` where
    /// coverage is not defined (3D).
    fn known_cell_centers(submap: &Self::Submap) -> Option<Vec<Vector2>>;

    /// Centres of the occupied cells of the submap, in its own frame, metres; `None` in 2D, where
    /// [`Space::known_cell_centers`] gives its coverage.
    fn solid_cell_centers(_submap: &Self::Submap) -> Option<Vec<Point3f>> {
        None
    }

    /// Edge length of the cells that [`Space::known_cell_centers`] lists, metres.
    fn cell_size(submap: &Self::Submap) -> f64;
}
