//! Settings of registration.

settings! {
    /// Registration of scans to planes.
    RegistrationSettings {
        final_scale_per_edge: f64 = 0.1, "1", 0.01..=1.0,
            "Points farther than about this from their plane, as a fraction of the edge of the largest voxels, count little in the end; as far off they halve what a result is worth beside another",
            origin: "tuned",
            larger: "more outliers count, hypotheses are ranked by numbers of points alone";
        min_matched_fraction: f64 = 0.15, "1", 0.0..=1.0,
            "A result that puts a smaller fraction of the points on planes is of no use, and may be given up early; among trees not much is flat",
            origin: "tuned",
            larger: "predictions are relied on more often";
        uneven_factor: f32 = 4.0, "1", 0.0..=100.0,
            "A direction is constrained by so many times more information than uneven surfaces feign, which are off alike over metres; the noise of hits differs from plane to plane, so that its sum is known better, and counts once",
            origin: "tuned: counted once, a field without odometry passes for constrained half of the time",
            larger: "more directions count as degenerate";
        grazing_weight: f32 = 0.0, "1", 0.0..=1.0,
            "How much planes at grazing incidence count: they may be drawn by the beams themselves, and hold the scanner where it was",
            origin: "tuned: with a tenth four of twelve walks through parks without odometry are lost, with nothing two",
            larger: "smoother on flat ground, held back among trees";
        downward_weight: f32 = 0.1, "1", 0.0..=1.0,
            "How much ground with a downward normal counts: with all of its weight a field seems to hold a lidar that is carried over it",
            origin: "tuned: a tenth and a fiftieth do not differ",
            larger: "held back in fields";
        outlier_sigmas: f64 = 4.0, "1", 1.0..=100.0,
            "What is so many standard deviations off belongs to something else: a point so many scales from its plane is left out, a result that far from what was predicted contradicts it",
            origin: "usual",
            larger: "slower; a failing gyroscope is noticed later";
        scale_decay: f64 = 0.45, "1", 0.05..=0.99,
            "The scale of the loss shrinks by this with every iteration",
            origin: "tuned",
            larger: "slower, larger basin of attraction";
        points_per_independent_one: f64 = 10.0, "points", 1.0..=1000.0,
            "Neighbouring points share their error, so that so many count as one",
            origin: "tuned",
            larger: "the motion prior counts more";
        small_step: f64 = 0.1, "1", 0.0..=10.0,
            "The end is found when a step is smaller than so many standard deviations of the result (Newton decrement)",
            origin: "0.03 to 0.25 differ by chance (docs/experiments/2026-11-fewer-settings.md)",
            larger: "faster, less exact";
    }
}

settings! {
    /// Which points of a sweep are registered, and when the result is accepted.
    SweepSettings {
        wanted_points: f32 = 3000.0, "points", 50.0..=1e6,
            "So many points of a sweep are registered, spread evenly over what it sees",
            origin: "measured on kitti_0001 (docs/experiments/2026-11-beams.md): half as many scatter twice as far along the way",
            larger: "slower, less scatter";
        first_spacing_per_edge: f32 = 0.4, "1", 0.01..=5.0,
            "Spacing of these points in the first sweeps, as a fraction of the edge of the largest voxels; later ones adapt",
            origin: "tuned",
            larger: "faster and less exact starts";
    }
}

settings! {
    /// Criteria for a lost pose: sweeps that fit far worse than those before them.
    LossSettings {
        poor_fit_ratio: f64 = 0.5, "1", 0.0..=1.0,
            "A sweep that fits by less than this fraction of what is usual contradicts the map, and is looked for with other motions, too; of first motions that fit by less than this fraction of the best none is followed",
            origin: "measured (docs/experiments/2026-11-lost-in-3d.md): 0.9 and more where nothing is wrong, 0.14 to 0.37 for key frames whose motion was predicted wrongly, 0.10 to 0.26 after a cut",
            larger: "slower, finds more of what is predicted wrongly; lost sooner; fewer hypotheses";
        poor_rms_ratio: f64 = 1.5, "1", 1.0..=100.0,
            "And if its points on planes lie farther off than usual by this factor; otherwise it sees something new",
            origin: "measured there: 1.9 to 4.7 after a cut",
            larger: "lost later";
        least_usual_fit: f64 = 0.25, "1", 0.0..=1.0,
            "Where usual sweeps fit no better than this, nothing contradicts anything",
            origin: "between open country, 0.2, and streets and buildings, 0.38 and more",
            larger: "never lost in open country";
        sweeps: usize = 10, "sweeps", 2.0..=1000.0,
            "So many sweeps tell what one does not: which of several motions was right; what usually fits, of twice as many; that it is lost, if more than half of them contradict the map or fit nothing; and a map of as many key frames is warm, as what the first ones got wrong fits it",
            origin: "a second; 40 to 90 % of the sweeps fit nothing where starts failed, 0 to 2 % elsewhere (docs/experiments/2026-11-other-lidars.md)",
            larger: "later starts, surer ones; lost later";
        seconds: f64 = 1.0, "s", 0.0..=1e4,
            "A pose is lost only if sweeps contradict the map for so long; another map is asked where they fit no plane for so long",
            origin: "as in 2D: people pass faster",
            larger: "lost later; drifts longer with constant velocity";
        occluded_reach: f64 = 3.0, "1", 1.0..=1e4,
            "Something hides the place from a sweep that contradicts the map and sees less far than usual by this factor",
            origin: "covers see a tenth of what is usual; no sweep of four real recordings and two simulated ones is left out (docs/experiments/2026-11-occlusion.md)",
            larger: "covers farther away are drawn into the map";
        longest_occlusion: f64 = 5.0, "s", 0.0..=1e4,
            "Such sweeps are left out for so long",
            origin: "about as long as the motion can be told without sweeps",
            larger: "small places that the map contradicts are entered later";
        longest_wait: f64 = 8.0, "s", 0.0..=1e4,
            "Where pieces of map that begin are lost at once, the next begins after twice the time, this at most",
            origin: "bounds pieces, and sweeps in memory",
            larger: "found again later";
    }
}
