//! How a scan is matched to a known map, and the information of the match (`hypothesis.rs`, `likelihood.rs`,
//! `matcher_2d.rs`, `known_map_3d.rs`, `along.rs`, `information.rs`, `residuals.rs`).

use crate::known_map::Window;

/// Half width of the search window around a predicted pose or a given start, in standard deviations.
pub(crate) const WINDOW_SIGMAS: f64 = 3.0;
/// Smallest search window. It suffices to find earlier scans along a known path.
pub(crate) const NARROWEST_WINDOW: Window = Window { metres: 0.1, radians: 0.03 };
/// Largest search window around a predicted pose.
pub(crate) const WIDEST_WINDOW: Window = Window { metres: 1.5, radians: 0.6 };
/// Gate above which a match is rejected: squared Mahalanobis distance to its prediction, in three
/// dimensions.
pub(crate) const GATE_SQUARED_SIGMAS: f64 = 25.0;

/// Standard deviation of the distance between a return and the surface that it hit, metres. It is wide
/// enough that the steps of a search do not miss the surface.
pub(crate) const RETURN_SIGMA: f64 = 0.12;
/// Step of the correlative search, metres.
pub(crate) const SEARCH_STEP: f64 = 0.1;
/// Step of the correlative search, radians.
pub(crate) const SEARCH_TURN: f64 = 0.026;
/// Maximum number of candidate poses in one search; wider windows are searched in larger steps.
pub(crate) const MOST_PLACEMENTS: f64 = 2e5;
/// Mean likelihood by which a candidate at the edge of the window has to exceed the guess.
pub(crate) const GUESS_PREFERENCE: f64 = 0.03;
/// Largest distance between the result of gradient descent and the result of the search before it; beyond it
/// the descent is rejected.
pub(crate) const FARTHEST_DESCENT: Window = Window { metres: 0.25, radians: 0.1 };
/// Likelihood from which a point counts as being at a wall, and so constrains the pose: within some 15 cm of
/// a wall.
pub(crate) const NEAR_WALL_LIKELIHOOD: f64 = 0.45;

/// Largest window of one registration to planes; wider windows are searched with several starts.
pub(crate) const REGISTRATION_REACH: Window = Window { metres: 0.8, radians: 0.15 };
/// Smallest window that a registration to planes assumes.
pub(crate) const NARROWEST_REGISTRATION: Window = Window { metres: 0.2, radians: 0.01 };
/// Maximum number of start positions, and of start headings, to each side: the number of registrations grows
/// with the cube.
pub(crate) const MOST_REGISTRATION_STEPS: f64 = 3.0;
/// Distance to a plane below which the plane explains a point, metres.
pub(crate) const ON_PLANE: f32 = 0.15;
/// Cosine between a plane normal and a direction below which the plane does not constrain points along that
/// direction: normals are off by 20° (docs/experiments/2026-11-along-streets.md).
pub(crate) const SLIDING_COSINE: f64 = 0.35;
/// Shift along the degenerate direction below which the refinement of a proposed place has converged,
/// metres.
pub(crate) const SETTLED: f64 = 0.05;
/// Maximum number of iterations of that refinement.
pub(crate) const MOST_SLIDES: usize = 4;
/// Smallest half width of the search along the degenerate direction, metres.
pub(crate) const NARROWEST_SLIDE: f64 = 0.3;
/// Step of the search along the degenerate direction, metres.
pub(crate) const SLIDE_STEP: f64 = 0.05;
/// Maximum number of points in that search, evenly taken from all of them: more points add no information.
pub(crate) const MOST_SLIDE_POINTS: usize = 1000;
/// Number of points that count as one independent measurement, because neighbouring points share the errors
/// of the map. With this value the scatter of sweeps agreed with their computed uncertainty on two drives
/// (docs/experiments/2026-11-along-streets.md).
pub(crate) const POINTS_PER_INDEPENDENT_ONE: f64 = 50.0;

/// Standard deviation of the distance of one point from its wall, metres; so large because neighbours on one
/// wall have correlated errors.
pub(crate) const POINT_SIGMA: f64 = 0.1;
/// Fraction of the information of the strongest direction that is subtracted in every direction in 2D.
/// Normals are off by some 10°, so this fraction appears as spurious information in the weakest direction.
pub(crate) const SPURIOUS_FRACTION: f64 = 0.04;
/// Variance of a normal about each of two axes along its surface, rad². It is used in 3D, where the
/// strongest direction need not say anything about the weakest
/// (docs/experiments/2026-11-starts-in-3d-maps.md).
pub(crate) const NORMAL_VARIANCE: f64 = 0.03;

/// Standard deviation of a range, metres: it bounds the weight of a point.
pub(crate) const RANGE_NOISE: f32 = 0.02;
/// Distance from a plane at which the robust weight of a point begins to fall, metres: as in registration.
pub(crate) const ROBUST_SCALE: f32 = 0.1;
/// Distance from a plane beyond which a point has no weight, metres.
pub(crate) const ROBUST_REACH: f32 = 3.0 * ROBUST_SCALE;
/// Edge of the cubes whose points are taken to have a common error, metres. Cubes four times as large give
/// about the same information (docs/experiments/2026-11-honest-covariance.md).
pub(crate) const ERROR_PATCH: f32 = 1.0;
