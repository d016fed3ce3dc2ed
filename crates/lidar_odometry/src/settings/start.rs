//! Settings of the start of a trajectory.

settings! {
    /// The start: waiting for gravity, and the first two sweeps.
    InitialisationSettings {
        imu_wait: f64 = 1.0, "s", 0.0..=60.0,
            "Sweeps wait this long for the first IMU sample before it is decided that there is no IMU",
            origin: "tuned",
            larger: "a later start without an IMU";
        leveling_time: f64 = 1.0, "s", 0.0..=60.0,
            "Accelerations are averaged over this before the first sweep: about two steps of a walker",
            origin: "derived",
            larger: "better level, later start";
        min_matched_fraction: f64 = 0.3, "1", 0.0..=1.0,
            "A result with a smaller fraction of points on planes does not count, unless a gyroscope measures rotation and all translations are constrained",
            origin: "tuned",
            larger: "first velocities are zero more often";
        scale: f64 = 0.5, "m", 0.01..=5.0,
            "Points may be off by this once velocities have been found coarsely",
            origin: "tuned",
            larger: "larger basin of attraction";
        spacing: f32 = 0.4, "m", 0.02..=5.0,
            "Spacing of the points that are registered",
            origin: "tuned",
            larger: "faster, less exact";
        same_motion: f64 = 0.4, "m", 0.01..=10.0,
            "Motions between the first two sweeps that differ by less are one hypothesis",
            origin: "derived: registration brings them together",
            larger: "fewer hypotheses";
        similar_fit: f64 = 0.6, "1", 0.0..=1.0,
            "Motions that fit by this fraction of the best are hypotheses that the next sweeps judge",
            origin: "measured (docs/experiments/2026-11-starts.md)",
            larger: "fewer hypotheses";
        max_hypotheses: usize = 4, "hypotheses", 1.0..=100.0,
            "So many are judged at most",
            origin: "time",
            larger: "slower starts";
        judged_sweeps: usize = 10, "sweeps", 2.0..=1000.0,
            "Hypotheses of the first motion are judged after so many sweeps",
            origin: "a second",
            larger: "later starts, surer ones";
        clearly_better: f64 = 1.1, "1", 1.0..=10.0,
            "A motion that fits the first two sweeps less well than another has to fit the next ones so many times better; along a tunnel all fit alike",
            origin: "measured (docs/experiments/2026-11-starts.md)",
            larger: "the first two sweeps decide";
    }
}

settings! {
    /// Correlation of two sweeps when nothing is known of the motion.
    CorrelationSettings {
        cell: f32 = 0.5, "m", 0.05..=5.0,
            "Edge of columns of voxels; shifts are tried in steps of half of it",
            origin: "derived: registration brings together what is off by less",
            larger: "faster, coarser";
        layer: f32 = 0.25, "m", 0.05..=2.0,
            "Height of voxels. What stands upright has points in its column that are two to four voxels higher or lower",
            origin: "derived: less than a car is high, more than slopes rise in a column",
            larger: "low things are left out";
        range: f32 = 60.0, "m", 1.0..=200.0,
            "Points farther to a side are left out",
            origin: "derived: beams of a spinning lidar are as far apart as cars there",
            larger: "slower";
        fastest: f64 = 40.0, "m/s", 0.1..=200.0,
            "Shifts are tried up to what this speed covers from one sweep to the next",
            origin: "cars on motorways",
            larger: "slower";
        fastest_turn: f64 = 2.0, "rad/s", 0.0..=20.0,
            "Headings are tried up to what this rate covers, where no gyroscope measured the rotation",
            origin: "a hand that turns quickly",
            larger: "slower";
        farthest: f64 = 10.0, "m", 0.5..=50.0,
            "No shift is tried that is longer, however long it is from sweep to sweep",
            origin: "time",
            larger: "slower";
        widest: f64 = 0.3, "rad", 0.0..=3.2,
            "No heading is tried that is farther off",
            origin: "time",
            larger: "slower";
        max_columns: usize = 500, "columns", 10.0..=1e6,
            "So many columns of a sweep are compared at most, evenly in order",
            origin: "time",
            larger: "slower";
        min_voxels: u32 = 30, "voxels", 1.0..=1e6,
            "Fewer that stand upright tell nothing",
            origin: "tuned",
            larger: "gives up in open country";
        min_share: f64 = 0.38, "1", 0.0..=1.0,
            "Where less of a sweep is met again at the best place, two sweeps do not show the same things (drives with 16 to 64 lines: 0.40 to 0.91; lidars that scan otherwise each time: 0.04 to 0.35, one 0.44)",
            origin: "measured (docs/experiments/2026-11-other-lidars.md)",
            larger: "slower starts";
        nearly_as_good: f64 = 0.8, "1", 0.0..=1.0,
            "Local maxima of the correlation that reach this fraction of the highest are followed",
            origin: "measured (docs/experiments/2026-11-starts.md)",
            larger: "fewer hypotheses";
        as_good: f64 = 0.9, "1", 0.0..=1.0,
            "Where no motion, or the expected one, reaches this fraction of the highest, it is followed, too: along a tunnel all do",
            origin: "measured (docs/experiments/2026-11-starts.md)",
            larger: "fewer hypotheses";
        max_peaks: usize = 6, "places", 1.0..=100.0,
            "So many are followed at most",
            origin: "time",
            larger: "slower";
    }
}

