//! Small sound files of every format, made by the program itself; and those of the real data that are small.

use std::path::Path;

use portolan_testing::damage::Layout;

use crate::common::{portolan, portolan_with_code, real, text};

/// Type of a file, which determines the verbs that read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Recording,
    Map,
    Graph,
    Trajectory,
    Relations,
    Cloud,
    Surfaces,
    Configuration,
    Description,
}

/// A sound file.
pub struct Sample {
    /// Its name, whose ending counts for some readers.
    pub name: String,
    pub kind: Kind,
    /// How its records are distinguished.
    pub layout: Layout,
    pub bytes: Vec<u8>,
    /// A sound recording and a sound trajectory of the same drive, for verbs that take two files.
    pub recording: String,
    pub trajectory: String,
}

/// Real files that are small enough, with their kinds.
const REAL: [(&str, Kind, Layout); 6] = [
    ("hostile/D2_min.db3", Kind::Recording, Layout::Pages(4096)),
    ("hostile/D10_chunk.bag", Kind::Recording, Layout::Bag),
    ("hostile/D1_ntp.bag", Kind::Recording, Layout::Bag),
    ("hostile/D9_attr.e57", Kind::Cloud, Layout::E57),
    ("maps/reference/small_2d.pbstream", Kind::Map, Layout::Pbstream),
    ("configs/backpack_2d.urdf", Kind::Description, Layout::Lines),
];

/// Makes all of them.
pub fn make(folder: &Path) -> Vec<Sample> {
    let at = |name: &str| text(&folder.join(name));
    let walk = ["simulate", "corridors", "--seconds", "5", "--seed", "5", "--beams", "60", "-q", "-o"];
    portolan_with_code(0, &[&walk[..], &[&at("walk.bag")]].concat());
    portolan_with_code(0, &[&walk[..], &[&at("walk.mcap")]].concat());
    let space = [
        "simulate",
        "tunnel",
        "--seconds",
        "2",
        "--seed",
        "5",
        "--lidar",
        "vlp-16",
        "--beams",
        "60",
        "-q",
        "-o",
    ];
    let has_3d = portolan(&[&space[..], &[&at("space.bag")]].concat()).code == Some(0);
    portolan_with_code(0, &["map", &at("walk.bag"), "-o", &at("m"), "-q"]);
    let (map, truth) = (at("m/map.pbstream"), at("walk.truth.tum"));
    std::fs::copy(&map, at("walk.pbstream")).unwrap();
    for name in ["walk.g2o", "walk.geojson"] {
        portolan_with_code(0, &["convert", &map, "-o", &at(name), "-q"]);
    }
    for name in ["walk.csv", "walk.kitti"] {
        portolan_with_code(0, &["convert", &truth, "-o", &at(name), "-q"]);
    }
    std::fs::write(at("walk.relations"), "1.0 2.0 0.5 0 0 0 0 0.1\n1.5 3.0 0.9 0.1 0 0 0 0.2\n").unwrap();
    std::fs::write(at("boxes.csv"), "# walls\n0,0,0,1,1,1\n-3,-2,0,-2,2,2.5\n").unwrap();
    let lua = portolan_with_code(0, &["config", "show", "--lua"]).stdout;
    std::fs::write(at("robot.lua"), lua).unwrap();
    clouds(folder);
    let mut samples = vec![
        ("walk.bag", Kind::Recording, Layout::Bag),
        ("walk.mcap", Kind::Recording, Layout::Mcap),
        ("walk.pbstream", Kind::Map, Layout::Pbstream),
        ("walk.g2o", Kind::Graph, Layout::Lines),
        ("walk.truth.tum", Kind::Trajectory, Layout::Lines),
        ("walk.csv", Kind::Trajectory, Layout::Lines),
        ("walk.kitti", Kind::Trajectory, Layout::Lines),
        ("walk.geojson", Kind::Trajectory, Layout::Tokens),
        ("walk.relations", Kind::Relations, Layout::Lines),
        ("boxes.csv", Kind::Surfaces, Layout::Lines),
        ("robot.lua", Kind::Configuration, Layout::Lines),
        ("a.ply", Kind::Cloud, Layout::HeaderThenRows),
        ("b.ply", Kind::Cloud, Layout::Lines),
        ("a.pcd", Kind::Cloud, Layout::HeaderThenRows),
        ("a.xyz", Kind::Cloud, Layout::Lines),
        ("a.las", Kind::Cloud, Layout::HeaderThenRows),
        ("a.laz", Kind::Cloud, Layout::HeaderThenRows),
        ("a.e57", Kind::Cloud, Layout::E57),
    ];
    if has_3d {
        samples.push(("space.bag", Kind::Recording, Layout::Bag));
    }
    let sample = |name: &str, path: &str, kind, layout| Sample {
        name: name.to_owned(),
        kind,
        layout,
        bytes: std::fs::read(path).unwrap(),
        recording: at("walk.bag"),
        trajectory: truth.clone(),
    };
    let mut made: Vec<Sample> =
        samples.into_iter().map(|(name, kind, layout)| sample(name, &at(name), kind, layout)).collect();
    for (path, kind, layout) in REAL {
        if let Some(file) = real(path) {
            made.push(sample(path.rsplit('/').next().unwrap(), &file, kind, layout));
        }
    }
    made
}

/// Clouds in all formats.
fn clouds(folder: &Path) {
    use portolan_pointcloud::{Attributes, Encoding, PointCloud, WriteOptions, create};
    let attributes = Attributes { intensity: true, time: true, color: true };
    let mut cloud = PointCloud::new(attributes);
    for i in 0..600 {
        let t = f64::from(i);
        cloud.push([(t * 0.7).sin() * 3.0, t * 0.01, (t * 0.013).cos()], t as f32, 1.0 + t, [i as u8, 2, 3]);
    }
    for (name, encoding) in [
        ("a.ply", Encoding::Binary),
        ("b.ply", Encoding::Ascii),
        ("a.pcd", Encoding::Compressed),
        ("a.xyz", Encoding::Ascii),
        ("a.las", Encoding::Binary),
        ("a.laz", Encoding::Binary),
        ("a.e57", Encoding::Binary),
    ] {
        let options = WriteOptions { encoding, ..WriteOptions::default() };
        let mut writer = create(folder.join(name), attributes, &options).unwrap();
        writer.write(&cloud).unwrap();
        writer.finish().unwrap();
    }
}
