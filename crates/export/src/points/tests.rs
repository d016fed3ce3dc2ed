//! Tests the golden files of `vectors.md` §13, and invalid pipelines.

use std::path::Path;

use portolan_config::lua::{Limits, evaluate_text};
use portolan_geometry::{NearFrame, Point3f, Rigid3, Time, Vector3};
use portolan_testing::clouds::Lcg;

use super::{Flush, Pipeline, PipelineContext, PointsBatch, PointsError, pipeline_from_lua, table_of};

fn golden_batches() -> Vec<PointsBatch> {
    let mut lcg = Lcg::new(1);
    let mut point = || {
        let (x, y, z) = (lcg.symmetric(20.0), lcg.symmetric(20.0), lcg.symmetric(3.0));
        Point3f::new(x, y, z)
    };
    (0..2_u8)
        .map(|k| PointsBatch {
            start_time: Time::from_ticks(i64::from(k)),
            origin: Point3f::new(0.5 * f32::from(k), 0.0, 0.0),
            frame_id: "f".into(),
            trajectory_id: 0,
            points: (0..500).map(|_| point()).collect(),
            intensities: (0..500_u16).map(|i| f32::from(i % 120)).collect(),
            colors: Vec::new(),
        })
        .collect()
}

fn pipeline(text: &str, context: &PipelineContext) -> Result<Pipeline, PointsError> {
    let text = format!("return {{ pipeline = {{ {text} }} }}");
    let evaluation = evaluate_text("assets.lua", &text, &[], Limits::default()).unwrap();
    pipeline_from_lua(&table_of(&evaluation.table, "pipeline").unwrap(), context, &mut |_| {})
}

/// Runs until no further pass is needed; returns the number of passes and the log.
fn run(mut pipeline: Pipeline, batches: &[PointsBatch]) -> (usize, Vec<String>) {
    let mut log = Vec::new();
    for pass in 1.. {
        batches.iter().for_each(|batch| pipeline.process(batch.clone()).unwrap());
        if pipeline.flush(&mut |line| log.push(line.to_owned())).unwrap() == Flush::Finished {
            return (pass, log);
        }
    }
    unreachable!("passes end")
}

fn context_in(folder: &Path) -> PipelineContext {
    PipelineContext { file_prefix: format!("{}/", folder.display()), ..PipelineContext::default() }
}

const GOLDEN: &str = r#"
    { action = "min_max_range_filter", min_range = 1., max_range = 18. },
    { action = "dump_num_points" },
    { action = "voxel_filter_and_remove_moving_objects", voxel_size = 2. },
    { action = "dump_num_points" },
    { action = "write_xray_image", voxel_size = 0.5, filename = "xray_gray", draw_trajectories = false,
      transform = { translation = { 0., 0., 0. }, rotation = { 0., 0., math.pi } } },
    { action = "intensity_to_color", min_intensity = 0., max_intensity = 100. },
    { action = "write_ply", filename = "points.ply" },
    { action = "write_pcd", filename = "points.pcd" },
    { action = "write_xyz", filename = "points.xyz" },
    { action = "write_xray_image", voxel_size = 0.5, filename = "xray_col", saturation_factor = 2.,
      draw_trajectories = false,
      transform = { translation = { 0., 0., 0. }, rotation = { 0., 0., math.pi } } },
    { action = "fixed_ratio_sampler", sampling_ratio = 0.5 },
    { action = "dump_num_points" },
    { action = "write_ply", filename = "half.ply" },
    { action = "write_probability_grid", filename = "pg", resolution = 0.5, output_type = "pb",
      range_data_inserter = { insert_free_space = true, hit_probability = 0.55, miss_probability = 0.49 } },
    { action = "write_probability_grid", filename = "pg", resolution = 0.5, draw_trajectories = false,
      range_data_inserter = { insert_free_space = true, hit_probability = 0.55, miss_probability = 0.49 } },
    { action = "write_hybrid_grid", filename = "hg.pb", voxel_size = 0.5,
      range_data_inserter = { hit_probability = 0.55, miss_probability = 0.49, num_free_space_voxels = 2 } },
    { action = "write_ros_map", filestem = "map", resolution = 0.5,
      range_data_inserter = { insert_free_space = true, hit_probability = 0.55, miss_probability = 0.49 } },
"#;

