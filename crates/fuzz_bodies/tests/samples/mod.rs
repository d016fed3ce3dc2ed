//! Sound files for every body: small ones that are made here, and those of the real data where they are at hand.

use std::path::Path;

use portolan_fuzz_bodies::SEPARATOR;
use portolan_pointcloud::{Attributes, Encoding, PointCloud, WriteOptions};
use portolan_recording::Recording;
use portolan_simulator::{ScenarioOptions, Simulation};
use portolan_testing::damage::Layout;
use portolan_testing::real_data;
use portolan_worlds::two_d::Scene;

/// A sound file, and what the body wants before it.
pub struct Sample {
    pub prefix: Vec<u8>,
    pub layout: Layout,
    pub bytes: Vec<u8>,
}

fn made(layout: Layout, bytes: impl Into<Vec<u8>>) -> Sample {
    Sample { prefix: Vec::new(), layout, bytes: bytes.into() }
}

/// Larger files are damaged too slowly.
const LARGEST: usize = 400_000;

/// Files of the real data, by the bodies that take them.
const REAL: [(&str, &str, Layout); 11] = [
    ("ros1_bag", "ros_bags/evo_tf_example.bag", Layout::Bag),
    ("db3", "hostile/D2_min.db3", Layout::Pages(4096)),
    ("db3", "hostile/D2b_hang.db3", Layout::Pages(4096)),
    ("pbstream", "maps/reference/small_2d.pbstream", Layout::Pbstream),
    ("urdf", "configs/backpack_2d.urdf", Layout::Lines),
    ("urdf", "configs/AGV_backpack_2d.urdf", Layout::Lines),
    ("config", "configs/AGV_backpack_2d.lua", Layout::Lines),
    ("relations", "maps/reference/aces.generated_5m.pb", Layout::Tokens),
    ("relations", "maps/reference/aces.relations.txt", Layout::Lines),
    ("trajectory", "lidar3d/kitti_0001.truth.tum", Layout::Lines),
    ("coreslam", "lidar2d/coreslam/short.dat", Layout::Lines),
];

/// Sound files for a body.
pub fn samples_of(body: &str) -> Vec<Sample> {
    let mut samples = made_for(body);
    for (_, path, layout) in REAL.iter().filter(|(of, ..)| *of == body) {
        if let Some(bytes) = real_data(path).map(|path| std::fs::read(path).unwrap())
            && bytes.len() <= LARGEST
        {
            samples.push(made(*layout, bytes));
        }
    }
    // What chooses a format, or says that a file is one as it is.
    let prefix: &[u8] = if ["cloud", "config", "pbstream"].contains(&body) { &[0] } else { &[] };
    samples.iter_mut().filter(|s| s.prefix.is_empty()).for_each(|s| s.prefix = prefix.to_vec());
    samples
}

