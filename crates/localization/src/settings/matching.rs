//! How a scan is matched to a known map, and what the match tells (`hypothesis.rs`, `likelihood.rs`, `matcher_2d.rs`,
//! `known_map_3d.rs`, `along.rs`, `information.rs`, `residuals.rs`).

use crate::known_map::Window;

/// Scans are looked for, and starts, within so many standard deviations of where they are expected …
pub(crate) const WINDOW_SIGMAS: f64 = 3.0;
/// … but at least so far around, which is enough for earlier scans of a way that is known …
pub(crate) const NARROWEST_WINDOW: Window = Window { metres: 0.1, radians: 0.03 };
/// … and at most.
pub(crate) const WIDEST_WINDOW: Window = Window { metres: 1.5, radians: 0.6 };
/// A match that lies farther from its prediction is none: the square of a Mahalanobis distance in three dimensions.
pub(crate) const GATE_SQUARED_SIGMAS: f64 = 25.0;

/// Standard deviation of the distance of a return from what it hit, metres: what makes steps of a search find it.
pub(crate) const RETURN_SIGMA: f64 = 0.12;
/// Steps of a search, metres …
pub(crate) const SEARCH_STEP: f64 = 0.1;
/// … and radians.
pub(crate) const SEARCH_TURN: f64 = 0.026;
/// Placements that a search looks at, at most; wider windows are searched in larger steps.
pub(crate) const MOST_PLACEMENTS: f64 = 2e5;
/// By so much of the mean likelihood a placement at the edge of the window has to be better than the guess.
pub(crate) const GUESS_PREFERENCE: f64 = 0.03;
/// Descent that leaves the place which the search found is not believed beyond this.
pub(crate) const FARTHEST_DESCENT: Window = Window { metres: 0.25, radians: 0.1 };
/// A point tells something if its likelihood at its place is at least this: within some 15 cm of a wall.
pub(crate) const NEAR_WALL_LIKELIHOOD: f64 = 0.45;

/// A registration to planes reaches no farther than this; wider windows are searched from several places.
pub(crate) const REGISTRATION_REACH: Window = Window { metres: 0.8, radians: 0.15 };
/// The window of a registration is taken for no narrower than this.
pub(crate) const NARROWEST_REGISTRATION: Window = Window { metres: 0.2, radians: 0.01 };
/// So many places, and turns, to each side are searched from, at most: the number of registrations grows with the cube.
pub(crate) const MOST_REGISTRATION_STEPS: f64 = 3.0;
/// Planes nearer than this to a point explain it, metres.
pub(crate) const ON_PLANE: f32 = 0.15;
/// Planes whose normals have no more than this of a direction, as a cosine, let points slide along it: normals are off by 20°
/// (docs/experiments/2026-11-along-streets.md).
pub(crate) const SLIDING_COSINE: f64 = 0.35;
/// A proposed place is looked for along the open direction until it moves less than this, metres, …
pub(crate) const SETTLED: f64 = 0.05;
/// … or so often.
pub(crate) const MOST_SLIDES: usize = 4;
/// Places along it are compared at least so far to either side, metres, …
pub(crate) const NARROWEST_SLIDE: f64 = 0.3;
/// … so far apart, metres, …
pub(crate) const SLIDE_STEP: f64 = 0.05;
/// … by so many points, evenly from all of them: more say the same.
pub(crate) const MOST_SLIDE_POINTS: usize = 1000;
/// Neighbouring points share the errors of the map, so that so many count as one: on two drives, sweeps then scatter as far as
/// they say (docs/experiments/2026-11-along-streets.md).
pub(crate) const POINTS_PER_INDEPENDENT_ONE: f64 = 50.0;

/// Standard deviation of the distance of one point from its wall, metres; so large because neighbours on one wall err together.
pub(crate) const POINT_SIGMA: f64 = 0.1;
/// Normals are off by some 10°: so much of the information of the strongest direction appears in the weakest without anything
/// being there, and is taken off in 2D.
pub(crate) const SPURIOUS_FRACTION: f64 = 0.04;
/// In 3D, where what is strongest may tell nothing of the weakest: variance of a normal about each of two axes along its surface,
/// rad² (docs/experiments/2026-11-starts-in-3d-maps.md).
pub(crate) const NORMAL_VARIANCE: f64 = 0.03;

/// Noise of a range, metres: no point is weighed more.
pub(crate) const RANGE_NOISE: f32 = 0.02;
/// Points farther off than about this count little, metres: as in registration …
pub(crate) const ROBUST_SCALE: f32 = 0.1;
/// … and beyond this nothing.
pub(crate) const ROBUST_REACH: f32 = 3.0 * ROBUST_SCALE;
/// Points in one cube of this edge, metres, err together. Four times as much tells about the same
/// (docs/experiments/2026-11-honest-covariance.md).
pub(crate) const ERROR_PATCH: f32 = 1.0;