#[test]
fn the_files_are_the_golden_ones() {
    let folder = tempfile::tempdir().unwrap();
    let (passes, log) = run(pipeline(GOLDEN, &context_in(folder.path())).unwrap(), &golden_batches());
    assert_eq!(passes, 3);
    let counts: Vec<&str> = log.iter().filter(|l| l.starts_with("Processed")).map(String::as_str).collect();
    let finishing =
        ["Processed 224 and finishing.", "Processed 447 and finishing.", "Processed 652 and finishing."];
    // A pass that does not reach the end is not counted.
    assert_eq!(counts[counts.len() - 3..], finishing, "{counts:?}");
    for (name, bytes, crc) in [
        ("points.ply", 8741, 0x1b41_e7cb),
        ("points.pcd", 7338, 0x18f2_1e9d),
        ("points.xyz", 11442, 0x10e2_9ec3),
        ("half.ply", 4504, 0x3756_006c),
        ("pg.pb", 15217, 0x146c_7bc7),
        ("hg.pb", 3570, 0x01e8_733a),
    ] {
        let content = std::fs::read(folder.path().join(name)).unwrap();
        assert_eq!((content.len(), crc32fast::hash(&content)), (bytes, crc), "{name}");
    }
    let map = std::fs::read_to_string(folder.path().join("map.yaml")).unwrap();
    assert!(map.contains("resolution: 0.5") && folder.path().join("map.pgm").exists(), "{map}");
    let Some(golden) = portolan_testing::spec_data("") else { return };
    for name in ["xray_gray.png", "xray_col.png", "pg.png"] {
        assert_eq!(grey(&folder.path().join(name)), grey(&golden.join(name)), "{name}");
    }
}

#[test]
fn files_hold_places_in_the_map_and_pictures_are_the_same_far_from_the_origin() {
    let [near, far] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let frame = NearFrame::around([Vector3::new(499_712.0, 5_400_576.0, 0.0)]);
    let text = GOLDEN.replace("write_hybrid_grid", "write_xyz").replace("hg.pb", "hg.xyz");
    let text = text.replace(", voxel_size = 0.5,\n      range_data_inserter = { hit_probability = 0.55, miss_probability = 0.49, num_free_space_voxels = 2 }", "");
    run(pipeline(&text, &context_in(near.path())).unwrap(), &golden_batches());
    run(pipeline(&text, &PipelineContext { frame, ..context_in(far.path()) }).unwrap(), &golden_batches());
    for name in ["xray_gray.png", "xray_col.png", "pg.png", "map.pgm"] {
        let read = |folder: &tempfile::TempDir| std::fs::read(folder.path().join(name)).unwrap();
        assert!(read(&near) == read(&far), "{name}");
    }
    let numbers = |folder: &tempfile::TempDir, name: &str| -> Vec<f64> {
        let text = std::fs::read_to_string(folder.path().join(name)).unwrap();
        text.split_whitespace().filter_map(|word| word.trim_matches(['[', ']', ',']).parse().ok()).collect()
    };
    let (a, b) = (numbers(&near, "points.xyz"), numbers(&far, "points.xyz"));
    assert!(a.len() > 1000 && a.len() == b.len());
    for (i, (a, b)) in a.iter().zip(&b).enumerate() {
        assert!((b - a - frame.origin()[i % 3]).abs() < 1e-4, "{a} {b}");
    }
    let (a, b) = (numbers(&near, "map.yaml"), numbers(&far, "map.yaml"));
    assert!(a.iter().zip(&b).any(|(a, b)| (b - a - 5_400_576.0).abs() < 1e-3), "{a:?} {b:?}");
    let cloud = std::fs::read(far.path().join("points.ply")).unwrap();
    assert!(String::from_utf8_lossy(&cloud[..300]).contains("property double y"));
    // The file of a hybrid grid has no origin: frames far from that of the map are rejected.
    let refused = pipeline(GOLDEN, &PipelineContext { frame, ..context_in(far.path()) }).err().unwrap();
    assert!(refused.to_string().contains("8192 voxels"), "{refused}");
}

/// Size and pixels of a picture, red, green and blue.
fn grey(path: &Path) -> (u32, u32, Vec<[u8; 3]>) {
    let decoder = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    let step = info.color_type.samples();
    let pixels = bytes[..info.buffer_size()].chunks(step);
    let rgb = |p: &[u8]| if step < 3 { [p[0]; 3] } else { [p[0], p[1], p[2]] };
    (info.width, info.height, pixels.map(rgb).collect())
}

