use portolan_ingest::IngestOptions;
use portolan_recording::Recording;
use portolan_simulator::sensors::ImuOptions;
use portolan_simulator::{Scenario3dOptions, ScenarioOptions, Simulation, Simulation3d};
use portolan_worlds::three_d::Scene3d;
use portolan_worlds::two_d::Scene;

use super::*;
use crate::pipeline::{Preparation, prepare};

fn prepared(recording: &dyn Recording) -> Preparation {
    prepare(recording, &IngestOptions::default(), None).unwrap()
}

/// Properties of the sensors as a user would give them without the recording.
fn described(preparation: &Preparation, has_odometry: bool) -> Sensors {
    let lidar = Lidar::from(&preparation.plan.range[0].statistics);
    let has_imu = preparation.plan.imu.is_some();
    let alone = Sensors::new(preparation.dimension, lidar, &preparation.plan.tracking_frame);
    Sensors { has_imu, has_odometry, ..alone }
}

#[test]
fn the_same_sensors_get_the_same_settings_with_and_without_a_recording() {
    let office = |with_wheels: bool, with_imu: bool| {
        let mut options = ScenarioOptions { duration: Some(8.0), ..ScenarioOptions::new(Scene::Office, 3) };
        options.odometry = options.odometry.filter(|_| with_wheels);
        options.imu = with_imu.then(ImuOptions::default);
        prepared(&Simulation::new(options).unwrap())
    };
    for (with_wheels, with_imu) in [(true, true), (true, false), (false, true), (false, false)] {
        let preparation = office(with_wheels, with_imu);
        assert_eq!((preparation.dimension, preparation.plan.imu.is_some()), (Dimension::TwoD, with_imu));
        assert_eq!(settings_for(&described(&preparation, with_wheels)), preparation.options);
        assert_eq!(preparation.options.bridge.use_odometry, with_wheels);
    }
    let mut options = Scenario3dOptions::new(Scene3d::Museum, 3, 1);
    options.duration = Some(3.0);
    options.lidars.iter_mut().for_each(|lidar| lidar.beams.columns = 200);
    let preparation = prepared(&Simulation3d::new(options).unwrap());
    assert_eq!(preparation.dimension, Dimension::ThreeD);
    assert_eq!(settings_for(&described(&preparation, false)), preparation.options);
}

#[test]
fn settings_follow_the_resolution_and_range_of_lidars() {
    let lidar = Lidar {
        angular_resolution_radians: 0.25_f64.to_radians(),
        median_range_metres: 3.0,
        max_range_metres: f64::INFINITY,
        scans_hz: 10.0,
    };
    let cell = |lidar| {
        let options = settings_for(&Sensors::new(Dimension::TwoD, lidar, "laser"));
        options.trajectory_builder.trajectory_builder_2d.submaps.grid_options_2d.resolution
    };
    let sparse = Lidar { angular_resolution_radians: 1.0_f64.to_radians(), ..lidar };
    assert_eq!((cell(lidar), cell(sparse)), (0.05, 0.1));
    let farthest = |lidar: Option<Lidar>, dimension| {
        let sensors = Sensors { lidar, ..Sensors::new(dimension, sparse, "laser") };
        let builder = settings_for(&sensors).trajectory_builder;
        match dimension {
            Dimension::TwoD => builder.trajectory_builder_2d.max_range,
            Dimension::ThreeD => builder.trajectory_builder_3d.max_range,
        }
    };
    let gathered = |scans_hz, has_more_lidars| {
        let lidar = Lidar { scans_hz, ..lidar };
        let sensors = Sensors { has_more_lidars, ..Sensors::new(Dimension::ThreeD, lidar, "lidar") };
        settings_for(&sensors).portolan.min_scan_duration > 0.0
    };
    assert_eq!((gathered(10.0, false), gathered(2.0, false)), (false, false));
    // Several lidars, parts of a turn, and an unknown rate.
    assert_eq!((gathered(10.0, true), gathered(75.0, false), gathered(0.0, false)), (true, true, true));
    let marked = Lidar { max_range_metres: 10.0, ..lidar };
    let outside = Lidar { median_range_metres: 12.0, ..lidar };
    assert_eq!(farthest(Some(marked), Dimension::TwoD), 9.8);
    assert_eq!(farthest(Some(lidar), Dimension::TwoD), farthest(None, Dimension::TwoD));
    assert_eq!(farthest(Some(lidar), Dimension::ThreeD), 60.0);
    assert_eq!(farthest(Some(outside), Dimension::ThreeD), 100.0);
}
