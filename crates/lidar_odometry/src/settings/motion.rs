//! Settings of motion: IMU, predictions, priors.

settings! {
    /// Samples of the IMU.
    ImuSettings {
        max_gap: f64 = 0.1, "s", 0.001..=10.0,
            "Longer than this without a sample, the motion in between is not known",
            origin: "ten samples of a slow IMU",
            larger: "gaps are bridged with the last sample";
    }
}

settings! {
    /// Errors of the gyroscope, and its range.
    GyroscopeSettings {
        noise: f64 = 0.001, "rad in a second", 1e-6..=1.0,
            "Noise of turn rates: how far rotations drift within a second beside the bias",
            origin: "jitter of stamps; data sheets of the sensors alone say a tenth",
            larger: "the bias is learned more slowly";
        scale_error: f64 = 0.0033, "1", 0.0..=1.0,
            "Errors of scale and alignment, which grow with the turn rate",
            origin: "tuned: at 0.3 rad/s as large as the noise",
            larger: "rotation says less of the bias";
        bias: f64 = 0.02, "rad/s", 1e-5..=1.0,
            "Standard deviation of biases before anything is known; ten times as much is no bias but a poor registration",
            origin: "cheap sensors",
            larger: "the bias is learned faster at first";
        bias_walk: f64 = 5e-5, "rad/s in a second", 0.0..=1.0,
            "How fast biases wander",
            origin: "what is older than about 20 s is forgotten with this noise",
            larger: "the bias is followed faster, with more noise";
        equal_in_a_row: u32 = 5, "samples", 2.0..=1e6,
            "So many times in a row the largest value so far, or the smallest, is the end of the range",
            origin: "tuned: noise repeats fewer",
            larger: "saturation is found later";
    }
}

settings! {
    /// Zero-velocity updates.
    StandstillSettings {
        bin: f64 = 0.05, "s", 0.005..=1.0,
            "Samples are averaged over this long, so that vibrations do not count",
            origin: "derived: motors shake faster than 20 Hz",
            larger: "more vibration is tolerated, starts are seen later";
        acceleration_error: f64 = 0.08, "m/s²", 0.001..=5.0,
            "Standard deviation of averaged accelerations at rest, at most",
            origin: "tuned: platforms with running motors",
            larger: "slow motion passes for rest";
        resting_speed: f64 = 0.02, "m/s", 0.0..=5.0,
            "Wheels at rest report less speed, and below it the direction of motion is not known anew",
            origin: "noise of encoders",
            larger: "creeping passes for rest, and the direction of motion is kept longer";
    }
}

settings! {
    /// The inertial filter.
    InertialSettings {
        first_velocity: f64 = 1.0, "m/s", 0.01..=100.0,
            "Standard deviation of the first velocity; accelerations are not relied on before half of it is known; a platform that seems slower while the IMU rests stands",
            origin: "what two sparse sweeps are off by",
            larger: "relied on later, smooth slow starts are taken for rest";
        accelerometer_bias: f64 = 0.1, "m/s²", 0.0..=10.0,
            "Standard deviation of biases before anything is known",
            origin: "10 mg, as data sheets say",
            larger: "gravity is learned more slowly, while the platform does not turn";
        acceleration_noise: f64 = 0.05, "m/s² averaged over a second", 0.001..=10.0,
            "Noise of accelerations",
            origin: "measured on kitti_0059: 0.02 to 0.1 come out alike (docs/experiments/2026-11-motion-state.md); more where innovations say so",
            larger: "registered places count more, gravity is learned more slowly";
        gravity_walk: f64 = 0.02, "m/s² in a second", 0.0..=10.0,
            "How fast gravity changes in the local map, because that drifts, and the bias of the accelerometer with it",
            origin: "tuned",
            larger: "gravity is followed faster, with more noise";
    }
}

settings! {
    /// Standard deviations of predicted trajectory segments.
    MotionPriorSettings {
        start_rotation: f64 = 0.01, "rad", 0.0001..=1.0,
            "How far off the rotation at the end of the sweep before may be, where no gyroscope measures",
            origin: "tuned: half of it turns maps with swapped axes",
            larger: "as for translation";
        acceleration: f64 = 4.0, "m/s²", 0.1..=100.0,
            "What a platform accelerates by unseen",
            origin: "walkers, braking cars",
            larger: "constant velocity counts less, the witness looks farther off";
        rotational_acceleration: f64 = 10.0, "rad/s²", 0.1..=1000.0,
            "What a platform's rotation accelerates by unseen",
            origin: "hand-held lidars",
            larger: "constant rotation counts less";
        odometry_drift: f64 = 0.2, "m/s", 0.001..=10.0,
            "What odometry may be off by, per second, until sweeps say more",
            origin: "slipping wheels",
            larger: "odometry counts less at first";
        odometry_calibration: f64 = 0.1, "1, and rad", 0.0..=1.0,
            "What the scale of odometry and the direction of its motion may be off by before sweeps say more (standard deviation)",
            origin: "assumed: wheels of another size, a lidar mounted askew, ramps that wheels do not feel",
            larger: "odometry counts less at first, and worse odometry is corrected instead of left out";
        least_translation_error: f64 = 0.01, "m", 0.0..=1.0,
            "What any prediction of a translation may be off by at least, and the end of the sweep before",
            origin: "jitter of stamps; a start held faster is a trap, errors come back with the opposite sign; 0.005 to 0.05 come out alike there",
            larger: "predictions count less, segments start elsewhere than the last one ended";
        least_rotation_error: f64 = 0.005, "rad", 0.0..=1.0,
            "What a prediction of a rotation that nothing measured may be off by at least, one of a gyroscope before it is doubted, and a registered rotation (standard deviation)",
            origin: "tuned: who stands sways by so much",
            larger: "rotations that nothing measured count less, gyroscopes are doubted later; slow rotations pass for rest";
    }
}

settings! {
    /// When alternative predictions are tried, and when they are accepted.
    HypothesisSettings {
        clearly_better: f64 = 1.3, "1", 1.0..=10.0,
            "A result without the gyroscope has to fit so many times better than one with it, unless that is saturated",
            origin: "tuned",
            larger: "the gyroscope is relied on longer";
        headings_each_side: usize = 2, "windows", 0.0..=100.0,
            "A sweep that contradicts the map is looked for in so many windows of headings to either side of the predicted one, if nothing measured the rotation",
            origin: "derived: a carried lidar turns by 60° between key frames at 2 Hz",
            larger: "slower where sweeps contradict the map";
        better_over_sweeps: f64 = 1.02, "1", 1.0..=10.0,
            "Where the sweeps that follow judge, at starts and after gaps, another motion than the likeliest has to fit them so many times better",
            origin: "measured: along a simulated tunnel fits differ by 0.5 %, where a car had braked by 2.6 % and more (docs/experiments/2026-11-gaps.md)",
            larger: "the likeliest motion is kept more often";
        long_gap: f64 = 0.5, "s", 0.01..=60.0,
            "Where sweeps are missing for so many seconds it may have stopped or changed its velocity, or a clock jumped: other motions are tried, too",
            origin: "tuned",
            larger: "lost more often after gaps";
    }
}
