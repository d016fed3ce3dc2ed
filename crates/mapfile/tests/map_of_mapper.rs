//! A map that was just made is written, checked and read.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::collections::BTreeSet;

use portolan_config::{GridType2d, Options, RangeDataInserterType2d};
use portolan_geometry::{Duration, Point3f, Rigid3, Time, rotation_from_roll_pitch_yaw, to_f32};
use portolan_mapfile::{
    MapLoadSettings, PaintOptions, paint, read_map_2d, submap_textures_2d, write_graph, write_map_2d,
};
use portolan_mapping::{InitialTrajectoryPose, Map, Mapper, MapperSettings, Space2d, TrajectoryId};
use portolan_pbstream::{PbstreamReader, validate};
use portolan_sensor::{
    FixedFramePoseData, LandmarkData, LandmarkObservation, Measurement, OdometryData, SensorId, SensorKind,
    TimedPoint, TimedPointCloudData,
};
use tempfile::TempDir;

/// Half a round room of 5 m with five rings of points, seen every 0.1 s for 4 s from a sensor that moves
/// 1.2 m.
fn fake_scans() -> Vec<(Rigid3, TimedPointCloudData)> {
    let mut world = Vec::new();
    for step in 0..315 {
        let angle = 0.01 * f64::from(step);
        for height in [-0.4, -0.2, 0.0, 0.2, 0.4] {
            world.push(Point3f::new(5.0 * angle.cos() as f32, 5.0 * angle.sin() as f32, height));
        }
    }
    let scan = |i: u32| {
        let seconds = 0.1 * f64::from(i);
        let along = 1.2 * seconds / 4.0 / 5.0_f64.sqrt();
        let map_from_tracking = Rigid3::translation(2.0 * along, along, 0.0);
        let tracking_from_map = to_f32(&map_from_tracking.inverse());
        let points = world.iter().map(|p| TimedPoint { position: tracking_from_map * p, time: 0.0 });
        let data = TimedPointCloudData {
            time: Time::from_ticks(123) + Duration::from_seconds(seconds),
            origin_in_tracking: Point3f::origin(),
            points_in_tracking: points.collect(),
            intensities: Vec::new(),
        };
        (map_from_tracking, data)
    };
    (0..40).map(scan).collect()
}

fn options(grid: GridType2d) -> Options {
    let mut options = Options::for_2d();
    let builder = &mut options.trajectory_builder.trajectory_builder_2d;
    builder.use_imu_data = false;
    builder.submaps.num_range_data = 4;
    builder.submaps.grid_options_2d.grid_type = grid;
    if grid == GridType2d::Tsdf {
        builder.submaps.range_data_inserter.range_data_inserter_type = RangeDataInserterType2d::Tsdf;
    }
    builder.motion_filter.max_distance_meters = 0.0;
    options.map_builder.pose_graph.optimize_every_n_nodes = 10;
    options
}

/// Two trajectories with all kinds of sensors; the second starts relative to the first.
fn map(options: &Options) -> Map<Space2d> {
    let sensors: BTreeSet<SensorId> = [
        SensorId::new(SensorKind::Range, "scan"),
        SensorId::new(SensorKind::Odometry, "odom"),
        SensorId::new(SensorKind::FixedFramePose, "fix"),
        SensorId::new(SensorKind::Landmark, "landmark"),
    ]
    .into();
    let mut mapper =
        Mapper::<Space2d>::new(options, MapperSettings { threads: 1, ..MapperSettings::default() }).unwrap();
    for run in 0..2 {
        let initial = (run == 1).then(|| InitialTrajectoryPose {
            to_trajectory_id: TrajectoryId(0),
            relative_pose: Rigid3::translation(0.1, 0.0, 0.0),
            time: Time::from_ticks(123),
        });
        let id = mapper.add_trajectory(&sensors, initial).unwrap();
        for (pose, scan) in fake_scans() {
            let time = scan.time;
            let fixed = FixedFramePoseData { time, fixed_from_tracking: (run == 0).then_some(pose) };
            let seen = LandmarkObservation {
                id: "door".to_owned(),
                tracking_from_landmark: pose.inverse() * Rigid3::translation(1.0, 2.0, 0.0),
                translation_weight: 10.0,
                rotation_weight: 1.0,
            };
            let landmark = LandmarkData { time, observations: vec![seen] };
            let odometry = OdometryData { time, odom_from_tracking: pose };
            for (name, measurement) in [
                ("odom", Measurement::Odometry(odometry)),
                ("fix", Measurement::FixedFramePose(fixed)),
                ("landmark", Measurement::Landmark(landmark)),
                ("scan", Measurement::Range(scan)),
            ] {
                let kind = measurement.kind();
                mapper.add(id, &SensorId::new(kind, name), measurement).unwrap();
            }
        }
        mapper.finish_trajectory(id).unwrap();
    }
    mapper.finish().unwrap().0
}

