//! Which verbs take which files.

use crate::samples::Kind;

/// A command line. `FILE` is the damaged file, `OUT` a name for results, `BAG` and `TUM` a sound recording and a sound
/// trajectory.
pub type Verb = &'static [&'static str];

/// The verbs that take a file of this kind, and some that take others.
pub fn taking(kind: Kind) -> &'static [Verb] {
    match kind {
        Kind::Recording => &[
            &["info", "FILE"],
            &["info", "FILE", "--json"],
            &["check", "FILE"],
            &["map", "FILE", "-o", "OUT", "--no-xray"],
            &["map", "FILE", "BAG", "-o", "OUT", "--no-xray"],
            &["evaluate", "cloud", "FILE", "TUM"],
            &["refine", "--recording", "FILE", "--trajectory", "TUM", "-o", "OUT"],
            &["compat", "cartographer_rosbag_validate", "-bag_filename", "FILE"],
            &["convert", "FILE", "-o", "OUT.tum"],
        ],
        Kind::Map => &[
            &["info", "FILE"],
            &["info", "FILE", "--all"],
            &["check", "FILE"],
            &["repair", "FILE", "-o", "OUT.pbstream"],
            &["migrate", "FILE", "OUT.pbstream"],
            &["render", "FILE", "-o", "OUT.png"],
            &["render", "FILE", "-o", "OUT.pgm"],
            &["optimize", "FILE", "-o", "OUT.pbstream"],
            &["edit", "FILE", "-o", "OUT.pbstream", "--rotate", "walls", "--optimize"],
            &["edit", "FILE", "-o", "OUT.pbstream", "--inside=-1,-1,3,3"],
            &["edit", "FILE", "-o", "OUT.pbstream", "--outside=-1,-1,3,3"],
            &["edit", "FILE", "-o", "OUT.pbstream", "--merge", "FILE"],
            &["convert", "FILE", "-o", "OUT.g2o"],
            &["convert", "FILE", "-o", "OUT.geojson"],
            &["evaluate", "generate", "FILE", "-o", "OUT.relations"],
            &["evaluate", "trajectory", "FILE", "TUM"],
            &["map", "BAG", "--from", "FILE", "-o", "OUT", "--duration", "1"],
            &["localize", "FILE", "BAG", "-o", "OUT", "--duration", "1"],
            &["localize", "FILE", "BAG", "-o", "OUT", "--duration", "1", "--save-map", "OUT.pbstream"],
            &["localize", "FILE", "BAG", "-o", "OUT", "--duration", "1", "--update", "OUT.pbstream"],
            &["refine", "--recording", "BAG", "--trajectory", "FILE", "-o", "OUT"],
        ],
        Kind::Graph => &[
            &["optimize", "FILE", "-o", "OUT.g2o"],
            &["optimize", "FILE", "-o", "OUT.g2o", "--loss", "cauchy", "--condition"],
            &["info", "FILE"],
            &["convert", "FILE", "-o", "OUT.tum"],
        ],
        Kind::Trajectory => &[
            &["convert", "FILE", "-o", "OUT.csv"],
            &["convert", "FILE", "-o", "OUT.g2o"],
            &["convert", "FILE", "-o", "OUT.kitti"],
            &["evaluate", "trajectory", "FILE", "TUM", "--rpe", "1"],
            &["evaluate", "trajectory", "TUM", "FILE"],
            &["evaluate", "cloud", "BAG", "FILE"],
            &["refine", "--recording", "BAG", "--trajectory", "FILE", "-o", "OUT"],
            &["check", "FILE"],
        ],
        Kind::Relations => &[&["evaluate", "relations", "TUM", "FILE"], &["info", "FILE"]],
        Kind::Surfaces => &[&["evaluate", "cloud", "BAG", "TUM", "--surfaces", "FILE"]],
        Kind::Cloud => &[
            &["evaluate", "cloud", "FILE"],
            &["evaluate", "cloud", "FILE", "--reference", "FILE"],
            &["register", "FILE", "FILE", "-o", "OUT"],
            &["register", "FILE", "FILE", "--method", "point-to-plane"],
            &["evaluate", "cloud", "BAG", "TUM", "--surfaces", "FILE"],
        ],
        Kind::Configuration => &[
            &["config", "check", "FILE"],
            &["map", "BAG", "--config", "FILE", "-o", "OUT", "--duration", "1"],
        ],
        Kind::Description => &[&["map", "BAG", "--urdf", "FILE", "-o", "OUT", "--duration", "1"]],
    }
}