#[test]
fn impossible_requests_are_errors_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let moving = r#"{ action = "voxel_filter_and_remove_moving_objects", voxel_size = 0.1 }"#;
    for (text, expected) in [
        (r#"{ action = "write_png" }"#, "there are: color_points"),
        (r#"{ action = "min_max_range_filter", min_range = 1. }"#, "max_range"),
        (r#"{ action = "dump_num_points", voxel = 1 }"#, "voxel"),
        (r#"{ action = "fixed_ratio_sampler", sampling_ratio = 1. }"#, "above 0 and below 1"),
        (r#"{ action = "frame_id_filter" }"#, "exactly one"),
        (&format!(r#"{{ action = "write_ply", filename = "a.ply" }}, {moving}"#), "multiple passes"),
        (r#"{ action = "write_ply", filename = "no/such/folder.ply" }"#, "does not exist"),
        (r#"{ action = "voxel_filter_and_remove_moving_objects", voxel_size = 0 }"#, "positive"),
        (
            r#"{ action = "write_xray_image", filename = "x", voxel_size = 0.1, separate_floors = true,
                transform = { translation = { 0, 0, 0 }, rotation = { 0, 0, 0 } } }"#,
            "exactly one trajectory",
        ),
        (
            r#"{ action = "write_xray_image", filename = "x", voxel_size = 0.1,
                transform = { translation = { 0, 0, 0 }, rotation = { w = 1, x = 0.1, y = 0, z = 0 } } }"#,
            "not 1",
        ),
    ] {
        let error =
            pipeline(text, &context_in(folder.path())).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(expected), "{text}: {error}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn absurd_points_are_handled() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"
        { action = "voxel_filter_and_remove_moving_objects", voxel_size = 0.1 },
        { action = "write_ply", filename = "all.ply" },"#;
    let mut batch = golden_batches().swap_remove(0);
    batch.points = vec![
        Point3f::new(f32::NAN, 0.0, 0.0),
        Point3f::new(1e30, 0.0, 0.0),
        Point3f::new(0.0, f32::INFINITY, 0.0),
        Point3f::new(1.0, 2.0, 0.5),
    ];
    batch.intensities.clear();
    run(pipeline(text, &context_in(folder.path())).unwrap(), &[batch.clone()]);
    let ply = std::fs::read(folder.path().join("all.ply")).unwrap();
    assert!(ply.windows(32).any(|w| w == b"element vertex 000000000000002\np"), "{}", ply.len());
    let xray = r#"{ action = "write_xray_image", filename = "x", voxel_size = 0.1,
        transform = { translation = { 0, 0, 0 }, rotation = { 0, 0, 0 } } }"#;
    batch.points[1] = Point3f::new(0.0, 1e30, 0.0);
    let mut pipeline = pipeline(xray, &context_in(folder.path())).unwrap();
    pipeline.process(batch).unwrap();
    assert!(matches!(pipeline.flush(&mut |_| {}), Err(PointsError::TooLarge { .. })));
}

#[test]
fn trajectories_are_drawn_and_sensors_coloured() {
    let folder = tempfile::tempdir().unwrap();
    let trajectory =
        (0..20_i32).map(|i| (Time::from_ticks(i.into()), Rigid3::translation(0.0, f64::from(i - 10), 0.0)));
    let context = PipelineContext { trajectories: vec![trajectory.collect()], ..context_in(folder.path()) };
    let text = r#"
        { action = "frame_id_filter", keep_frames = { "f" } },
        { action = "vertical_range_filter", min_z = -1, max_z = 1 },
        { action = "color_points", frame_id = "f", color = { 255, 0, 0 } },
        { action = "write_xray_image", filename = "x", voxel_size = 0.5, saturation_factor = 1000.,
          transform = { translation = { 0, 0, 0 }, rotation = { 0, -math.pi / 2, 0 } } },"#;
    let (passes, _) = run(pipeline(text, &context).unwrap(), &golden_batches());
    let (_, _, pixels) = grey(&folder.path().join("x.png"));
    assert_eq!(passes, 1);
    let is = |wanted: fn(&[u8; 3]) -> bool| pixels.iter().filter(|p| wanted(p)).count();
    assert!(is(|[r, g, b]| *g > 180 && *r < 120 && *b < 120) > 20, "a green start");
    assert!(is(|p| *p == [255, 0, 0]) > 0, "a red point where many are in line");
}
