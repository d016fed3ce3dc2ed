//! Settings of registration.

settings! {
    /// How scans are registered to planes.
    RegistrationSettings {
        range_noise: f64 = 0.02, "m", 0.001..=0.5,
            "Standard deviation of ranges",
            origin: "data sheets of spinning lidars",
            larger: "the motion prior counts more";
        final_scale: f64 = 0.1, "m", 0.005..=5.0,
            "Points farther than about this from their plane count little in the end; the odometry takes a fraction of its voxels",
            origin: "a tenth of the default voxel",
            larger: "more outliers count";
        max_iterations: u32 = 20, "iterations", 1.0..=1000.0,
            "Iterations at most",
            origin: "tuned",
            larger: "slower";
        min_matched_fraction: f64 = 0.0, "1", 0.0..=1.0,
            "A result that puts a smaller fraction of the points on planes is of no use, and may be given up early",
            origin: "none wanted",
            larger: "faster where nothing fits";
        normal_noise: f64 = 0.03, "rad", 0.0..=0.5,
            "How far normals are off at least (standard deviation): surfaces are not flat. The noise of hits comes on top",
            origin: "tuned: floors and facades",
            larger: "more directions count as degenerate";
        uneven_factor: f32 = 4.0, "1", 0.0..=100.0,
            "A direction is constrained by so many times more information than uneven surfaces feign, which are off alike over metres",
            origin: "tuned: counted once, a field without odometry passes for constrained half of the time",
            larger: "more directions count as degenerate";
        noise_factor: f32 = 2.0, "1", 0.0..=100.0,
            "And by so many times more than the noise of hits feigns, which differs from plane to plane, so that its sum is known better",
            origin: "tuned: counted four times, walks that begin in a hall lose half a metre",
            larger: "more directions count as degenerate, most of all in young maps";
        grazing_weight: f32 = 0.0, "1", 0.0..=1.0,
            "How much planes at grazing incidence count: they may be drawn by the beams themselves, and hold the scanner where it was",
            origin: "tuned: with a tenth four of twelve walks through parks without odometry are lost, with nothing two",
            larger: "smoother on flat ground, held back among trees";
        downward_weight: f32 = 0.1, "1", 0.0..=1.0,
            "How much ground with a downward normal counts: with all of its weight a field seems to hold a lidar that is carried over it",
            origin: "tuned: a tenth and a fiftieth do not differ",
            larger: "held back in fields";
        cutoff: f32 = 3.0, "1", 1.0..=100.0,
            "Points farther than so many scales from their plane are left out",
            origin: "usual",
            larger: "slower, hardly different";
        scale_decay: f64 = 0.45, "1", 0.05..=0.99,
            "The scale of the loss shrinks by this with every iteration",
            origin: "tuned",
            larger: "slower, larger basin of attraction";
        small_translation: f64 = 5e-4, "m", 0.0..=0.1,
            "The end is found when it moves by less",
            origin: "a quarter of what it can be known to; a tenth is no nearer to the truth",
            larger: "faster, less exact";
        small_rotation: f64 = 5e-5, "rad", 0.0..=0.1,
            "The end is found when it turns by less",
            origin: "as for translation",
            larger: "faster, less exact";
        min_pairs: usize = 20, "points", 6.0..=1e6,
            "Fewer points on planes constrain nothing",
            origin: "a few for each of six unknowns",
            larger: "gives up in open country";
        points_per_independent_one: f64 = 10.0, "points", 1.0..=1000.0,
            "Neighbouring points share their error, so that so many count as one",
            origin: "tuned",
            larger: "the motion prior counts more";
        repairing_per_edge: f32 = 0.03, "1", 0.0..=0.5,
            "A point is paired anew when it has moved by this fraction of the edge of the largest voxels",
            origin: "tuned: time",
            larger: "faster, less exact";
        attenuation_distance: f64 = 0.03, "m", 0.0..=1.0,
            "Where normals are all that constrains a translation, planes hold the scanner so far from where it is: it goes so far until other planes are seen",
            origin: "tuned: 0.01 to 0.1 come out alike; without it errors in parks triple",
            larger: "the inertial prediction counts more";
        max_attenuation: f64 = 1.0, "m", 0.0..=100.0,
            "Attenuation is no larger than this",
            origin: "tuned",
            larger: "the inertial prediction counts more in open country";
    }
}

