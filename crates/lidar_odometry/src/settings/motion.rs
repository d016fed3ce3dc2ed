//! Settings of motion: IMU, predictions, priors.

settings! {
    /// Samples of the IMU.
    ImuSettings {
        max_gap: f64 = 0.1, "s", 0.001..=10.0,
            "Gap between samples above which the motion in between is unknown",
            origin: "ten samples of a slow IMU",
            larger: "longer gaps are bridged with the last sample";
    }
}

settings! {
    /// Errors of the gyroscope, and its range.
    GyroscopeSettings {
        noise: f64 = 0.001, "rad in a second", 1e-6..=1.0,
            "Noise of angular velocities: drift of rotations within a second, without the bias",
            origin: "jitter of time stamps; the noise of the sensors alone is a tenth by their data sheets",
            larger: "the bias is estimated more slowly";
        scale_error: f64 = 0.0033, "1", 0.0..=1.0,
            "Errors of scale and alignment, which grow with the angular velocity",
            origin: "tuned: at 0.3 rad/s as large as the noise",
            larger: "rotations constrain the bias less";
        bias: f64 = 0.02, "rad/s", 1e-5..=1.0,
            "Standard deviation of the bias before it is estimated; a difference of ten times as much is not a bias but a poor registration",
            origin: "low-cost sensors",
            larger: "the bias is estimated faster at first";
        bias_walk: f64 = 5e-5, "rad/s in a second", 0.0..=1.0,
            "Random walk of the bias",
            origin: "measurements older than about 20 s are forgotten with this noise",
            larger: "the estimate follows the bias faster, with more noise";
        equal_in_a_row: u32 = 5, "samples", 2.0..=1e6,
            "Number of consecutive samples at the largest or smallest value so far at which this value counts as the end of the range",
            origin: "tuned: noise makes shorter runs of equal samples",
            larger: "saturation is detected later";
    }
}

settings! {
    /// Zero-velocity updates.
    StandstillSettings {
        bin: f64 = 0.05, "s", 0.005..=1.0,
            "Averaging time of samples, which suppresses vibrations",
            origin: "derived: motors vibrate at more than 20 Hz",
            larger: "more vibration is tolerated, the start of motion is detected later";
        acceleration_error: f64 = 0.08, "m/s²", 0.001..=5.0,
            "Maximum standard deviation of averaged accelerations at rest",
            origin: "tuned: platforms with running motors",
            larger: "slow motion is taken for rest";
        resting_speed: f64 = 0.02, "m/s", 0.0..=5.0,
            "Speed by odometry below which the wheels are at rest; below it the direction of motion is not updated",
            origin: "noise of encoders",
            larger: "creeping is taken for rest, and the direction of motion is kept longer";
    }
}

settings! {
    /// The inertial filter.
    InertialSettings {
        first_velocity: f64 = 1.0, "m/s", 0.01..=100.0,
            "Standard deviation of the first velocity. The accelerometer is used once the velocity is known to half of it; a platform that seems slower than this while the IMU is at rest is standing",
            origin: "error of the velocity by two sparse sweeps",
            larger: "the accelerometer is used later, smooth slow starts are taken for rest";
        accelerometer_bias: f64 = 0.1, "m/s²", 0.0..=10.0,
            "Standard deviation of the bias before it is estimated",
            origin: "10 mg by data sheets",
            larger: "gravity is estimated more slowly while the platform does not rotate";
        acceleration_noise: f64 = 0.05, "m/s² averaged over a second", 0.001..=10.0,
            "Noise of accelerations",
            origin: "measured on kitti_0059: results with 0.02 to 0.1 are alike (docs/experiments/2026-11-motion-state.md); raised where innovations are larger",
            larger: "more weight of registered positions, gravity is estimated more slowly";
        gravity_walk: f64 = 0.02, "m/s² in a second", 0.0..=10.0,
            "Random walk of gravity in the local map, because the map drifts, and of the accelerometer bias with it",
            origin: "tuned",
            larger: "the estimate follows gravity faster, with more noise";
    }
}

