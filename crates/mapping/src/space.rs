//! What differs between 2D and 3D, so that the pose graph exists once.

use portolan_config::{ConstraintBuilderOptions, OptimizationProblemOptions, Options};
use portolan_geometry::{Dimension, Point3f, Quaternion, Rigid3, Vector2, Vector3};
use portolan_grids::ScanAgreement;
use portolan_optimization::{OptimizationData, OptimizationSummary};
use portolan_sensor::SensorId;
use portolan_submaps::SearchWindow;

use crate::mapper::MapperWork;
use crate::{Constraint, LocalSlam, LocalSlamSpace, MapperError, MatchAcceptance, NodeData, OpenShift};

/// How far a node may be from where it is believed to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SearchRegion {
    /// Within the search windows around the guess.
    Window {
        /// How far the scanner travelled between node and submap, metres; infinite if that is not known.
        travelled: f64,
        /// How far the node may be from its guess after that; none: as the options say.
        window: Option<SearchWindow>,
        /// What a match has to be like to be believed.
        acceptance: MatchAcceptance,
    },
    /// Anywhere in the submap, or near a guess that was made without knowing where the node is.
    WholeSubmap {
        /// Which matches are believed.
        acceptance: MatchAcceptance,
        /// How far around the guess, if a search of the whole map proposed the place; none: anywhere.
        around_guess: Option<SearchWindow>,
    },
}

impl SearchRegion {
    /// Which matches are believed.
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
    /// The direction along which the match does not tell the place.
    pub open: Option<OpenShift>,
    /// Score in [0, 1].
    pub score: f32,
}

/// What the surroundings of a guess say of a node.
#[derive(Clone, Debug, PartialEq)]
pub enum Nearby {
    /// It is where it is believed to be, or close to that.
    Found(MatchedPose),
    /// It has to be searched.
    Unknown,
    /// It is there, but fits in more than one place; searching finds no better.
    Ambiguous,
    /// It is nowhere it may be; searching would not find it either.
    Absent,
}

/// A submap where the map puts it.
pub struct SubmapInMap<'a, M> {
    /// Its pose.
    pub map_from_submap: Rigid3,
    /// The submap.
    pub submap: &'a M,
    /// Where its nodes were taken, metres in the map.
    pub nodes: Vec<Vector3>,
}

/// Finds scans anywhere in a map at once.
pub trait PlaceFinder: Send + Sync {
    /// Where the first of some scans may have been taken. Each scan comes with its pose in the frame of the first. The search
    /// ends after so many look-ups of cells, with what it has found.
    fn find(&self, scans: &[(Rigid3, &NodeData)], most_lookups: u64) -> ProposedPlaces;
}

/// Places that a scan may have been taken at.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProposedPlaces {
    /// Poses in the map, in the frame that constraints use, the most likely first.
    pub poses: Vec<Rigid3>,
    /// How many cells of the map were looked up for them: what the search cost, on any machine.
    pub lookups: u64,
}

/// A space to map in: 2D or 3D. Poses cross this interface as [`Rigid3`].
pub trait Space: LocalSlamSpace {
    /// What is precomputed from a finished submap to find nodes in it.
    type Matcher: Send + Sync + 'static;

    /// The local SLAM of this space.
    type LocalSlam: LocalSlam<Self>;

    /// What a mapper in this space does.
    fn mapper_work() -> &'static MapperWork<Self>;

    /// Plane or space.
    const DIMENSION: Dimension;

    /// Whether the optimisation uses IMU samples, so that they are kept.
    const OPTIMIZES_WITH_IMU: bool = matches!(Self::DIMENSION, Dimension::ThreeD);

    /// Whole maps are searched for scans so far along the way to either side of a node, metres.
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

    /// Precomputes what searching in this submap needs; none if the options make no sense.
    fn build_matcher(submap: &Self::Submap, options: &ConstraintBuilderOptions) -> Option<Self::Matcher>;

    /// Memory that a matcher takes, bytes.
    fn matcher_bytes(matcher: &Self::Matcher) -> usize;