settings! {
    /// Which points of a sweep are registered, and when the result counts.
    SweepSettings {
        wanted_points: f32 = 3000.0, "points", 50.0..=1e6,
            "So many points of a sweep are registered, spread evenly over what it sees",
            origin: "measured on kitti_0001 (docs/experiments/2026-11-beams.md): half as many scatter twice as far along the way",
            larger: "slower, less scatter";
        first_spacing_per_edge: f32 = 0.4, "1", 0.01..=5.0,
            "Spacing of these points in the first sweep, as a fraction of the edge of the largest voxels; later ones adapt",
            origin: "tuned",
            larger: "fewer points at first";
        least_spacing: f32 = 0.02, "m", 0.001..=1.0,
            "Spacing at least",
            origin: "noise of ranges",
            larger: "fewer points in small rooms";
        largest_spacing: f32 = 5.0, "m", 0.1..=100.0,
            "Spacing at most",
            origin: "tuned",
            larger: "fewer points in open country";
        least_adaptation: f32 = 0.7, "1", 0.1..=1.0,
            "The spacing changes from sweep to sweep by this factor at least",
            origin: "tuned",
            larger: "adapts more slowly";
        largest_adaptation: f32 = 1.4, "1", 1.0..=10.0,
            "The spacing changes from sweep to sweep by this factor at most",
            origin: "the inverse of the least",
            larger: "adapts faster";
        final_scale_per_edge: f64 = 0.1, "1", 0.01..=1.0,
            "Scale of the loss at the end, as a fraction of the edge of the largest voxels",
            origin: "tuned",
            larger: "more outliers count";
        scale_per_sigma: f64 = 3.0, "1", 0.0..=10.0,
            "Points may be off at the beginning by so many standard deviations of the predicted translation",
            origin: "usual (docs/experiments/2026-11-cpu-time.md)",
            larger: "larger basin of attraction, slower";
        max_scale: f64 = 2.0, "m", 0.1..=20.0,
            "But not by more than this",
            origin: "tuned",
            larger: "larger basin of attraction after gaps";
        min_matched_fraction: f64 = 0.15, "1", 0.0..=1.0,
            "A result with a smaller fraction of points on planes does not count; among trees not much is flat",
            origin: "tuned",
            larger: "predictions are relied on more often";
        poor_rms: f64 = 0.1, "m", 0.001..=5.0,
            "Points that lie so far off their planes halve what a result is worth beside another",
            origin: "tuned",
            larger: "hypotheses are ranked by numbers of points alone";
        max_unfitting_time: f64 = 1.0, "s", 0.0..=1e6,
            "Where a gyroscope measures rotation, sweeps that fit no plane are believed to go on as before for so long; then another map is asked",
            origin: "tuned: grids of a bare place were drawn by the beams, and hold a scanner where it was",
            larger: "drifts longer with constant velocity";
        fallback_error: f64 = 0.2, "m", 0.01..=10.0,
            "Standard deviation of what another map says where sweeps fit no plane",
            origin: "two cells of a grid",
            larger: "the inertial filter believes it less";
    }
}

settings! {
    /// How degenerate scans are joined to intervals.
    DegeneracySettings {
        max_gap: f64 = 2.0, "s", 0.0..=1e6,
            "Scans farther apart than this belong to different intervals",
            origin: "chosen for reading",
            larger: "fewer, longer intervals";
        slow: f64 = 0.1, "m/s", 0.0..=10.0,
            "Below this speed the direction of motion is not known anew",
            origin: "drift of poses within a second",
            larger: "the direction of motion is kept longer";
        averaged_over: f64 = 1.0, "s", 0.01..=60.0,
            "Velocities are averaged over about this long",
            origin: "two steps of a walker",
            larger: "curves are noticed later";
    }
}

settings! {
    /// When the pose is lost: sweeps that fit far worse than those before them.
    LossSettings {
        poor_fit_ratio: f64 = 0.5, "1", 0.0..=1.0,
            "A sweep that fits by less than this fraction of what is usual is looked for with other motions, too",
            origin: "measured (docs/experiments/2026-11-lost-in-3d.md): 0.9 and more where nothing is wrong, 0.14 to 0.37 for key frames whose motion was predicted wrongly",
            larger: "slower, finds more of what is predicted wrongly";
        chance_fit_ratio: f64 = 0.35, "1", 0.0..=1.0,
            "A sweep that fits by less than this fraction of what is usual contradicts the map",
            origin: "measured there: 0.10 to 0.26 after a cut",
            larger: "lost sooner, now and then without reason";
        poor_rms_ratio: f64 = 1.5, "1", 1.0..=100.0,
            "And if its points on planes lie farther off than usual by this factor; otherwise it sees something new",
            origin: "measured there: 1.9 to 4.7 after a cut",
            larger: "lost later";
        least_usual_fit: f64 = 0.25, "1", 0.0..=1.0,
            "Where usual sweeps fit no better than this, nothing contradicts anything",
            origin: "between open country, 0.2, and streets and buildings, 0.38 and more",
            larger: "never lost in open country";
        remembered: usize = 20, "sweeps", 1.0..=1e4,
            "What is usual is the median of so many sweeps",
            origin: "two seconds",
            larger: "slower to get used to another place";
        least_remembered: usize = 8, "sweeps", 1.0..=1e4,
            "Fewer say nothing of what is usual",
            origin: "the median of fewer scatters",
            larger: "later able to notice";
        sweeps: u32 = 5, "sweeps", 1.0..=1e4,
            "So many sweeps in a row that contradict the map are no accident",
            origin: "as in 2D",
            larger: "lost later";
        seconds: f64 = 1.0, "s", 0.0..=1e4,
            "And only over this time",
            origin: "as in 2D: people pass faster",
            larger: "lost later";
        longest_wait: f64 = 8.0, "s", 0.0..=1e4,
            "Where pieces of map that begin are lost at once, the next begins after twice the time, this at most",
            origin: "bounds pieces, and sweeps in memory",
            larger: "found again later";
        guesses_among: usize = 10, "sweeps", 1.0..=1e4,
            "Where more than half of so many sweeps fit nothing, and no sensor tells the motion, a sweep that fits is chance",
            origin: "measured (docs/experiments/2026-11-other-lidars.md): 40 to 90 % of the sweeps fit nothing where starts failed, 0 to 2 % elsewhere",
            larger: "lost later";
    }
}