#[test]
fn a_new_map_is_valid_and_comes_back_byte_by_byte() {
    let folder = TempDir::new().unwrap();
    for grid in [GridType2d::ProbabilityGrid, GridType2d::Tsdf] {
        let options = options(grid);
        let map = map(&options);
        let state = map.graph.state();
        assert!(state.nodes.len() > 60 && state.submaps.len() > 10 && !state.constraints.is_empty());
        let [first, second] = ["first.pbstream", "second.pbstream"].map(|name| folder.path().join(name));
        let report = write_map_2d(&map, &first, true).unwrap();
        assert_eq!((report.points_left_out, report.landmark_sightings_left_out), (0, 0));
        let findings = validate(&mut PbstreamReader::open(&first).unwrap());
        assert!(findings.is_empty(), "{findings:?}");

        let loaded = read_map_2d(&first, &MapLoadSettings::default()).unwrap();
        assert!(loaded.issues.is_empty(), "{:?}", loaded.issues);
        assert_eq!(loaded.graph.problem().sensors, map.graph.problem().sensors);
        assert_eq!(
            loaded.graph.problem().landmarks["door"].sightings,
            map.graph.problem().landmarks["door"].sightings
        );
        let again = loaded.into_map(options.clone());
        for (id, ended) in &map.trajectories {
            assert_eq!(again.trajectories[id].options, ended.options);
            assert_eq!(again.trajectories[id].sensors, ended.sensors);
            assert_eq!(again.node_poses(*id), map.node_poses(*id));
        }
        write_map_2d(&again, &second, true).unwrap();
        assert!(std::fs::read(&first).unwrap() == std::fs::read(&second).unwrap());
    }
}

#[test]
fn the_bytes_do_not_depend_on_threads() {
    let map = map(&options(GridType2d::ProbabilityGrid));
    let folder = TempDir::new().unwrap();
    let files = [1, 2, 4].map(|threads| {
        let path = folder.path().join(format!("{threads}.pbstream"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write_map_2d(&map, &path, true)).unwrap();
        std::fs::read(path).unwrap()
    });
    assert!(files[0] == files[1] && files[0] == files[2]);
}

#[test]
fn tilted_scanners_come_back_byte_by_byte_too() {
    let options = options(GridType2d::ProbabilityGrid);
    let map = map(&options);
    let folder = TempDir::new().unwrap();
    let [first, second] = ["first.pbstream", "second.pbstream"].map(|name| folder.path().join(name));
    // The same map, as if the tracking frame were tilted at every node.
    let mut tilted = portolan_mapping::PoseGraph::<Space2d>::new(options.map_builder.pose_graph.clone());
    let state = map.graph.state();
    for id in map.trajectories.keys() {
        tilted.load_trajectory(*id, None);
    }
    for (id, entry) in &state.submaps {
        let Some(submap) = &entry.submap else { continue };
        let pose = state.map_from_submap(*id).unwrap();
        tilted.load_submap(*id, std::sync::Arc::clone(submap), entry.insertion_finished, pose);
    }
    for (id, node) in &state.nodes {
        let mut data = (*node.data).clone();
        let tilt = 0.001 * f64::from(id.index);
        data.gravity_alignment = rotation_from_roll_pitch_yaw(0.1 + tilt, -0.2, 0.0);
        data.local_from_tracking *= data.gravity_alignment;
        tilted.load_node(
            *id,
            std::sync::Arc::new(data.clone()),
            node.map_from_tracking * data.gravity_alignment,
        );
    }
    for constraint in &state.constraints {
        tilted.load_constraint(constraint.clone());
    }

    write_graph(&tilted, &map.trajectories, &options, &first, true).unwrap();
    let loaded = read_map_2d(&first, &MapLoadSettings::default()).unwrap();
    for (a, b) in loaded.graph.state().constraints.iter().zip(&tilted.state().constraints) {
        let off = a.submap_from_node.inverse() * b.submap_from_node;
        assert!(off.translation.vector.norm() < 1e-11 && off.rotation.angle() < 1e-11, "{off}");
    }
    write_graph(&loaded.graph, &loaded.trajectories, &options, &second, true).unwrap();
    assert!(std::fs::read(&first).unwrap() == std::fs::read(&second).unwrap());
}

#[test]
fn pictures_need_no_file() {
    let map = map(&options(GridType2d::ProbabilityGrid));
    let picture = paint(&submap_textures_2d(&map), &PaintOptions::default()).unwrap();
    // The room is 10 m wide and half as deep.
    assert!(picture.width > 180 && picture.height > 90, "{} {}", picture.width, picture.height);
}
