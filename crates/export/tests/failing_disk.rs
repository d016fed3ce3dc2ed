//! What stages of points write to a disk that fails at any operation: whole files, or those of before and an error.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use portolan_atomic_file::faults::{Failure, Fault, Run, fail_everywhere};
use portolan_config::lua::{Limits, evaluate_text};
use portolan_export::points::{Flush, PipelineContext, PointsBatch, pipeline_from_lua, table_of};
use portolan_geometry::{Point3f, Time};
use portolan_testing::clouds::Lcg;

const STAGES: &str = r#"return { pipeline = {
    { action = "write_xray_image", voxel_size = 0.5, filename = "xray", draw_trajectories = false,
      transform = { translation = { 0., 0., 0. }, rotation = { 0., 0., math.pi } } },
    { action = "write_ply", filename = "points.ply" },
    { action = "write_pcd", filename = "points.pcd" },
    { action = "write_xyz", filename = "points.xyz" },
    { action = "write_probability_grid", filename = "grid", resolution = 0.5, output_type = "pb",
      range_data_inserter = { insert_free_space = true, hit_probability = 0.55, miss_probability = 0.49 } },
    { action = "write_probability_grid", filename = "grid", resolution = 0.5, draw_trajectories = false,
      range_data_inserter = { insert_free_space = true, hit_probability = 0.55, miss_probability = 0.49 } },
    { action = "write_hybrid_grid", filename = "hybrid.pb", voxel_size = 0.5,
      range_data_inserter = { hit_probability = 0.55, miss_probability = 0.49, num_free_space_voxels = 2 } },
    { action = "write_ros_map", filestem = "map", resolution = 0.5,
      range_data_inserter = { insert_free_space = true, hit_probability = 0.55, miss_probability = 0.49 } },
} }"#;

fn write(folder: &Path, run: Run) -> Result<(), Failure> {
    let mut random = Lcg::new(if run == Run::Earlier { 1 } else { 2 });
    let mut point = || Point3f::new(random.symmetric(9.0), random.symmetric(9.0), random.symmetric(2.0));
    let batch = PointsBatch {
        start_time: Time::from_ticks(0),
        origin: Point3f::origin(),
        frame_id: "lidar".into(),
        trajectory_id: 0,
        points: (0..100).map(|_| point()).collect(),
        intensities: vec![7.0; 100],
        colors: Vec::new(),
    };
    let context =
        PipelineContext { file_prefix: format!("{}/", folder.display()), ..PipelineContext::default() };
    let evaluation = evaluate_text("assets.lua", STAGES, &[], Limits::default())?;
    let mut stages = pipeline_from_lua(&table_of(&evaluation.table, "pipeline")?, &context, &mut |_| {})?;
    loop {
        stages.process(batch.clone())?;
        if stages.flush(&mut |_| {})? == Flush::Finished {
            return Ok(());
        }
    }
}

/// What of a file is the same in every folder: the map for ROS names its picture with all of its path.
fn compared(name: &str, bytes: Vec<u8>) -> Option<Vec<u8>> {
    let is_rest = |line: &&str| !line.starts_with("image:");
    match name {
        "map.yaml" => {
            let text = String::from_utf8(bytes).unwrap();
            Some(text.lines().filter(is_rest).collect::<String>().into_bytes())
        }
        _ => Some(bytes),
    }
}

// One test, because the disk is that of the whole process.
#[test]
fn a_failing_disk_leaves_new_or_previous_files_complete() {
    let faults = [Fault::Full, Fault::Broken, Fault::BrokenOnce];
    let operations = fail_everywhere(&faults, compared, write);
    assert!(operations >= 36, "{operations} operations");
}
