//! Settings of the map: planes, poles, key frames.

settings! {
    /// When the hits in a voxel are a plane, and when that plane is not to be relied on.
    PlaneFitSettings {
        max_thickness: f32 = 0.02, "m", 0.001..=0.2,
            "Standard deviation across a plane at most, for the smallest voxels",
            origin: "derived: noise of spinning lidars",
            larger: "rough surfaces are planes, too, and worse ones";
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
        grazing_angle: f32 = 0.03, "rad", 0.0..=0.5,
            "Planes seen at less than this angle are at grazing incidence: their hits may lie in the cone that a beam sweeps",
            origin: "derived: what a platform tilts by unnoticed",
            larger: "far ground and long walls no longer hold the scanner";
        level_normal: f32 = 0.87, "1", 0.5..=1.0,
            "A plane whose normal has a larger vertical component is level (30° from the vertical)",
            origin: "derived: walls, cars, tree crowns and treads of stairs may look down a bit; with 0.7 stairs lose height",
            larger: "fewer planes count as seen from below";
        min_side: f32 = 0.1, "1", 0.0..=0.5,
            "Cosine of the angle of incidence from which the side of a plane is known",
            origin: "tuned",
            larger: "floors and the ceilings below them are told apart less often";
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
        warm_up_keyframes: u32 = 10, "key frames", 0.0..=1e6,
            "A map of fewer is warming up: single sweeps show few planes, and what the first ones got wrong fits it",
            origin: "derived: a second of sweeps",
            larger: "the bias of the gyroscope is learned later";
    }
}

settings! {
    /// Which sweeps are key frames.
    KeyframeSettings {
        max_time: f64 = 0.5, "s", 0.0..=1e6,
            "A sweep this long after the last key frame is one",
            origin: "Cartographer",
            larger: "fewer key frames in slow motion";
        max_distance: f64 = 0.1, "m", 0.0..=1e6,
            "A sweep this far from the last key frame is one",
            origin: "Cartographer",
            larger: "fewer key frames";
        max_angle: f64 = 0.004, "rad", 0.0..=10.0,
            "A sweep rotated by this from the last key frame is one",
            origin: "Cartographer",
            larger: "fewer key frames in rotation";
        standing_interval: f64 = 2.0, "s", 0.0..=1e6,
            "Seconds between key frames at rest, doubled with each: one from the same place tells nothing new",
            origin: "tuned",
            larger: "smaller maps of long stops";
        longest_standing_interval: f64 = 16.0, "s", 0.0..=1e6,
            "Seconds between key frames at rest at most",
            origin: "tuned",
            larger: "what changes around a standing scanner is mapped later";
    }
}

settings! {
    /// Vertical structures.
    PoleSettings {
        column: f32 = 0.5, "m", 0.1..=5.0,
            "Edge of the columns that are compared with the height of what is in them",
            origin: "derived: wider than a trunk",
            larger: "slopes pass for vertical structures";
        min_height: f32 = 0.5, "m", 0.1..=10.0,
            "A vertical structure reaches so high in its column; ground at 45° does not",
            origin: "derived from the column",
            larger: "bushes and curbs are left out";
        foot: f32 = 0.3, "m", 0.0..=5.0,
            "The ground around a vertical structure reaches so high",
            origin: "tuned",
            larger: "less ground, fewer points";
        spacing: f32 = 0.2, "m", 0.02..=5.0,
            "Spacing of points",
            origin: "tuned",
            larger: "fewer points";
        max_points: usize = 1000, "points", 1.0..=1e6,
            "So many points at most, evenly in time",
            origin: "tuned: more outweigh planes, which are known far better; 11,500 of a street double its error",
            larger: "poles outweigh planes";
        neighbourhood: f32 = 0.35, "m", 0.05..=5.0,
            "Walls are looked for in three by three columns of this edge",
            origin: "tuned",
            larger: "wide trunks and hedges pass for walls";
        wall_length: f32 = 0.15, "m", 0.02..=5.0,
            "Points of a wall spread so far along it (standard deviation)",
            origin: "tuned",
            larger: "short pieces of wall constrain motion along them, wrongly";
        wall_elongation: f32 = 3.0, "1", 1.0..=100.0,
            "And so many times farther than across it",
            origin: "tuned",
            larger: "rough walls constrain motion along them, wrongly";
        reach: f32 = 0.4, "m", 0.05..=5.0,
            "Points farther off than this are not paired",
            origin: "derived: what a walker's velocity changes by within a sweep",
            larger: "faster motion is caught, neighbouring trunks are confused";
        height_weight: f32 = 0.5, "1", 0.0..=10.0,
            "Squared differences of height count so much when the nearest point is looked for",
            origin: "tuned",
            larger: "points are paired with those of the same height";
        final_scale: f64 = 0.2, "m", 0.02..=5.0,
            "Scale of the loss at the end",
            origin: "derived: both have met the same trunk, not the same spot",
            larger: "wrong pairs count more";
        noise: f32 = 0.1, "m", 0.01..=2.0,
            "Standard deviation of a pair",
            origin: "derived: as the scale",
            larger: "poles count less beside planes";
        memory: f64 = 2.0, "s", 0.1..=60.0,
            "Points of sweeps of so many seconds are kept",
            origin: "tuned: 1 s and 3 s lost one of twelve walks among trees",
            larger: "what drifted is held longer";
    }
}
