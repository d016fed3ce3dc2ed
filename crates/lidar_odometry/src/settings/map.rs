//! Settings of the map: planes, poles, key frames.

settings! {
    /// When the hits in a voxel are a plane, and when that plane is not reliable.
    PlaneFitSettings {
        range_noise: f64 = 0.02, "m", 0.001..=0.5,
            "Standard deviation of ranges; also the maximum standard deviation across a plane of the smallest voxels, the standard deviation of registered positions, and the minimum spacing of points",
            origin: "data sheets of spinning lidars",
            larger: "rough surfaces count as planes, too, and planes are less accurate; more weight of motion priors";
        normal_noise: f64 = 0.03, "rad", 0.0..=0.5,
            "Minimum standard deviation of normals, as surfaces are not flat and platforms tilt unnoticed; the noise of hits is added. A plane that beams meet at a smaller angle to its surface is at grazing incidence: its hits may be in the cone that a beam sweeps; the side of a plane is certain from three times this angle",
            origin: "tuned: floors and facades",
            larger: "more directions count as degenerate, far ground and long walls no longer hold the scanner";
        max_thickness_per_edge: f32 = 0.04, "1", 0.0..=0.3,
            "Addition to the maximum standard deviation across a plane, as a fraction of the edge of the voxel",
            origin: "tuned: large voxels may contain slightly curved surfaces",
            larger: "corners and curbs count as planes of large voxels";
        min_spread_ratio: f32 = 3.0, "1", 1.0..=20.0,
            "Minimum ratio of the standard deviation along a plane, in both directions, to that across it",
            origin: "tuned",
            larger: "fewer, more reliable planes; none from single scan lines";
        min_spread_per_edge: f32 = 0.06, "1", 0.0..=0.3,
            "Minimum standard deviation along a plane, as a fraction of the edge of the voxel",
            origin: "derived: hits of one beam alone spread less",
            larger: "fewer planes with sparse lidars";
        hits_per_independent_one: f32 = 6.0, "hits", 1.0..=100.0,
            "Number of hits of one sweep that count as one, since they share their errors",
            origin: "tuned",
            larger: "normals are less certain, and more directions count as degenerate";
        level_normal: f32 = 0.87, "1", 0.5..=1.0,
            "Vertical component of the normal above which a plane is level (30° from the vertical)",
            origin: "derived: normals of walls, cars, tree crowns and treads of stairs may point down slightly; with 0.7 the trajectory loses height on stairs",
            larger: "fewer planes count as having a downward normal";
        settled_hits: u16 = 50, "hits", 6.0..=400.0,
            "Number of hits of a plane above which no smaller voxels are kept",
            origin: "tuned: memory",
            larger: "more memory, more small planes beside large ones";
    }
}

settings! {
    /// The planar voxel maps around the scanner: sweeps are registered to the older one of two that overlap by half.
    LocalMapSettings {
        voxel_size: f64 = 1.0, "m", 0.05..=20.0,
            "Edge of the largest voxels",
            origin: "tuned: rooms and streets",
            larger: "faster, more planes in open country, fewer in small rooms";
        keyframes_per_half: u32 = 160, "key frames", 1.0..=1e6,
            "Number of key frames after which a new map is begun; each map takes twice as many",
            origin: "as submaps of Cartographer",
            larger: "less drift, more memory, later loop closures";
    }
}

settings! {
    /// Which sweeps are key frames.
    KeyframeSettings {
        max_time: f64 = 0.5, "s", 0.0..=1e6,
            "Maximum time between key frames; four times as long at rest, doubled with each, as another one from the same place is redundant",
            origin: "Cartographer",
            larger: "fewer key frames in slow motion and at rest";
        max_distance: f64 = 0.1, "m", 0.0..=1e6,
            "Distance from the last key frame above which a sweep is a key frame",
            origin: "Cartographer",
            larger: "fewer key frames";
        max_angle: f64 = 0.004, "rad", 0.0..=10.0,
            "Rotation from the last key frame above which a sweep is a key frame",
            origin: "Cartographer",
            larger: "fewer key frames in rotation";
    }
}

settings! {
    /// Vertical structures.
    PoleSettings {
        column: f32 = 0.5, "m", 0.1..=5.0,
            "Edge of columns, and minimum height of a vertical structure, so that ground at 45° is none",
            origin: "derived: wider than a trunk",
            larger: "bushes and curbs are left out";
        max_points: usize = 1000, "points", 1.0..=1e6,
            "Maximum number of points, sampled evenly in time",
            origin: "tuned: more points outweigh planes, which are far more accurate; 11,500 points of a street double its error",
            larger: "poles outweigh planes";
        neighbourhood: f32 = 0.35, "m", 0.05..=5.0,
            "Edge of each of the three by three columns in which walls are detected",
            origin: "tuned",
            larger: "wide trunks and hedges are taken for walls";
        final_scale: f64 = 0.2, "m", 0.02..=5.0,
            "Final scale of the loss, and spacing of the points; half of it is the standard deviation of a pair, and twice of it the maximum distance of paired points",
            origin: "derived: both points are on the same trunk, not at the same spot; the velocity of a walker changes by twice as much within a sweep",
            larger: "more weight of wrong pairs, less weight of poles relative to planes";
        memory: f64 = 2.0, "s", 0.1..=60.0,
            "Time for which points of sweeps are kept",
            origin: "tuned: with 1 s and with 3 s one of twelve walks among trees is lost",
            larger: "drifted points are kept longer";
    }
}
