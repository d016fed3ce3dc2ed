//! Settings of the start of a trajectory.

settings! {
    /// The start: waiting for gravity, and the first two sweeps.
    InitialisationSettings {
        leveling_time: f64 = 1.0, "s", 0.0..=60.0,
            "Time over which accelerations are averaged before the first sweep: about two steps of a walker. Sweeps wait as long for the first IMU sample before it is decided that there is no IMU; a standing platform must have been at rest, and registered at the same pose, for as long",
            origin: "derived; at rest, results with half to twice this time are alike",
            larger: "more accurate vertical, later start; standstill is detected later, and so is its end";
    }
}

settings! {
    /// Correlation of two sweeps with unknown motion.
    CorrelationSettings {
        cell: f32 = 0.5, "m", 0.05..=5.0,
            "Edge of columns of voxels; shifts are tried in steps of half of it",
            origin: "derived: registration corrects smaller offsets",
            larger: "faster, coarser";
        range: f32 = 60.0, "m", 1.0..=200.0,
            "Maximum distance of points to each side",
            origin: "derived: at this distance beams of a spinning lidar are as far apart as cars",
            larger: "slower";
        fastest: f64 = 40.0, "m/s", 0.1..=200.0,
            "Speed that determines the maximum shift between sweeps",
            origin: "cars on motorways",
            larger: "slower";
        farthest: f64 = 10.0, "m", 0.5..=50.0,
            "Maximum shift, whatever the time between sweeps",
            origin: "computing time",
            larger: "slower";
        widest: f64 = 0.3, "rad", 0.0..=3.2,
            "Maximum difference of tested headings from the initial one, to each side",
            origin: "computing time",
            larger: "slower";
        max_columns: usize = 500, "columns", 10.0..=1e6,
            "Maximum number of columns of a sweep that are compared, sampled evenly in order",
            origin: "computing time",
            larger: "slower";
        min_voxels: u32 = 30, "voxels", 1.0..=1e6,
            "Minimum number of upright voxels for a correlation",
            origin: "tuned",
            larger: "no correlation in open country";
        min_share: f64 = 0.38, "1", 0.0..=1.0,
            "Minimum fraction of a sweep that is met again at the best shift; below it the two sweeps do not show the same structures (drives with 16 to 64 lines: 0.40 to 0.91; lidars with non-repetitive scan patterns: 0.04 to 0.35, one 0.44)",
            origin: "measured (docs/experiments/2026-11-other-lidars.md)",
            larger: "slower starts";
        nearly_as_good: f64 = 0.8, "1", 0.0..=1.0,
            "Fraction of the highest maximum of the correlation above which local maxima are tracked",
            origin: "measured (docs/experiments/2026-11-starts.md)",
            larger: "fewer hypotheses";
        max_peaks: usize = 6, "places", 1.0..=100.0,
            "Maximum number of local maxima that are tracked",
            origin: "computing time",
            larger: "slower";
    }
}

settings! {
    /// The second, independent measurement of the distance travelled.
    WitnessSettings {
        span: f64 = 1.0, "s", 0.1..=10.0,
            "Time between the sweeps that are compared; those of half of it are combined. A distance that is unmeasured for 1.5 times as long is a guess",
            origin: "derived: a velocity error of 0.5 m/s amounts to a cell of the correlation",
            larger: "smaller errors are detected, but later; fewer structures are seen from both positions; longer guesses remain unreported";
        interval: f64 = 0.15, "s", 0.0..=60.0,
            "Minimum time between measurements where planes do not constrain translations",
            origin: "derived: a car that brakes hard is 5 cm from its prediction after this time",
            larger: "faster; changes of velocity are detected later";
    }
}

settings! {
    /// Estimation of the vertical from planes.
    VerticalSettings {
        max_tilt: f64 = 0.8, "rad", 0.01..=1.6,
            "Maximum assumed tilt of the scanner",
            origin: "lidars are mounted about upright",
            larger: "walls may be taken for floors";
        tolerances: [f64; 4] = [0.35, 0.2, 0.1, 0.06], "rad", 0.01..=0.7,
            "Maximum angles from level or upright of the planes that are used, from the first candidates to the last iteration",
            origin: "tuned",
            larger: "ramps bias the vertical";
        min_fraction: f64 = 0.3, "1", 0.0..=1.0,
            "Minimum fraction of all planes, by their hits, that are floors, ceilings and walls of the result",
            origin: "tuned",
            larger: "the scanner is assumed to be level more often";
        max_hits_per_plane: u32 = 200, "hits", 1.0..=1e9,
            "Maximum weight of a plane, in hits",
            origin: "tuned: near ground has the most hits",
            larger: "near ground dominates";
    }
}
