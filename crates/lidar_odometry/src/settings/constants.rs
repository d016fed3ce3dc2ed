//! Constants of single models: of likelihoods, filters, priors and iterations. They are not fields of
//! [`super::OdometrySettings`], since each belongs to the model of one file, which its module names. Each
//! states its unit and the reason for its value; where no reason is given the value is assumed.

/// Likelihood of shifts of upright structures (`shift_likelihood.rs`).
pub(crate) mod shift_likelihood {
    /// Probability that a static structure is met again at its position: the fraction of upright
    /// structures that is, in drives.
    pub(crate) const MET_AGAIN_PROBABILITY: f64 = 0.8;
    /// Half width of the range of shifts, metres, over which the probability of meeting a structure by
    /// chance is averaged.
    pub(crate) const CHANCE_REACH: f64 = 2.0;
    /// Minimum distance of the probability by chance from 0 and from 1.
    pub(crate) const LEAST_CHANCE: f64 = 0.05;
    /// Edge of the squares whose upright structures count as one object, metres: about a car.
    pub(crate) const OBJECT_EDGE: f64 = 4.0;
    /// Probability that an object moves, or is another one than before; it may then be met at any shift.
    pub(crate) const MOVING_PROBABILITY: f64 = 0.1;
    /// Fraction of the prior variance below which the posterior variance of a shift counts as a
    /// measurement.
    pub(crate) const MEASURED_VARIANCE_FRACTION: f64 = 0.5;
    /// Half the range of tested shifts and motions, in standard deviations.
    pub(crate) const REACH_SIGMAS: f64 = 3.0;
    /// Step of tested shifts along one and along two directions, as a fraction of a cell.
    pub(crate) const STEPS_PER_CELL: [f64; 2] = [0.25, 0.5];
    /// Maximum shift along two directions, metres: the number of shifts grows with its square.
    pub(crate) const FARTHEST_IN_TWO: f64 = 3.0;
}

/// Which structures sweeps can have seen (`sight.rs`).
pub(crate) mod sight {
    /// Number of sectors of a turn in which ranges and elevations of beams are recorded.
    pub(crate) const SECTORS: usize = 72;
    /// Minimum range for elevations, metres: nearer by, a column spans too many of them.
    pub(crate) const NEAREST_FOR_ELEVATIONS: f64 = 3.0;
}

/// Registration to planes (`registration.rs`).
pub(crate) mod registration {
    /// Number of parts of a sweep that are summed up separately; within each the growth of the correction
    /// is constant.
    pub(crate) const PARTS_PER_SWEEP: f64 = 8.0;
    /// Stride of the sample of points from which the lever arms to the scanner are computed.
    pub(crate) const ARM_SAMPLE_POINTS: usize = 4;
    /// Fraction of the minimum matched fraction below which registration is given up, once the loss has
    /// its final scale.
    pub(crate) const HOPELESS_FRACTION: f64 = 0.6;
    /// Maximum number of iterations; fewer than half as many are needed.
    pub(crate) const MAX_ITERATIONS: u32 = 20;
    /// Minimum number of points on planes: three for each unknown.
    pub(crate) const MIN_PAIRS: usize = 18;
    /// Weight of the prior in degenerate directions, relative to that of the points: the prior decides
    /// there.
    pub(crate) const DEGENERATE_PRIOR_FACTOR: f64 = 30.0;
}

/// Predicted poses of a sweep (`segment.rs`).
pub(crate) mod segment {
    /// Time between the poses of a segment, seconds. In between the motion is linear; at 10 m/s² the error
    /// of that is 5 µm.
    pub(crate) const POSE_SPACING: f64 = 0.002;
    /// Maximum number of poses of a segment, which bounds memory; those of a longer one are farther apart.
    pub(crate) const MAX_POSES: usize = 512;
}

/// The vertical from planes (`vertical.rs`).
pub(crate) mod vertical {
    /// Approximate maximum number of normals that are tried as the vertical.
    pub(crate) const CANDIDATES: usize = 200;
    /// Minimum weight of the planes, in planes with the maximum number of hits: three determine a room.
    pub(crate) const LEAST_PLANES: f64 = 3.0;
    /// Weight of a wall relative to a floor: it constrains one direction of two.
    pub(crate) const WALL_WEIGHT: f64 = 0.5;
}

/// The planar voxel map (`plane_map.rs`, `plane_fit.rs`).
pub(crate) mod plane_map {
    /// Offset of the voxels from the origin, metres, since floors and first walls tend to be at round
    /// distances.
    pub(crate) const VOXEL_OFFSET: f32 = 0.37;
    /// Minimum number of hits of a plane. (The table of counts at which planes are fitted is made at
    /// compile time.)
    pub(crate) const MIN_HITS: u16 = 6;
    /// Maximum number of hits of a voxel; the surface is known by then, and more hits change nothing.
    pub(crate) const MAX_HITS: u16 = 400;
}

/// Vertical structures (`poles.rs`).
pub(crate) mod poles {
    /// Slope up to which ground is not taken for a vertical structure, 30°; a tangent.
    pub(crate) const STEEPEST_GROUND_TANGENT: f32 = 0.577;
    /// Minimum ratio of the spread of the points of a wall along it to that across it: as of planes.
    pub(crate) const ELONGATED_RATIO: f32 = 3.0;
}

