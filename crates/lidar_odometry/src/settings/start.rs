//! Settings of the start of a trajectory.

settings! {
    /// The start: waiting for gravity, and the first two sweeps.
    InitialisationSettings {
        leveling_time: f64 = 1.0, "s", 0.0..=60.0,
            "Accelerations are averaged over this before the first sweep: about two steps of a walker. Sweeps wait as long for the first IMU sample before it is decided that there is no IMU; and a platform that stands has rested, and was registered where it had been, for as long",
            origin: "derived; at rest half to twice as much come out alike",
            larger: "better level, later start; standing is found later, starts are, too";
    }
}

settings! {
    /// Correlation of two sweeps with unknown motion.
    CorrelationSettings {
        cell: f32 = 0.5, "m", 0.05..=5.0,
            "Edge of columns of voxels; shifts are tried in steps of half of it",
            origin: "derived: registration brings together what is off by less",
            larger: "faster, coarser";
        range: f32 = 60.0, "m", 1.0..=200.0,
            "Points farther to a side are left out",
            origin: "derived: beams of a spinning lidar are as far apart as cars there",
            larger: "slower";
        fastest: f64 = 40.0, "m/s", 0.1..=200.0,
            "Shifts are tried up to what this speed covers from one sweep to the next",
            origin: "cars on motorways",
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
        max_peaks: usize = 6, "places", 1.0..=100.0,
            "So many are followed at most",
            origin: "time",
            larger: "slower";
    }
}

settings! {
    /// The second, independent measurement of the distance travelled.
    WitnessSettings {
        span: f64 = 1.0, "s", 0.1..=10.0,
            "Sweeps are compared with those so long before, those of half of this together; what nothing tells for half as long again is a guess",
            origin: "derived: a velocity that is wrong by 0.5 m/s shows as a cell of the correlation",
            larger: "smaller errors are seen, later; less is seen from both places; long guesses are not told";
        interval: f64 = 0.15, "s", 0.0..=60.0,
            "Where planes leave translations open it is asked again after so many seconds",
            origin: "derived: a car that brakes hard is 5 cm off by then",
            larger: "faster; changes of velocity are seen later";
    }
}

settings! {
    /// Estimation of the vertical from planes.
    VerticalSettings {
        max_tilt: f64 = 0.8, "rad", 0.01..=1.6,
            "The scanner is assumed to be tilted less than this",
            origin: "lidars are mounted about upright",
            larger: "walls may pass for floors";
        tolerances: [f64; 4] = [0.35, 0.2, 0.1, 0.06], "rad", 0.01..=0.7,
            "Planes this near to level or upright count, from the first candidates to the last iteration",
            origin: "tuned",
            larger: "ramps pull the vertical";
        min_fraction: f64 = 0.3, "1", 0.0..=1.0,
            "And so large a fraction of them on floors, ceilings and walls as found",
            origin: "tuned",
            larger: "level is assumed more often";
        max_hits_per_plane: u32 = 200, "hits", 1.0..=1e9,
            "A plane counts by its hits, but not by more than this",
            origin: "tuned: near ground has most",
            larger: "near ground decides";
    }
}