fn made_for(body: &str) -> Vec<Sample> {
    match body {
        "bzip2" => vec![made(Layout::Pages(64), BZIP2)],
        "carmen" => vec![made(Layout::Lines, carmen())],
        "cdr" => (0..9).flat_map(|kind| [0, 1].map(|how| message(kind, how))).collect(),
        "cloud" => clouds(),
        "config" => vec![
            made(Layout::Lines, LUA),
            Sample { prefix: vec![1], ..made(Layout::Tokens, r#"{"map_builder":{"pose_graph":{}}}"#) },
        ],
        "coreslam" => vec![made(Layout::Lines, format!("100000 5 6{}\n", " 700".repeat(705)).repeat(3))],
        "db3" => vec![made(Layout::Pages(4096), database())],
        "g2o" => vec![made(Layout::Lines, G2O_PLANE), made(Layout::Lines, G2O_SPACE)],
        "kitti" => vec![made(Layout::Pages(16), kitti())],
        "mcap" => vec![made(Layout::Mcap, recorded("walk.mcap"))],
        "packets" => vec![made(Layout::Pages(100), packets())],
        "pbstream" => [1, 2, 3]
            .map(|place| Sample { prefix: vec![place], ..made(Layout::Tokens, [8, 2, 18, 0]) })
            .into(),
        "pcap" => vec![made(Layout::Pages(1264), capture())],
        "pointcloud2" => vec![made(Layout::Pages(10), points())],
        "relations" => vec![made(Layout::Lines, RELATIONS)],
        "ros1_bag" => vec![made(Layout::Bag, recorded("walk.bag"))],
        "surfaces" => [BOXES, MESH, GEOJSON].map(|text| made(Layout::Lines, text)).into(),
        "trajectory" => [TUM, CSV, KITTI_POSES, GEOJSON].map(|text| made(Layout::Lines, text)).into(),
        "uos" => vec![made(Layout::Lines, uos())],
        "urdf" => vec![made(Layout::Lines, URDF)],
        other => panic!("no samples for {other}"),
    }
}

/// "portolan" three times as bzip2 packs it.
const BZIP2: &[u8] = b"\x42\x5a\x68\x39\x31\x41\x59\x26\x53\x59\xc1\x94\xb3\x03\x00\x00\x08\x91\x80\x40\x00\x20\x05\xd4\x00\x20\
    \x00\x31\x0c\x08\x23\xd4\x69\xa6\x8a\x91\xa6\x90\xe1\xf5\x32\x1e\x2e\xe4\x8a\x70\xa1\x21\x83\x29\x66\x06";
const LUA: &str = "include \"map_builder.lua\"\ninclude \"trajectory_builder.lua\"\noptions = {\n  \
    map_builder = MAP_BUILDER,\n  trajectory_builder = TRAJECTORY_BUILDER,\n  tracking_frame = \"imu_link\",\n}\n\
    MAP_BUILDER.use_trajectory_builder_2d = true\nfor i = 1, 3 do options[\"a\" .. i] = i * 0.5 end\nreturn options\n";
const G2O_PLANE: &str = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.1\nVERTEX_SE2 2 2 0.2 0\n\
    EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 -0.1 100 0 0 100 0 400\nEDGE_SE2 0 2 2 0.1 0 9 0 0 9 0 40\n";
const G2O_SPACE: &str = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0.1 0 0 0.1 1\n\
    EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40\n";
const RELATIONS: &str = "1.0 2.0 0.5 0 0 0 0 0.1\n1.5 3.0 0.9 0.1 0 0 0 0.2\n";
const BOXES: &str = "# walls\n0,0,0,1,1,1\n-3,-2,0,-2,2,2.5\n";
const MESH: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
    element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
const GEOJSON: &str = "{\"type\":\"FeatureCollection\",\"features\":[{\"type\":\"Feature\",\"properties\":\
    {\"trajectory\":0,\"times\":[1,2]},\"geometry\":{\"type\":\"LineString\",\"coordinates\":[[8.1,49.0,100],[8.2,49.1,101]]}}]}";
const TUM: &str =
    "# time x y z qx qy qz qw\n1.5 0 0 0 0 0 0 1\n2.5 1 0 0 0 0 0.1 0.99\n3.5 2 0.5 0 0 0 0 1\n";
const CSV: &str = "time,x,y,z,qx,qy,qz,qw\n1.5,0,0,0,0,0,0,1\n2.5,1,0,0,0,0,0,1\n";
const KITTI_POSES: &str = "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0.5\n";
const URDF: &str = "<robot name=\"r\"><link name=\"base\"/><link name=\"lidar\"/>\n<joint name=\"j\" type=\"fixed\">\
    <parent link=\"base\"/><child link=\"lidar\"/><origin xyz=\"0 0 0.5\" rpy=\"0 0 1.57\"/></joint></robot>\n";

fn carmen() -> String {
    let scan = |i: usize| {
        let ranges = " 2.5".repeat(181);
        format!(
            "FLASER 181{ranges} {i} 0 0 {i} 0 0 {}.5 host {}.5\nODOM {i} 0 0 1 0 0 {}.5 host {}.5\n",
            i, i, i, i
        )
    };
    (0..5).map(scan).collect()
}

/// A message of a type in ROS 1 (1) or CDR (0): a header and numbers that stand for small counts.
fn message(kind: u8, how: u8) -> Sample {
    let mut bytes: Vec<u8> = if how == 0 { vec![0, 1, 0, 0] } else { vec![0, 0, 0, 0] };
    bytes.extend([1, 0, 0, 0, 2, 0, 0, 0, 4, 0, 0, 0]);
    bytes.extend(b"base");
    for value in 0..120_u32 {
        bytes.extend(if value % 3 == 0 { [2, 0, 0, 0] } else { (value as f32).to_le_bytes() });
    }
    Sample { prefix: vec![kind, how], ..made(Layout::Pages(4), bytes) }
}

/// Half a second of a robot in corridors.
fn recorded(name: &str) -> Vec<u8> {
    let options = ScenarioOptions { duration: Some(0.5), ..ScenarioOptions::new(Scene::Corridors, 5) };
    let simulation = Simulation::new(options).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let mut writer = portolan_recording::create(&path, None).unwrap();
    let mut reader = simulation.read(&|_| true).unwrap();
    while let Some(message) = reader.next_message().unwrap() {
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

fn clouds() -> Vec<Sample> {
    let folder = tempfile::tempdir().unwrap();
    let files = [
        ("a.ply", Encoding::Binary, Layout::HeaderThenRows),
        ("b.ply", Encoding::Ascii, Layout::Lines),
        ("a.pcd", Encoding::Compressed, Layout::HeaderThenRows),
        ("a.xyz", Encoding::Ascii, Layout::Lines),
        ("a.las", Encoding::Binary, Layout::HeaderThenRows),
        ("a.laz", Encoding::Binary, Layout::HeaderThenRows),
        ("a.e57", Encoding::Binary, Layout::E57),
    ];
    files.map(|(name, encoding, layout)| made(layout, cloud(&folder.path().join(name), encoding))).into()
}

fn cloud(path: &Path, encoding: Encoding) -> Vec<u8> {
    let attributes = Attributes { intensity: true, time: true, color: true };
    let mut cloud = PointCloud::new(attributes);
    for i in 0..200 {
        let t = f64::from(i);
        cloud.push([(t * 0.7).sin() * 3.0, t * 0.01, (t * 0.013).cos()], t as f32, 1.0 + t, [i as u8, 2, 3]);
    }
    let options = WriteOptions { encoding, ..WriteOptions::default() };
    let mut writer = portolan_pointcloud::create(path, attributes, &options).unwrap();
    writer.write(&cloud).unwrap();
    writer.finish().unwrap();
    std::fs::read(path).unwrap()
}

/// The first pages of a database without tables.
fn database() -> Vec<u8> {
    let mut bytes = b"SQLite format 3\0\x10\x00\x01\x01\x00\x40\x20\x20".to_vec();
    bytes.resize(100, 0);
    bytes.extend([13, 0, 0, 0, 0, 16, 0, 0]);
    bytes.resize(4096, 0);
    bytes
}

fn kitti() -> Vec<u8> {
    let times = "2011-09-26 13:02:25.000000000\n2011-09-26 13:02:25.100000000\n";
    let reading = "49.01 8.43 116.4 0.03 -0.01 -1.2 0 0 0 0 0 0.1 0.2 9.8 0 0 9.8 0.01 0.02 0.03 0 0 0 0.5 0.1 4 7 5 5 5";
    // No byte of these is a form feed.
    let points: Vec<u8> =
        [10.0_f32, 1.0, 0.5, 0.25].repeat(20).iter().flat_map(|v| v.to_le_bytes()).collect();
    [times.as_bytes(), times.as_bytes(), reading.as_bytes(), &points].join(&SEPARATOR)
}

fn uos() -> Vec<u8> {
    [
        &b"1.0 2.0 3.0\n4.0 5.0 6.5\n"[..],
        b"0 0 0\n0 90 0\n",
        &b"1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 2\n".repeat(2),
    ]
    .join(&SEPARATOR)
}

/// A packet of a VLP-16.
fn velodyne() -> Vec<u8> {
    let mut packet = Vec::new();
    for block in 0..12_u16 {
        packet.extend([0xff, 0xee]);
        packet.extend((block * 40).to_le_bytes());
        (0..32_u16).for_each(|i| packet.extend([(i * 50) as u8, 4, 100]));
    }
    packet.extend([1, 2, 3, 4, 0x37, 0x22]);
    packet
}

fn packets() -> Vec<u8> {
    let (packet, mut bytes) = (velodyne(), vec![1, 0, 0, 0, 2, 0]);
    bytes.extend(b"{}");
    for _ in 0..4 {
        bytes.extend((packet.len() as u16).to_le_bytes());
        bytes.extend([200, 5]);
        bytes.extend(&packet);
    }
    bytes
}

/// A capture with packets of a VLP-16 in Ethernet, IPv4 and UDP.
fn capture() -> Vec<u8> {
    let mut bytes = vec![0xd4, 0xc3, 0xb2, 0xa1, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 1, 0, 0, 0];
    for i in 0..4_u32 {
        let payload = velodyne();
        let mut frame = vec![0; 12];
        frame.extend([8, 0, 0x45, 0]);
        frame.extend(((payload.len() + 28) as u16).to_be_bytes());
        frame.extend([0, 0, 0, 0, 64, 17, 0, 0, 192, 168, 1, 201, 255, 255, 255, 255, 9, 0x40, 9, 0x40]);
        frame.extend(((payload.len() + 8) as u16).to_be_bytes());
        frame.extend([0, 0]);
        frame.extend(payload);
        [1_700_000_000, i * 1327, frame.len() as u32, frame.len() as u32]
            .iter()
            .for_each(|word| bytes.extend(word.to_le_bytes()));
        bytes.extend(frame);
    }
    bytes
}

/// A cloud of x, y, z and time as the body of clouds wants it.
fn points() -> Vec<u8> {
    let mut bytes = vec![4];
    for (name, offset) in [(0, 0_u32), (1, 4), (2, 8), (3, 12)] {
        bytes.extend([name, 7]);
        bytes.extend(offset.to_le_bytes());
        bytes.extend(1_u32.to_le_bytes());
    }
    [100_u32, 1, 16, 1600].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    bytes.push(6);
    for i in 0..400 {
        bytes.extend((i as f32 * 0.01).to_le_bytes());
    }
    bytes
}
