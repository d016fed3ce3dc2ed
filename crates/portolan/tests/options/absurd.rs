//! Absurd values are refused or survived: never a panic, a hang or endless memory.

use portolan::config::{OptionDoc, Options, catalogue};
use portolan::geometry::{Dimension, Rigid3};
use portolan::mapping::{Mapper, MapperSettings, Space, Space2d, Space3d};
use portolan::sensor::{
    FixedFramePoseData, LandmarkData, LandmarkObservation, Measurement, SensorId, SensorKind,
};
use portolan_testing::is_fast;

use crate::run::sensor;
use crate::world::{at, imu, odometry, on_circle, scan_at};

/// What may be written where a number belongs.
const NUMBERS: [&str; 14] = [
    "0",
    "-1",
    "1",
    "3",
    "0.5",
    "1e-300",
    "1e-9",
    "1e9",
    "2147483647",
    "1e300",
    "-1e300",
    "0/0",
    "math.huge",
    "-math.huge",
];

fn candidates(doc: &OptionDoc) -> Vec<String> {
    let texts: Vec<&str> = match doc.type_name.as_str() {
        "number" | "integer" => NUMBERS.to_vec(),
        "boolean" => vec!["true", "false", "1", "nil"],
        "string" => vec!["", "a frame \u{1F600}", "\"", "7"],
        _ => vec!["TSDF", "TSDF_INSERTER_2D", "PROBABILITY_GRID", "", "GRID"],
    };
    let is_slow = doc.path.contains("trajectory_builder_3d.real_time");
    let kept = texts.into_iter().filter(|text| !is_slow || ["0", "-1", "1e-9", "1e9", "0/0"].contains(text));
    kept.map(str::to_owned).collect()
}

fn base(dimension: Dimension) -> Options {
    let mut options = match dimension {
        Dimension::TwoD => Options::for_2d(),
        Dimension::ThreeD => Options::for_3d(),
    };
    for setting in [
        "trajectory_builder_2d.submaps.num_range_data=2",
        "trajectory_builder_3d.submaps.num_range_data=2",
        "trajectory_builder_2d.use_online_correlative_scan_matching=true",
        "trajectory_builder_2d.submaps.grid_options_2d.resolution=0.1",
        "trajectory_builder_3d.submaps.high_resolution=0.3",
        "pose_graph.constraint_builder.sampling_ratio=0.4",
        "pose_graph.optimize_every_n_nodes=4",
    ] {
        options.set(setting).unwrap();
    }
    options
}

/// Six scans on a circle and every other kind of sensor.
fn measurements(dimension: Dimension) -> Vec<Measurement> {
    let mut measurements = Vec::new();
    for step in 0..36 {
        let seconds = 0.1 * f64::from(step);
        let truth = on_circle(seconds);
        measurements.push(Measurement::Imu(imu(seconds, 0.0, 0.4)));
        measurements.push(Measurement::Odometry(odometry(truth, seconds)));
        if step % 6 != 0 {
            continue;
        }
        let elevations: &[f64] = if dimension == Dimension::TwoD { &[0.0] } else { &[-0.3, -0.1, 0.1, 0.3] };
        measurements.push(Measurement::Range(scan_at(&truth, seconds, elevations, 60)));
        measurements.push(Measurement::FixedFramePose(FixedFramePoseData {
            time: at(seconds),
            fixed_from_tracking: Some(truth),
        }));
        let observation = LandmarkObservation {
            id: "door".to_owned(),
            tracking_from_landmark: truth.inverse() * Rigid3::translation(3.0, 1.0, 0.0),
            translation_weight: 10.0,
            rotation_weight: 1.0,
        };
        measurements
            .push(Measurement::Landmark(LandmarkData { time: at(seconds), observations: vec![observation] }));
    }
    measurements
}