/// The inertial filter (`inertial.rs`).
pub(crate) mod inertial {
    /// Standard deviation of unmeasured quantities: metres along degenerate directions, radians about
    /// them.
    pub(crate) const UNKNOWN_SIGMA: f64 = 30.0;
    /// Acceleration, m/s², above which a sample is rejected: more than platforms reach, and than most
    /// accelerometers measure.
    pub(crate) const MAX_ACCELERATION: f64 = 200.0;
    /// Time constant of the learned noise of accelerations, sweeps.
    pub(crate) const COMPARED_SWEEPS: f64 = 20.0;
    /// Maximum factor of the variance of an accelerometer, at which it has no weight.
    pub(crate) const MAX_NOISE_FACTOR: f64 = 1e6;
}

/// The first two sweeps (`initialise.rs`, `start.rs`, `start_velocity.rs`).
pub(crate) mod initialise {
    use crate::registration::Sigmas;

    /// Fraction of the fit required of hypotheses below which a motion is not tracked, for sweeps that are
    /// not de-skewed: de-skewing changes the fit of sweeps by a fifth
    /// (docs/experiments/2026-11-cpu-time.md).
    pub(crate) const PROMISING_FRACTION: f64 = 0.75;
    /// Number of iterations for the first velocity and the sweeps that it de-skews; more change nothing.
    pub(crate) const ITERATIONS: u32 = 4;
    /// Ratio of the points on planes that a start requires to those that other sweeps require: a start has
    /// no prediction.
    pub(crate) const UNPREDICTED_FACTOR: f64 = 2.0;
    /// Tilt of the tracking frame, radians, below which it counts as level: posts of 3 m stay within a
    /// column of voxels. The vertical from a single sweep is uncertain, too.
    pub(crate) const LEVEL_TILT: f64 = 0.13;
    /// Standard deviations of the result of a coarse search: hardly a prior.
    pub(crate) const COARSE: Sigmas = Sigmas { translation: 1.0, rotation: 0.1 };
    /// Time between the two poses that give an extrapolator the first velocity, seconds: less than a
    /// sweep.
    pub(crate) const VELOCITY_INTERVAL: f64 = 0.05;
    /// Number of corrections of a velocity: a wrong velocity blurs the points that determine it.
    pub(crate) const VELOCITY_CORRECTIONS: usize = 3;
    /// Number of steps to each side in which accelerations are tried.
    pub(crate) const ACCELERATION_STEPS: i32 = 6;
}

/// Errors of predicted rotations (`innovations.rs`).
pub(crate) mod innovations {
    /// Time constant of the statistics, sweeps.
    pub(crate) const MEMORY_SWEEPS: f64 = 20.0;
    /// Margin factor of the learned errors: innovations are of the ends of segments, and errors within a
    /// segment are allowed to be larger.
    pub(crate) const MARGIN_FACTOR: f64 = 2.0;
    /// Minimum of the learned error, as a fraction of the assumed error of predictions.
    pub(crate) const LEAST_FRACTION: f64 = 0.03;
    /// Standard deviation of the rotation of registered sweeps, radians, and so of the start of the next
    /// segment. A gyroscope measures from sweep to sweep as well or better
    /// (docs/experiments/2026-11-gyroscope-prior.md).
    pub(crate) const REGISTERED_SIGMA: f64 = 5e-4;
}

/// Detection of failing odometry (`odometry_prior/trust.rs`).
pub(crate) mod odometry_trust {
    /// Initial logarithm of the odds that odometry works. Assumed, not measured.
    pub(crate) const FIRST_LOG_ODDS: f64 = 3.0;
    /// Maximum magnitude of these log-odds, so that a failure that begins or ends is noticed within a few
    /// sweeps. Assumed, not measured.
    pub(crate) const MOST_LOG_ODDS: f64 = 6.0;
    /// Maximum evidence of one prediction, nats: errors may have other causes.
    pub(crate) const OUTLIER_NATS: f64 = 8.0;
    /// Difference of two predictions, in standard deviations, below which they count as the same.
    pub(crate) const DIFFERENT_SIGMAS: f64 = 3.0;
}

/// Calibration of odometry (`odometry_prior/calibration.rs`).
pub(crate) mod odometry_calibration {
    /// Time constant of the estimated noise, sweeps.
    pub(crate) const MEMORY_SWEEPS: f64 = 20.0;
    /// Limits of the factor of the assumed variance of the noise: minimum and maximum.
    pub(crate) const NOISE_FACTORS: (f64, f64) = (0.01, 1e4);
    /// Time after which the calibration is forgotten, seconds: a platform drives up a ramp and down again.
    /// Assumed.
    pub(crate) const FORGOTTEN_AFTER: f64 = 100.0;
    /// Minimum scale error for a report, as a fraction.
    pub(crate) const REPORTED_SCALE_ERROR: f64 = 0.05;
    /// Minimum significance of a reported scale error, in standard deviations.
    pub(crate) const REPORTED_SIGMAS: f64 = 3.0;
    /// Squared innovation, in standard deviations, above which it does not update the calibration.
    pub(crate) const OUTLIER_SQUARED_SIGMAS: f64 = 9.0;
}

/// Key frames of a platform at rest (`keyframes.rs`).
pub(crate) mod keyframes {
    /// Number of doublings of the interval when the platform comes to rest; it is doubled once more with
    /// each key frame there.
    pub(crate) const DOUBLINGS_AT_REST: i32 = 2;
    /// Maximum number of doublings, so that changes around a standing scanner are mapped.
    pub(crate) const MOST_DOUBLINGS: i32 = 5;
}
