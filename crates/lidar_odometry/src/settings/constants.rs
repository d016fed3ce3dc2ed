//! Numbers of single models that could be others: of likelihoods, filters, priors and iterations. They are no fields of
//! [`super::OdometrySettings`]: each belongs to the model of one file, which its module names. Each says its unit and why it is what it
//! is; where no reason is named it is assumed.

/// How shifts of what stands upright are weighed (`shift_likelihood.rs`).
pub(crate) mod shift_likelihood {
    /// How likely what stands is met again where it stands: so much of what stands upright is, in drives.
    pub(crate) const MET_AGAIN_PROBABILITY: f64 = 0.8;
    /// How likely something is met by chance is what fraction of shifts so much smaller or larger, metres, meet it.
    pub(crate) const CHANCE_REACH: f64 = 2.0;
    /// Chance is never better known than this, as a probability.
    pub(crate) const LEAST_CHANCE: f64 = 0.05;
    /// What stands in a square of this edge, metres, is taken for one object: about a car.
    pub(crate) const OBJECT_EDGE: f64 = 4.0;
    /// Probability that an object moves, or is another one than before: then it may be met at any shift.
    pub(crate) const MOVING_PROBABILITY: f64 = 0.1;
    /// Where less than this part of the variance remains that was known before, a shift is told.
    pub(crate) const TOLD_VARIANCE_FRACTION: f64 = 0.5;
    /// Shifts and motions are tried up to so many standard deviations.
    pub(crate) const REACH_SIGMAS: f64 = 3.0;
    /// Shifts along one and along two directions are tried in steps of this fraction of a cell.
    pub(crate) const STEPS_PER_CELL: [f64; 2] = [0.25, 0.5];
    /// Along two directions it is looked no farther, metres: the number of shifts grows with the square.
    pub(crate) const FARTHEST_IN_TWO: f64 = 3.0;
}

/// What sweeps can have seen (`sight.rs`).
pub(crate) mod sight {
    /// Directions of sight are told apart by this part of a turn.
    pub(crate) const SECTORS: usize = 72;
    /// Nearer by, metres, a column spans too many elevations.
    pub(crate) const NEAREST_FOR_ELEVATIONS: f64 = 3.0;
}

/// Registration to planes (`registration.rs`).
pub(crate) mod registration {
    /// The points of a sweep are summed up in so many parts, within which the growth of the correction is constant.
    pub(crate) const PARTS_PER_SWEEP: f64 = 8.0;
    /// Every so many points tell how far points are from the scanner.
    pub(crate) const ARM_SAMPLE_POINTS: usize = 4;
    /// With this part of the least fraction of matched points there is no hope, once the loss has its final scale.
    pub(crate) const HOPELESS_FRACTION: f64 = 0.6;
    /// Iterations at most: fewer than half as many are needed.
    pub(crate) const MAX_ITERATIONS: u32 = 20;
    /// Fewer points on planes, three for each unknown, constrain nothing.
    pub(crate) const MIN_PAIRS: usize = 18;
    /// In degenerate directions the prior decides: it counts so many times more than the points.
    pub(crate) const DEGENERATE_PRIOR_FACTOR: f64 = 30.0;
}

/// Predicted poses of a sweep (`segment.rs`).
pub(crate) mod segment {
    /// Seconds between the poses of a segment; between them motion is linear. At 10 m/s² what this leaves out is 5 µm.
    pub(crate) const POSE_SPACING: f64 = 0.002;
    /// A segment has at most so many poses, which bounds memory; those of a longer one lie farther apart.
    pub(crate) const MAX_POSES: usize = 512;
}

/// The vertical from planes (`vertical.rs`).
pub(crate) mod vertical {
    /// About so many normals are tried.
    pub(crate) const CANDIDATES: usize = 200;
    /// Fewer planes that are well known do not tell: three fix a room.
    pub(crate) const LEAST_PLANES: f64 = 3.0;
    /// A wall counts half as much as a floor: it fixes one direction of two.
    pub(crate) const WALL_WEIGHT: f64 = 0.5;
}

/// The planar voxel map (`plane_map.rs`, `plane_fit.rs`).
pub(crate) mod plane_map {
    /// Voxels do not begin at the origin, because floors and first walls like to lie at round distances; metres.
    pub(crate) const VOXEL_OFFSET: f32 = 0.37;
    /// Fewer hits make no plane. (The table of counts at which planes are fitted is made at compile time.)
    pub(crate) const MIN_HITS: u16 = 6;
    /// More hits change nothing: what a place looks like is known by then.
    pub(crate) const MAX_HITS: u16 = 400;
}

/// Vertical structures (`poles.rs`).
pub(crate) mod poles {
    /// Ground as steep as this, 30°, is not taken for what stands on it; a tangent.
    pub(crate) const STEEPEST_GROUND_TANGENT: f32 = 0.577;
    /// Points of a wall spread so many times farther along it than across it: as those of planes.
    pub(crate) const ELONGATED_RATIO: f32 = 3.0;
}

