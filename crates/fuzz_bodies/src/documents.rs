//! Fuzz targets for clouds, graphs, trajectories, relations, surfaces, configurations and robot descriptions.

use std::time::Duration;

use portolan_bunzip2::Unpacker;
use portolan_config::Options;
use portolan_config::lua::{Limits, evaluate_text, print_configuration};
use portolan_evaluation::cloud::{is_mesh, read_boxes, read_mesh};
use portolan_evaluation::{
    read_binary_relations, read_csv, read_geojson, read_kitti_poses, read_kitti_times, read_text_relations,
    read_tum, write_binary_relations, write_csv, write_kitti, write_text_relations, write_tum,
};
use portolan_ingest::{TfTree, parse_urdf};
use portolan_pointcloud::{CloudReader, PointCloud, open};
use portolan_solver::g2o::{Initialization, OptimizeOptions, optimize_graph, read_g2o, write_g2o};

use crate::parts;

/// Maximum number of decompressed bytes.
const LIMIT: usize = 1 << 24;
/// Limits of the Lua interpreter. The time is so short that the fuzzer does not report an endless loop as a fault.
const LIMITS: Limits = Limits { time: Duration::from_millis(300), memory: 32 << 20 };
/// Beginnings of files by format: none, PLY, LAS, E57, PCD.
const STARTS: [&[u8]; 5] =
    [b"", b"ply\nformat ", b"LASF", b"ASTM-E57", b"# .PCD v.7\nVERSION .7\nFIELDS x y z"];
/// Maximum number of batches that are read: a small file can declare billions of points.
const BATCHES: usize = 64;

/// bzip2 data, decompressed twice with the same decompressor.
///
/// # Panics
/// If the two results differ or exceed the limit.
pub fn bzip2(packed: &[u8]) {
    let (mut unpacker, mut first, mut second) = (Unpacker::default(), Vec::new(), Vec::new());
    let _ = unpacker.unpack(packed, LIMIT, &mut first);
    let _ = unpacker.unpack(packed, LIMIT, &mut second);
    assert!(first == second && first.len() <= LIMIT);
}

/// Point cloud files of every format. The first byte selects the format, so that the fuzzer need not find its magic
/// bytes.
pub fn cloud(bytes: &[u8]) {
    let Some((first, rest)) = bytes.split_first() else { return };
    let start = STARTS.get(usize::from(*first) % STARTS.len()).copied().unwrap_or_default();
    let Ok(folder) = tempfile::tempdir() else { return };
    let path = folder.path().join("cloud");
    if std::fs::write(&path, [start, rest].concat()).is_ok()
        && let Ok(reader) = open(&path)
    {
        read_batches(reader);
    }
}

fn read_batches(mut reader: Box<dyn CloudReader>) {
    let mut batch = PointCloud::default();
    for _ in 0..BATCHES {
        match reader.next_batch(&mut batch) {
            Ok(true) => {}
            _ => break,
        }
    }
    reader.issues();
}

/// Folders of uos scans: points, pose and frames of one scan, separated by form feeds.
pub fn uos(bytes: &[u8]) {
    let Ok(folder) = tempfile::tempdir() else { return };
    let [points, pose, frames] = parts(bytes);
    let write = |name: &str, text: &[u8]| std::fs::write(folder.path().join(name), text).is_ok();
    if write("scan000.3d", points)
        && write("scan000.pose", pose)
        && write("scan000.frames", frames)
        && let Ok(reader) = open(folder.path())
    {
        read_batches(reader);
    }
}

/// Configurations: Lua text up to the options, or JSON if the first byte is odd.
pub fn config(bytes: &[u8]) {
    let Some((first, rest)) = bytes.split_first() else { return };
    let Ok(text) = std::str::from_utf8(rest) else { return };
    if first % 2 == 1 {
        let _ = Options::from_json(text);
        return;
    }
    if let Ok(evaluation) = evaluate_text("fuzz.lua", text, &[], LIMITS) {
        let _ = print_configuration(&evaluation.table, None);
        let _ = Options::from_lua("fuzz.lua", text);
    }
}

/// Robot descriptions (URDF) and their trees of frames.
pub fn urdf(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(robot) = parse_urdf(text, false) {
        let mut tree = TfTree::new();
        robot.insert_into(&mut tree);
        tree.to_text();
    }
}

/// Pose graphs: read, written and read again, and small ones optimised with every initialisation.
///
/// # Panics
/// If a written graph cannot be read without repairs, or with other numbers of vertices and edges.
pub fn g2o(bytes: &[u8]) {
    let Ok((graph, _)) = read_g2o(bytes) else { return };
    let mut text = Vec::new();
    write_g2o(&graph, &mut text).expect("memory takes everything");
    let (again, repairs) = read_g2o(text.as_slice()).expect("what is written can be read");
    assert!(repairs.is_empty(), "{repairs:?}");
    assert_eq!((again.vertex_count(), again.edge_count()), (graph.vertex_count(), graph.edge_count()));
    if graph.vertex_count() > 200 || graph.edge_count() > 400 {
        return;
    }
    for initialization in [
        Initialization::Automatic,
        Initialization::FromFile,
        Initialization::SpanningTree,
        Initialization::RotationsFirst,
    ] {
        let mut options = OptimizeOptions { initialization, estimate_condition: true, ..Default::default() };
        options.solver.max_num_iterations = 5;
        let _ = optimize_graph(&mut graph.clone(), &options);
    }
}

/// Trajectories: read and written in every format.
///
/// # Panics
/// If writing to memory fails.
pub fn trajectory(bytes: &[u8]) {
    for (trajectory, _) in [read_tum(bytes), read_csv(bytes)].into_iter().flatten() {
        trajectory.covered_distances();
        let mut out = Vec::new();
        write_tum(&trajectory, &mut out).expect("memory takes everything");
        write_csv(&trajectory, &mut out).expect("memory takes everything");
        write_kitti(&trajectory, &mut out).expect("memory takes everything");
    }
    let _ = read_geojson(bytes, None);
    let _ = read_kitti_poses(bytes);
    let _ = read_kitti_times(bytes);
}

/// Relations as text and as Cartographer's binary files: read, written and read again.
///
/// # Panics
/// If the number of relations changes by writing and reading.
pub fn relations(bytes: &[u8]) {
    if let Ok(found) = read_text_relations(bytes) {
        let mut out = Vec::new();
        write_text_relations(&found, &mut out).expect("memory takes everything");
        let again = read_text_relations(out.as_slice()).expect("what is written can be read");
        assert_eq!(again.len(), found.len());
    }
    if let Ok(found) = read_binary_relations(bytes) {
        let mut out = Vec::new();
        write_binary_relations(&found, &mut out).expect("memory takes everything");
        assert_eq!(read_binary_relations(out.as_slice()).map_or(0, |again| again.len()), found.len());
    }
}

/// Ground-truth surfaces: boxes as text, meshes, and outlines in GeoJSON.
pub fn surfaces(bytes: &[u8]) {
    let _ = read_boxes(bytes);
    if is_mesh(bytes) {
        let _ = read_mesh(bytes);
    }
    let _ = read_geojson(bytes, None);
}