    /// Gives a submap of a file what files do not keep and local SLAM would have kept, from its grids and
    /// from the nodes that were inserted into it.
    fn complete_loaded(
        _submap: &mut Self::Submap,
        _nodes: &mut dyn Iterator<Item = &NodeData>,
        _options: &Options,
    ) {
    }

    /// Looks whether the node is close to where it is believed or proposed to be, which takes less than searching.
    fn find_nearby(
        _submap: &Self::Submap,
        _node: &NodeData,
        _guess_submap_from_node: &Rigid3,
        _region: &SearchRegion,
        _options: &ConstraintBuilderOptions,
    ) -> Nearby {
        Nearby::Unknown
    }

    /// What a match has to be like to be believed where scans agree with the map as well as usual: as wanted, or in 3D as the
    /// least score says, which is the fraction of the points on planes.
    fn wanted_acceptance(wanted: MatchAcceptance, _options: &ConstraintBuilderOptions) -> MatchAcceptance {
        wanted
    }

    /// How a complete submap agrees with the scan of a node that was inserted into it; none in 2D, where local SLAM tells.
    fn own_agreement(
        _submap: &Self::Submap,
        _node: &NodeData,
        _submap_from_node: &Rigid3,
    ) -> Option<ScanAgreement> {
        None
    }

    /// The submap drawn again from the scans of all its nodes, each at its pose in the submap; none where that is not
    /// possible: scans are not kept (3D), or came from a file.
    fn redrawn(
        _submap: &Self::Submap,
        _nodes: &mut dyn Iterator<Item = (&NodeData, Rigid3)>,
    ) -> Option<Self::Submap> {
        None
    }

    /// A submap at the place of this one, drawn from the scans of some of its nodes, each at its pose in the submap; none where
    /// [`Space::redrawn`] gives none.
    fn drawn_from(
        _submap: &Self::Submap,
        _nodes: &mut dyn Iterator<Item = (&NodeData, Rigid3)>,
    ) -> Option<Self::Submap> {
        None
    }

    /// How the submap agrees with the scan of a node at a pose in it; none where it knows nothing of the place, and in 3D.
    fn agreement(
        _submap: &Self::Submap,
        _node: &NodeData,
        _submap_from_node: &Rigid3,
    ) -> Option<ScanAgreement> {
        None
    }

    /// Whether the scan of a node at a pose in the submap leaves a direction open; never in 3D, where planes tell.
    fn leaves_open(_submap: &Self::Submap, _node: &NodeData, _submap_from_node: &Rigid3) -> bool {
        false
    }

    /// Looks for the node in the submap and refines what is found.
    fn find_node(
        matcher: &Self::Matcher,
        submap: &Self::Submap,
        node: &NodeData,
        guess_submap_from_node: &Rigid3,
        region: SearchRegion,
        options: &ConstraintBuilderOptions,
    ) -> Option<MatchedPose>;

    /// What finds scans anywhere in many submaps at once; none where there is nothing to find scans by, or submaps do not know
    /// their planes (3D).
    fn place_finder(submaps: &[SubmapInMap<'_, Self::Submap>]) -> Option<Box<dyn PlaceFinder>>;

    /// Moves submaps, nodes, landmarks and fixed-frame origins to where the constraints and
    /// measurements agree best.
    fn optimize(
        data: &mut OptimizationData,
        constraints: &[Constraint],
        options: &OptimizationProblemOptions,
    ) -> OptimizationSummary;

    /// Centres of the known cells of the submap in the submap's own frame, metres; `None` where
    /// coverage is not defined (3D).
    fn known_cell_centers(submap: &Self::Submap) -> Option<Vec<Vector2>>;

    /// Middles of what is solid in the submap, in its own frame, metres; `None` in 2D, where
    /// [`Space::known_cell_centers`] says what it covers.
    fn solid_cell_centers(_submap: &Self::Submap) -> Option<Vec<Point3f>> {
        None
    }

    /// Edge length of the cells that [`Space::known_cell_centers`] lists, metres.
    fn cell_size(submap: &Self::Submap) -> f64;
}