/// The inertial filter (`inertial.rs`).
pub(crate) mod inertial {
    /// Standard deviation of what nothing measures: metres along degenerate directions, radians about them.
    pub(crate) const UNKNOWN_SIGMA: f64 = 30.0;
    /// An acceleration beyond this, m/s², is more than platforms do, and than most accelerometers measure: it is wrong.
    pub(crate) const MAX_ACCELERATION: f64 = 200.0;
    /// The noise of accelerations is learned from about so many sweeps.
    pub(crate) const COMPARED_SWEEPS: f64 = 20.0;
    /// Beyond this factor of its variance an accelerometer tells nothing.
    pub(crate) const MAX_NOISE_FACTOR: f64 = 1e6;
}

/// The first two sweeps (`initialise.rs`, `start.rs`, `start_velocity.rs`).
pub(crate) mod initialise {
    use crate::registration::Sigmas;

    /// Motions that fit by less than this fraction of what hypotheses need, as sweeps came, are not followed: de-skewing changes
    /// how well sweeps fit by a fifth (docs/experiments/2026-11-cpu-time.md).
    pub(crate) const PROMISING_FRACTION: f64 = 0.75;
    /// The first velocity, and the sweeps that it de-skews, are found in so many iterations; more change nothing.
    pub(crate) const ITERATIONS: u32 = 4;
    /// A start needs so many times more points on planes than other sweeps: nothing predicts it.
    pub(crate) const UNPREDICTED_FACTOR: f64 = 2.0;
    /// A tracking frame that leans by less, radians, is as good as level: posts of 3 m stay within a column of voxels. The vertical
    /// that a single sweep tells is not sure, either.
    pub(crate) const LEVEL_TILT: f64 = 0.13;
    /// How far off what was found coarsely may be: hardly a prior.
    pub(crate) const COARSE: Sigmas = Sigmas { translation: 1.0, rotation: 0.1 };
    /// Seconds between the two poses that tell an extrapolator the first velocity: less than a sweep.
    pub(crate) const VELOCITY_INTERVAL: f64 = 0.05;
    /// Velocities are corrected so many times: a wrong one blurs what tells it.
    pub(crate) const VELOCITY_CORRECTIONS: usize = 3;
    /// Accelerations are tried in so many steps to each side.
    pub(crate) const ACCELERATION_STEPS: i32 = 6;
}

/// How far predicted rotations are off (`innovations.rs`).
pub(crate) mod innovations {
    /// About so many sweeps are remembered.
    pub(crate) const MEMORY_SWEEPS: f64 = 20.0;
    /// Innovations are those of the ends of segments; as much is allowed for within one, and so many times more.
    pub(crate) const MARGIN_FACTOR: f64 = 2.0;
    /// What was learned counts for no less than this fraction of what predictions may usually be off by.
    pub(crate) const LEAST_FRACTION: f64 = 0.03;
    /// Rotations of registered sweeps are off by about so much, radians (standard deviation), and so is where the next segment
    /// starts. A gyroscope measures from sweep to sweep as well or better (docs/experiments/2026-11-gyroscope-prior.md).
    pub(crate) const REGISTERED_SIGMA: f64 = 5e-4;
}

/// Whether odometry fails (`odometry_prior/trust.rs`).
pub(crate) mod odometry_trust {
    /// Logarithm of the odds that odometry works before anything is known. Assumed, not measured.
    pub(crate) const FIRST_LOG_ODDS: f64 = 3.0;
    /// The most of them either way, so that a failure that begins or ends is noticed within a few sweeps. Assumed, not measured.
    pub(crate) const MOST_LOG_ODDS: f64 = 6.0;
    /// A prediction that is farther off than this tells no more, nats: other things go wrong, too.
    pub(crate) const OUTLIER_NATS: f64 = 8.0;
    /// Predictions that differ by fewer standard deviations are one.
    pub(crate) const DIFFERENT_SIGMAS: f64 = 3.0;
}

/// By how much motions of odometry are corrected (`odometry_prior/calibration.rs`).
pub(crate) mod odometry_calibration {
    /// About so many sweeps say how large the noise is …
    pub(crate) const MEMORY_SWEEPS: f64 = 20.0;
    /// … and by which factor of its variance it may be other than assumed: the least, and the most.
    pub(crate) const NOISE_FACTORS: (f64, f64) = (0.01, 1e4);
    /// After so many seconds nothing is known of the calibration: a platform drives up a ramp and down again. Assumed.
    pub(crate) const FORGOTTEN_AFTER: f64 = 100.0;
    /// A scale is told that is off by such a fraction …
    pub(crate) const TOLD_SCALE_ERROR: f64 = 0.05;
    /// … and by so many standard deviations.
    pub(crate) const TOLD_SIGMAS: f64 = 3.0;
    /// An innovation of more standard deviations (squared) tells nothing of the calibration.
    pub(crate) const OUTLIER_SQUARED_SIGMAS: f64 = 9.0;
}

/// Key frames of a platform that stands (`keyframes.rs`).
pub(crate) mod keyframes {
    /// The interval is doubled so often when it comes to rest, and once more with each key frame there.
    pub(crate) const DOUBLINGS_AT_REST: i32 = 2;
    /// No more often than this, so that what changes around a standing scanner is mapped.
    pub(crate) const MOST_DOUBLINGS: i32 = 5;
}