settings! {
    /// Standard deviations of predicted trajectory segments.
    MotionPriorSettings {
        start_rotation: f64 = 0.01, "rad", 0.0001..=1.0,
            "Standard deviation of the rotation at the end of the previous sweep where no gyroscope measures",
            origin: "tuned: with half of it, a gyroscope with swapped axes rotates the map",
            larger: "as for least_translation_error";
        acceleration: f64 = 4.0, "m/s²", 0.1..=100.0,
            "Unmeasured acceleration of a platform, from which the error of predictions at constant velocity follows",
            origin: "walkers, braking cars",
            larger: "less weight of constant velocity, the travel correlation searches farther";
        rotational_acceleration: f64 = 10.0, "rad/s²", 0.1..=1000.0,
            "Unmeasured angular acceleration of a platform, from which the error of predictions at constant rotation follows",
            origin: "hand-held lidars",
            larger: "less weight of constant rotation";
        odometry_drift: f64 = 0.2, "m/s", 0.001..=10.0,
            "Standard deviation of odometry, per second, until its noise is estimated from sweeps",
            origin: "slipping wheels",
            larger: "less weight of odometry at first";
        odometry_calibration: f64 = 0.1, "1, and rad", 0.0..=1.0,
            "Initial standard deviation of the scale of odometry and of the direction of its motion, until sweeps calibrate them",
            origin: "assumed: wheels of another size, a tilted or rotated mounting of the lidar, ramps that wheels do not measure",
            larger: "less weight of odometry at first, and worse odometry is corrected instead of left out";
        least_translation_error: f64 = 0.01, "m", 0.0..=1.0,
            "Minimum standard deviation of any predicted translation, and standard deviation of the position at the end of the previous sweep",
            origin: "jitter of time stamps; where the start is held more tightly, errors come back with the opposite sign; results with 0.005 to 0.05 are alike there",
            larger: "less weight of predictions, segments start farther from the end of the previous one";
        least_rotation_error: f64 = 0.005, "rad", 0.0..=1.0,
            "Minimum standard deviation of an unmeasured predicted rotation, and of one by a gyroscope in the test for its failure; standard deviation of a registered rotation",
            origin: "tuned: a standing walker sways by this much",
            larger: "less weight of unmeasured predicted rotations, failure of a gyroscope is detected later; slow rotations are taken for rest";
    }
}

settings! {
    /// When alternative predictions are tried, and when they are accepted.
    HypothesisSettings {
        clearly_better: f64 = 1.3, "1", 1.0..=10.0,
            "Ratio by which a result without the gyroscope must fit better than one with it, unless the gyroscope is saturated",
            origin: "tuned",
            larger: "the gyroscope is used longer";
        headings_each_side: usize = 2, "windows", 0.0..=100.0,
            "Number of windows of headings to each side of the predicted one in which the pose of a sweep that contradicts the map is searched, if the rotation was unmeasured; after a long gap all around",
            origin: "derived: a carried lidar rotates by 60° between key frames at 2 Hz",
            larger: "slower where sweeps contradict the map";
        better_over_sweeps: f64 = 1.02, "1", 1.0..=10.0,
            "Ratio by which the following sweeps must fit better under another motion than under the likeliest, at starts and after gaps",
            origin: "measured: along a simulated tunnel fits differ by 0.5 %, where a car had braked by 2.6 % and more (docs/experiments/2026-11-gaps.md)",
            larger: "the likeliest motion is kept more often";
        long_gap: f64 = 0.5, "s", 0.01..=60.0,
            "Time without sweeps after which the platform may have stopped or changed its velocity, or a clock jumped: other motions are tried, too",
            origin: "tuned",
            larger: "the pose is lost more often after gaps";
    }
}