/// Maps, and says why not if that is impossible.
fn map<S: Space>(options: &Options, measurements: Vec<Measurement>) -> Result<usize, String> {
    let settings = MapperSettings { threads: 1, ..MapperSettings::default() };
    let mut mapper = Mapper::<S>::new(options, settings).map_err(|e| e.to_string())?;
    let kinds = [
        SensorKind::Range,
        SensorKind::Imu,
        SensorKind::Odometry,
        SensorKind::FixedFramePose,
        SensorKind::Landmark,
    ];
    let sensors = kinds.map(sensor).into_iter().collect();
    let id = mapper.add_trajectory(&sensors, None).map_err(|e| e.to_string())?;
    for measurement in measurements {
        let sensor: SensorId = sensor(measurement.kind());
        mapper.add(id, &sensor, measurement).map_err(|e| e.to_string())?;
    }
    let (map, _) = mapper.finish().map_err(|e| e.to_string())?;
    let state = map.graph.state();
    for node in state.nodes.values() {
        let pose = node.map_from_tracking;
        assert!(pose.translation.vector.iter().all(|v| v.is_finite()), "a pose that is no number: {pose}");
    }
    Ok(state.nodes.len())
}

/// The dimension in which an option counts.
fn dimensions(path: &str) -> &'static [Dimension] {
    let plane = path.contains("trajectory_builder_2d") || path.contains("trimmer_2d");
    let space = path.contains("_3d");
    match (plane, space) {
        (true, _) => &[Dimension::TwoD],
        (_, true) => &[Dimension::ThreeD],
        _ if path.contains("matcher") => &[Dimension::TwoD],
        _ => &[Dimension::TwoD, Dimension::ThreeD],
    }
}

/// Tries all values of the options that `chosen` picks.
fn try_all(chosen: impl Fn(&str) -> bool) {
    let leaves = catalogue().iter().filter(|doc| !doc.is_table && doc.without_effect.is_none());
    let (mut refused, mut mapped) = (0, 0);
    for doc in leaves.filter(|doc| chosen(&doc.path)) {
        for value in candidates(doc) {
            for dimension in dimensions(&doc.path) {
                let mut options = base(*dimension);
                if doc.path.contains("trajectory_builder_3d.real_time") {
                    options.set("trajectory_builder_3d.use_online_correlative_scan_matching=true").unwrap();
                }
                if doc.path.contains(".imu_based.") {
                    options.set("trajectory_builder_3d.pose_extrapolator.use_imu_based=true").unwrap();
                }
                if options.set(&format!("{}={value}", doc.path)).is_err() || options.validate().is_err() {
                    refused += 1;
                    continue;
                }
                let start = std::time::Instant::now();
                let mut measurements = measurements(*dimension);
                if options.trajectory_builder.trajectory_builder_3d.use_online_correlative_scan_matching {
                    // Two scans: the widest window takes seconds for each.
                    measurements.truncate(22);
                }
                let result = match dimension {
                    Dimension::TwoD => map::<Space2d>(&options, measurements),
                    Dimension::ThreeD => map::<Space3d>(&options, measurements),
                };
                match result {
                    Ok(_) => mapped += 1,
                    Err(error) => {
                        assert!(!error.contains("stopped"), "{} = {value}: {error}", doc.path);
                        refused += 1;
                    }
                }
                if start.elapsed().as_secs_f64() > 2.0 {
                    eprintln!("slow: {} = {value}: {:.1} s", doc.path, start.elapsed().as_secs_f64());
                }
            }
        }
    }
    assert!(refused > 0 && mapped > 0, "{refused} refused, {mapped} mapped");
}

#[test]
fn absurd_values_of_local_slam_in_2d() {
    if is_fast() {
        return;
    }
    try_all(|path| path.starts_with("trajectory_builder.trajectory_builder_2d"));
}

#[test]
fn absurd_values_of_local_slam_in_3d() {
    if is_fast() {
        return;
    }
    try_all(|path| path.starts_with("trajectory_builder.trajectory_builder_3d"));
}

#[test]
fn absurd_values_of_the_pose_graph() {
    if is_fast() {
        return;
    }
    try_all(|path| path.starts_with("map_builder"));
}

#[test]
fn absurd_values_of_everything_else() {
    if is_fast() {
        return;
    }
    try_all(|path| {
        !path.starts_with("map_builder")
            && !path.starts_with("trajectory_builder.trajectory_builder_2d")
            && !path.starts_with("trajectory_builder.trajectory_builder_3d")
    });
}
