//! Settings of registration.

settings! {
    /// Registration of scans to planes.
    RegistrationSettings {
        final_scale_per_edge: f64 = 0.1, "1", 0.01..=1.0,
            "Distance from its plane, as a fraction of the edge of the largest voxels, beyond which a point has little weight in the final iterations; a root mean square distance of this size halves the fit of a result",
            origin: "tuned",
            larger: "more weight of outliers; hypotheses are ranked by the number of points on planes alone";
        min_matched_fraction: f64 = 0.15, "1", 0.0..=1.0,
            "Minimum fraction of points on planes for a valid result; registration may be given up early below it. Among trees there are few planes",
            origin: "tuned",
            larger: "more results are rejected, and predictions used instead";
        uneven_factor: f32 = 4.0, "1", 0.0..=100.0,
            "Factor by which the information about a direction must exceed the spurious information of uneven surfaces for the direction to count as constrained; the errors of uneven surfaces are correlated over metres. The noise of hits differs from plane to plane, so that its sum is known better, and counts once",
            origin: "tuned: with a factor of 1, a field without odometry counts as constrained half of the time",
            larger: "more directions count as degenerate";
        grazing_weight: f32 = 0.0, "1", 0.0..=1.0,
            "Weight of planes at grazing incidence: they may be made by the beams themselves, and hold the scanner at its old position",
            origin: "tuned: with 0.1, four of twelve walks through parks without odometry are lost, with 0 two",
            larger: "smoother trajectories on flat ground; the scanner is held back among trees";
        downward_weight: f32 = 0.1, "1", 0.0..=1.0,
            "Weight of ground with a downward normal: with full weight a field seems to hold a lidar that is carried over it",
            origin: "tuned: results with 0.1 and 0.02 do not differ",
            larger: "the scanner is held back in fields";
        outlier_sigmas: f64 = 4.0, "1", 1.0..=100.0,
            "Number of standard deviations beyond which a point is an outlier of its plane and left out (in scales of the loss), and a result contradicts its prediction",
            origin: "usual value",
            larger: "slower; failure of a gyroscope is detected later";
        scale_decay: f64 = 0.45, "1", 0.05..=0.99,
            "Factor by which the scale of the loss shrinks in every iteration",
            origin: "tuned",
            larger: "slower, larger basin of attraction";
        points_per_independent_one: f64 = 10.0, "points", 1.0..=1000.0,
            "Number of neighbouring points that count as one, since they share their error",
            origin: "tuned",
            larger: "more weight of the motion prior";
        small_step: f64 = 0.1, "1", 0.0..=10.0,
            "Step below which registration has converged, in standard deviations of the result (Newton decrement)",
            origin: "results with 0.03 to 0.25 differ by chance only (docs/experiments/2026-11-fewer-settings.md)",
            larger: "faster, less accurate";
    }
}

settings! {
    /// Which points of a sweep are registered, and when the result is accepted.
    SweepSettings {
        wanted_points: f32 = 3000.0, "points", 50.0..=1e6,
            "Number of points of a sweep that are registered, spread evenly over the sweep",
            origin: "measured on kitti_0001 (docs/experiments/2026-11-beams.md): with half as many, results scatter twice as far along the path",
            larger: "slower, less scatter";
        first_spacing_per_edge: f32 = 0.4, "1", 0.01..=5.0,
            "Spacing of the registered points in the first sweeps, as a fraction of the edge of the largest voxels; it adapts later",
            origin: "tuned",
            larger: "faster, less accurate starts";
    }
}

settings! {
    /// Criteria for a lost pose: sweeps that fit far worse than those before them.
    LossSettings {
        poor_fit_ratio: f64 = 0.5, "1", 0.0..=1.0,
            "Fraction of the usual fit below which a sweep contradicts the map, and other motions are tried, too; initial motions whose fit is below this fraction of the best are not tracked",
            origin: "measured (docs/experiments/2026-11-lost-in-3d.md): 0.9 and more where nothing is wrong, 0.14 to 0.37 for key frames with a wrong prediction of the motion, 0.10 to 0.26 after a cut in the recording",
            larger: "slower; more wrong predictions are detected; the pose is lost sooner; fewer hypotheses";
        poor_rms_ratio: f64 = 1.5, "1", 1.0..=100.0,
            "Minimum ratio of the root mean square distance of points from their planes to the usual one for a sweep with a poor fit to contradict the map; below it the sweep sees something new",
            origin: "measured (docs/experiments/2026-11-lost-in-3d.md): 1.9 to 4.7 after a cut in the recording",
            larger: "the pose is lost later";
        least_usual_fit: f64 = 0.25, "1", 0.0..=1.0,
            "Usual fit below which no sweep contradicts the map",
            origin: "between open country, 0.2, and streets and buildings, 0.38 and more",
            larger: "the pose is never lost in open country";
        sweeps: usize = 10, "sweeps", 2.0..=1000.0,
            "Number of sweeps for decisions that one sweep does not allow: which of several motions was correct; the usual fit (of up to twice as many); the loss of the pose, if half of them in succession contradict the map, or more than half of them do not fit while the motion is unmeasured. A map with fewer key frames is warming up, since errors of the first sweeps fit it",
            origin: "a second of sweeps; 40 to 90 % of the sweeps do not fit after failed starts, 0 to 2 % elsewhere (docs/experiments/2026-11-other-lidars.md)",
            larger: "later, more reliable starts; the pose is lost later";
        seconds: f64 = 1.0, "s", 0.0..=1e4,
            "Minimum time for which sweeps must contradict the map before the pose is lost, and for which they must fit no plane before the fallback map is asked",
            origin: "as in 2D: people pass by in less time",
            larger: "the pose is lost later; longer drift at constant velocity";
        occluded_reach: f64 = 3.0, "1", 1.0..=1e4,
            "Ratio of the usual reach to that of a sweep above which a sweep that contradicts the map counts as occluded",
            origin: "under covers the reach is a tenth of the usual one; no sweep of four real recordings and two simulated ones is left out (docs/experiments/2026-11-occlusion.md)",
            larger: "covers farther away are inserted into the map";
        longest_occlusion: f64 = 5.0, "s", 0.0..=1e4,
            "Maximum time for which occluded sweeps are left out",
            origin: "about as long as the motion can be predicted without sweeps",
            larger: "small places that contradict the map are mapped later";
        longest_wait: f64 = 8.0, "s", 0.0..=1e4,
            "Maximum time from the start of a piece of map that is lost at once to the start of the next one; the time doubles with each failure",
            origin: "bounds the number of pieces, and of sweeps in memory",
            larger: "the pose is found again later";
    }
}
