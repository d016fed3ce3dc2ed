//! Settings of the map: planes, poles, key frames.

settings! {
    /// When the hits in a voxel are a plane, and when that plane is not reliable.
    PlaneFitSettings {
        range_noise: f64 = 0.02, "m", 0.001..=0.5,
            "Standard deviation of ranges: across a plane at most, for the smallest voxels; of registered places; and the least spacing of points",
            origin: "data sheets of spinning lidars",
            larger: "rough surfaces are planes, too, and worse ones; motion priors count more";
        normal_noise: f64 = 0.03, "rad", 0.0..=0.5,
            "How far normals are off at least (standard deviation), as surfaces are not flat and platforms tilt unnoticed; the noise of hits comes on top. Planes seen at less than this angle are at grazing incidence: their hits may lie in the cone that a beam sweeps; the side of a plane is known from three times as much",
            origin: "tuned: floors and facades",
            larger: "more directions count as degenerate, far ground and long walls no longer hold the scanner";
        max_thickness_per_edge: f32 = 0.04, "1", 0.0..=0.3,
            "What is added to that, as a fraction of the edge of the voxel",
            origin: "tuned: large voxels may hold slightly curved surfaces",
            larger: "corners and curbs pass for planes of large voxels";
        min_spread_ratio: f32 = 3.0, "1", 1.0..=20.0,
            "Standard deviation along a plane at least, in both directions, as a multiple of that across",
            origin: "tuned",
            larger: "fewer, surer planes; single scan lines make none";
        min_spread_per_edge: f32 = 0.06, "1", 0.0..=0.3,
            "Standard deviation along a plane at least, as a fraction of the edge of the voxel",
            origin: "derived: one beam alone spreads less",
            larger: "sparse lidars see fewer planes";
        hits_per_independent_one: f32 = 6.0, "hits", 1.0..=100.0,
            "Hits of one sweep share their errors, so that so many count as one",
            origin: "tuned",
            larger: "normals count as less certain, and more directions as degenerate";
        level_normal: f32 = 0.87, "1", 0.5..=1.0,
            "A plane whose normal has a larger vertical component is level (30° from the vertical)",
            origin: "derived: walls, cars, tree crowns and treads of stairs may look down a bit; with 0.7 stairs lose height",
            larger: "fewer planes count as seen from below";
        settled_hits: u16 = 50, "hits", 6.0..=400.0,
            "Once so many hits make a plane, no smaller voxels are kept there",
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
            larger: "faster, more planes in open country, fewer where rooms are small";
        keyframes_per_half: u32 = 160, "key frames", 1.0..=1e6,
            "A new map is begun after so many key frames, and takes twice as many",
            origin: "as submaps of Cartographer",
            larger: "less drift, more memory, later loop closures";
    }
}

settings! {
    /// Which sweeps are key frames.
    KeyframeSettings {
        max_time: f64 = 0.5, "s", 0.0..=1e6,
            "A sweep this long after the last key frame is one; four times as long at rest, doubled with each, as one from the same place tells nothing new",
            origin: "Cartographer",
            larger: "fewer key frames in slow motion and at rest";
        max_distance: f64 = 0.1, "m", 0.0..=1e6,
            "A sweep this far from the last key frame is one",
            origin: "Cartographer",
            larger: "fewer key frames";
        max_angle: f64 = 0.004, "rad", 0.0..=10.0,
            "A sweep rotated by this from the last key frame is one",
            origin: "Cartographer",
            larger: "fewer key frames in rotation";
    }
}

settings! {
    /// Vertical structures.
    PoleSettings {
        column: f32 = 0.5, "m", 0.1..=5.0,
            "Edge of columns: a vertical structure is at least as high, as ground at 45° is not",
            origin: "derived: wider than a trunk",
            larger: "bushes and curbs are left out";
        max_points: usize = 1000, "points", 1.0..=1e6,
            "So many points at most, evenly in time",
            origin: "tuned: more outweigh planes, which are known far better; 11,500 of a street double its error",
            larger: "poles outweigh planes";
        neighbourhood: f32 = 0.35, "m", 0.05..=5.0,
            "Walls are looked for in three by three columns of this edge",
            origin: "tuned",
            larger: "wide trunks and hedges pass for walls";
        final_scale: f64 = 0.2, "m", 0.02..=5.0,
            "Scale of the loss at the end, and spacing of the points; half of it is the standard deviation of a pair, and points twice as far off are not paired",
            origin: "derived: both have met the same trunk, not the same spot; a walker's velocity changes by twice as much within a sweep",
            larger: "wrong pairs count more, poles less beside planes";
        memory: f64 = 2.0, "s", 0.1..=60.0,
            "Points of sweeps of so many seconds are kept",
            origin: "tuned: 1 s and 3 s lost one of twelve walks among trees",
            larger: "what drifted is held longer";
    }
}