settings! {
    /// The second witness of the way travelled.
    WitnessSettings {
        span: f64 = 1.0, "s", 0.1..=10.0,
            "Sweeps are compared with those so long before",
            origin: "derived: a velocity that is wrong by 0.5 m/s shows as a cell of the correlation",
            larger: "smaller errors are seen, later; less is seen from both places";
        group: f64 = 0.5, "s", 0.0..=10.0,
            "Sweeps of so many seconds are put together",
            origin: "derived: several thousand points where sweeps have 1,400",
            larger: "sparser sweeps tell something, changes of velocity blur it";
        interval: f64 = 0.15, "s", 0.0..=60.0,
            "Where planes leave translations open it is asked again after so many seconds",
            origin: "derived: a car that brakes hard is 5 cm off by then",
            larger: "faster; changes of velocity are seen later";
        acceleration: f64 = 4.0, "m/s²", 0.1..=100.0,
            "What is believed goes wrong by no more than such an acceleration since the witness last agreed",
            origin: "walkers, braking cars",
            larger: "cars ahead are taken for what stands";
        farthest: f64 = 5.0, "m", 0.5..=50.0,
            "And by no more than this",
            origin: "derived: what a cell of the correlation from one sweep to the next is worth in a second",
            larger: "slower; cars ahead are taken for what stands";
        least_share: f64 = 0.15, "1", 0.0..=1.0,
            "Where less of the newest sweeps is met again, it is chance",
            origin: "measured (docs/experiments/2026-11-few-points.md)",
            larger: "says less";
        guess: f64 = 1.5, "s", 0.0..=1e4,
            "Where neither planes nor the witness tell the way for so long, and nothing measures it, it is a guess",
            origin: "derived: half as long again as the span",
            larger: "long guesses are not told";
        max_points: usize = 6000, "points", 10.0..=1e6,
            "So many points of a sweep are looked at, at most, evenly in order",
            origin: "time",
            larger: "slower";
    }
}

settings! {
    /// The vertical from planes.
    VerticalSettings {
        max_tilt: f64 = 0.8, "rad", 0.01..=1.6,
            "The scanner is assumed to be tilted less than this",
            origin: "lidars are mounted about upright",
            larger: "walls may pass for floors";
        tolerances: [f64; 4] = [0.35, 0.2, 0.1, 0.06], "rad", 0.01..=0.7,
            "Planes this near to level or upright count, from the first iteration to the last",
            origin: "tuned",
            larger: "ramps pull the vertical";
        wall_weight: f64 = 0.5, "1", 0.0..=10.0,
            "A wall counts so much beside a floor, because it fixes only one direction",
            origin: "tuned",
            larger: "leaning walls pull the vertical";
        min_hits: f64 = 500.0, "hits", 0.0..=1e9,
            "So many hits on planes are needed",
            origin: "tuned",
            larger: "level is assumed more often";
        min_fraction: f64 = 0.3, "1", 0.0..=1.0,
            "And so large a fraction of them on floors, ceilings and walls as found",
            origin: "tuned",
            larger: "level is assumed more often";
        max_hits_per_plane: u32 = 200, "hits", 1.0..=1e9,
            "A plane counts by its hits, but not by more than this",
            origin: "tuned: near ground has most",
            larger: "near ground decides";
        level_cosine: f64 = 0.97, "1", 0.5..=1.0,
            "Planes whose normals lie this near to a candidate support it as floors",
            origin: "14°",
            larger: "fewer candidates win";
        upright_cosine: f64 = 0.15, "1", 0.0..=0.7,
            "Planes whose normals lie this near to right angles with a candidate support it as walls",
            origin: "9°",
            larger: "more walls count";
    }
}
