//! Scans against geometry that can be computed by hand.
#![allow(clippy::unwrap_used)] // helpers of tests fail as tests do

use portolan_geometry::{Vector2, Vector3, nalgebra as na};
use portolan_recording::LaserScan;
use portolan_simulator::motion::{Motion, MotionLimits, Walk, Waypoint};
use portolan_simulator::sensors::{LidarMount, LidarOptions, NoReturn};
use portolan_simulator::{ScenarioOptions, Simulation};
use portolan_worlds::two_d::{Draft, FloorPlan, Material, Scene};

/// A box of 8 m by 6 m.
fn box_room() -> FloorPlan {
    let mut draft = Draft::new();
    draft.aligned_box(Vector2::zeros(), Vector2::new(8.0, 6.0), Material::Wall);
    FloorPlan { shapes: draft.into_shapes(), size: Vector2::new(8.0, 6.0), ..FloorPlan::default() }
}

fn options(lidar: LidarOptions) -> ScenarioOptions {
    ScenarioOptions { lidars: vec![lidar], duration: Some(5.0), ..ScenarioOptions::default() }
}

fn in_box_room(lidar: LidarOptions, walk: Walk) -> Simulation {
    Simulation::with_walk(options(lidar), box_room(), walk).unwrap()
}

fn standing(x: f64, y: f64, heading: f64) -> Walk {
    Walk::standing(Vector2::new(x, y), heading, 10.0)
}

/// Distance from a point inside the box room to its walls.
fn range_in_box(x: f64, y: f64, angle: f64) -> f64 {
    let (sine, cosine) = angle.sin_cos();
    let to_side = if cosine > 0.0 { (8.0 - x) / cosine } else { -x / cosine };
    let to_end = if sine > 0.0 { (6.0 - y) / sine } else { -y / sine };
    to_side.min(to_end)
}

fn angle(scan: &LaserScan, beam: usize) -> f64 {
    f64::from(scan.angle_min) + beam as f64 * f64::from(scan.angle_increment)
}

#[test]
fn ranges_in_a_box_room_are_exact() {
    let plain = LidarOptions::default().without_noise();
    let mounts = [
        LidarMount::default(),
        LidarMount { x: 0.3, y: -0.1, yaw: 0.7, ..LidarMount::default() },
        LidarMount { x: 0.3, y: -0.1, yaw: 0.7, upside_down: true, z: 0.4 },
    ];
    for mount in mounts {
        for clockwise in [false, true] {
            let simulation =
                in_box_room(LidarOptions { mount, clockwise, ..plain.clone() }, standing(3.0, 2.0, 0.4));
            let scan = simulation.scan(0, 7).unwrap();
            let (sine, cosine) = 0.4_f64.sin_cos();
            let x = 3.0 + cosine * mount.x - sine * mount.y;
            let y = 2.0 + sine * mount.x + cosine * mount.y;
            assert_eq!((scan.ranges.len(), scan.angle_increment < 0.0), (360, clockwise));
            for (beam, range) in scan.ranges.iter().enumerate() {
                let in_lidar = angle(&scan, beam);
                let turned = if mount.upside_down { -in_lidar } else { in_lidar };
                let expected = range_in_box(x, y, 0.4 + mount.yaw + turned);
                assert!(
                    (f64::from(*range) - expected).abs() < 1e-6,
                    "{mount:?} beam {beam}: {range} {expected}"
                );
            }
        }
    }
}

#[test]
fn fields_of_a_scan_fit_together() {
    let simulation = in_box_room(
        LidarOptions { beams: 541, field_of_view: 4.712_389, rate: 40.0, ..LidarOptions::default() },
        standing(3.0, 2.0, 0.0),
    );
    let scan = simulation.scan(0, 0).unwrap();
    assert_eq!((scan.ranges.len(), scan.intensities.len()), (541, 541));
    assert!((scan.angle_min + 2.356_194_5).abs() < 1e-5 && (scan.angle_max - 2.356_194_5).abs() < 1e-5);
    let sweep = 540.0 * scan.time_increment;
    assert!((sweep - 0.75 / 40.0).abs() < 1e-6 && scan.scan_time == 0.025);
    let last_end = simulation.scan(0, simulation.scan_count(0) - 1).unwrap().header.stamp;
    assert!(simulation.end_time().seconds_since(last_end) >= f64::from(sweep) - 1e-6);
    assert!(simulation.scan(0, simulation.scan_count(0)).is_none() && simulation.scan(1, 0).is_none());
}

/// Points of a scan in the map, every beam from the true pose at its own time.
fn undistorted(simulation: &Simulation, scan: &LaserScan) -> Vec<Vector2> {
    let base_from_lidar = simulation.base_from_lidar(0).unwrap();
    let start = scan.header.stamp.seconds_since(simulation.start_time());
    let point = |(beam, range): (usize, &f32)| {
        let time = start + beam as f64 * f64::from(scan.time_increment);
        let map_from_lidar = simulation.walk().state(time).map_from_base * base_from_lidar;
        let (sine, cosine) = angle(scan, beam).sin_cos();
        let in_lidar = na::Point3::from(Vector3::new(cosine, sine, 0.0) * f64::from(*range));
        (map_from_lidar * in_lidar).coords.xy()
    };
    scan.ranges.iter().enumerate().filter(|(_, r)| r.is_finite()).map(point).collect()
}

#[test]
fn undistorted_scans_are_on_the_walls() {
    for scene in Scene::ALL {
        let options = ScenarioOptions { duration: Some(60.0), ..ScenarioOptions::new(scene, 3) };
        let simulation = Simulation::new(options.without_noise()).unwrap();
        let shapes = simulation.world().fixed().shapes();
        let (mut distortion, mut count) = (0.0_f64, 0);
        for index in (0..simulation.scan_count(0)).step_by(23) {
            let scan = simulation.scan(0, index).unwrap();
            for point in undistorted(&simulation, &scan) {
                let off = shapes.iter().map(|s| s.distance(&point).abs()).fold(f64::INFINITY, f64::min);
                assert!(off < 1e-5, "{scene} scan {index}: {off}");
                count += 1;
            }
            let frozen = LaserScan { time_increment: 0.0, ..scan };
            for point in undistorted(&simulation, &frozen) {
                let off = shapes.iter().map(|s| s.distance(&point).abs()).fold(f64::INFINITY, f64::min);
                distortion = distortion.max(off);
            }
        }
        assert!(count > 1000 && distortion > 0.03, "{scene}: {count} points, distortion {distortion}");
    }
}

#[test]
fn range_noise_has_the_requested_deviation() {
    let lidar = LidarOptions {
        range_noise: 0.02,
        range_noise_relative: 0.01,
        ..LidarOptions::default().without_noise()
    };
    let simulation = in_box_room(lidar, standing(4.0, 3.0, 0.0));
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for index in 0..simulation.scan_count(0) {
        let scan = simulation.scan(0, index).unwrap();
        for (beam, range) in scan.ranges.iter().enumerate() {
            let (sine, cosine) = angle(&scan, beam).sin_cos();
            let exact = range_in_box(4.12, 3.0, sine.atan2(cosine));
            let normalised = (f64::from(*range) - exact) / (0.02 + 0.01 * exact);
            sum += normalised;
            squares += normalised * normalised;
            count += 1.0;
        }
    }
    assert!(count > 10_000.0 && (sum / count).abs() < 0.03 && (squares / count - 1.0_f64).abs() < 0.04);
}

#[test]
fn missing_returns_are_written_as_requested() {
    type Check = fn(f32) -> bool;
    let expected: [(NoReturn, Check); 4] = [
        (NoReturn::Infinity, |r| r == f32::INFINITY),
        (NoReturn::BeyondMaximum, |r| r == 3.5),
        (NoReturn::Zero, |r| r == 0.0),
        (NoReturn::NotANumber, f32::is_nan),
    ];
    for (no_return, is_nothing) in expected {
        let lidar = LidarOptions {
            no_return,
            range_max: 2.5,
            range_min: 1.0,
            ..LidarOptions::default().without_noise()
        };
        let scan = in_box_room(lidar, standing(2.0, 0.5, 0.0)).scan(0, 0).unwrap();
        for (beam, range) in scan.ranges.iter().enumerate() {
            let exact = range_in_box(2.12, 0.5, angle(&scan, beam));
            match exact {
                e if e > 2.5 => assert!(is_nothing(*range), "{no_return:?}: {range}"),
                e if e < 1.0 => assert!(*range == f32::NEG_INFINITY || *range == 0.0),
                e => assert!((f64::from(*range) - e).abs() < 1e-6),
            }
        }
    }
}

#[test]
fn drop_outs_have_the_requested_rate() {
    let lidar = LidarOptions { drop_out: 0.2, ..LidarOptions::default().without_noise() };
    let simulation = in_box_room(lidar, standing(4.0, 3.0, 0.0));
    let scans: Vec<LaserScan> = (0..40).map(|i| simulation.scan(0, i).unwrap()).collect();
    let dropped = scans.iter().flat_map(|s| &s.ranges).filter(|r| r.is_infinite()).count();
    assert!((dropped as f64 / (40.0 * 360.0) - 0.2).abs() < 0.02);
}

/// A pillar 2 m before a wall; in front of both a pane.
fn pillar_and_pane(glass: bool) -> FloorPlan {
    let mut draft = Draft::new();
    draft.aligned_box(Vector2::zeros(), Vector2::new(8.0, 6.0), Material::Wall);
    draft.circle(Vector2::new(5.0, 3.0), 0.3, Material::Wall);
    if glass {
        draft.segment(Vector2::new(3.0, 0.5), Vector2::new(3.0, 5.5), Material::Glass);
    }
    FloorPlan { shapes: draft.into_shapes(), size: Vector2::new(8.0, 6.0), ..FloorPlan::default() }
}

#[test]
fn mixed_pixels_are_between_the_two_surfaces() {
    let lidar =
        LidarOptions { mixed_pixels: 1.0, beam_divergence: 0.02, ..LidarOptions::default().without_noise() };
    let walk = || standing(0.88, 3.0, 0.0);
    let mixed = Simulation::with_walk(options(lidar.clone()), pillar_and_pane(false), walk()).unwrap();
    let sharp =
        Simulation::with_walk(options(lidar.without_noise()), pillar_and_pane(false), walk()).unwrap();
    let mut between = 0;
    for index in 0..40 {
        let (mixed, sharp) = (mixed.scan(0, index).unwrap(), sharp.scan(0, index).unwrap());
        for (beam, range) in mixed.ranges.iter().enumerate() {
            if angle(&mixed, beam).abs() < 0.12 && (4.2..6.8).contains(range) {
                between += 1;
                assert_ne!(*range, sharp.ranges[beam]);
            }
        }
    }
    assert!((20..400).contains(&between), "{between}");
}

#[test]
fn panes_are_transparent_except_head_on() {
    let lidar = LidarOptions { glass_returns: true, ..LidarOptions::default().without_noise() };
    let simulation =
        Simulation::with_walk(options(lidar), pillar_and_pane(true), standing(0.88, 3.0, 0.0)).unwrap();
    let (mut seen_aslant, mut aslant, mut seen_head_on) = (0, 0, 0);
    for index in 0..45 {
        let scan = simulation.scan(0, index).unwrap();
        for (beam, range) in scan.ranges.iter().enumerate() {
            let angle = angle(&scan, beam);
            let on_pane = (f64::from(*range) * angle.cos() - 2.0).abs() < 1e-4;
            if angle.abs() < 0.004 {
                seen_head_on += usize::from(on_pane);
            } else if (0.3..0.6).contains(&angle.abs()) {
                aslant += 1;
                seen_aslant += usize::from(on_pane);
            }
        }
    }
    let share = seen_aslant as f64 / f64::from(aslant);
    assert!((0.02..0.1).contains(&share) && seen_head_on > 25, "{share} {seen_head_on}");
}

#[test]
fn a_moving_robot_smears_a_scan_only_with_motion_distortion() {
    let through = [Vector2::new(1.0, 3.0), Vector2::new(7.0, 3.0)];
    let waypoints = through.map(|position| Waypoint { position, stop: None });
    let walk = Walk::through(&waypoints, &MotionLimits::default(), 0.5, None).unwrap();
    let plain = LidarOptions::default().without_noise();
    let instant =
        in_box_room(LidarOptions { motion_distortion: false, ..plain.clone() }, walk.clone()).scan(0, 25);
    let swept = in_box_room(plain, walk).scan(0, 25);
    let (instant, swept) = (instant.unwrap(), swept.unwrap());
    assert_eq!(instant.time_increment, 0.0);
    let largest = |pair: (&f32, &f32)| f64::from((pair.0 - pair.1).abs());
    let difference = instant.ranges.iter().zip(&swept.ranges).map(largest).fold(0.0, f64::max);
    assert!(difference > 0.05, "{difference}");
    assert!((instant.ranges[0] - swept.ranges[0]).abs() < 1e-6, "the first beam is fired at the stamp");
}

#[test]
fn beams_meet_walls_or_the_legs_of_people_where_they_are_at_that_time() {
    let quiet =
        ScenarioOptions { duration: Some(60.0), ..ScenarioOptions::new(Scene::Hall, 4) }.without_noise();
    let simulation = Simulation::new(ScenarioOptions { people: Some(40), ..quiet }).unwrap();
    assert_eq!(simulation.world().people().len(), 40);
    let shapes = simulation.world().fixed().shapes();
    let mut on_legs = 0;
    for index in (0..simulation.scan_count(0)).step_by(31) {
        let scan = simulation.scan(0, index).unwrap();
        let start = scan.header.stamp.seconds_since(simulation.start_time());
        let returns = scan.ranges.iter().enumerate().filter(|(_, r)| r.is_finite()).map(|(beam, _)| beam);
        for (beam, point) in returns.zip(undistorted(&simulation, &scan)) {
            let time = start + beam as f64 * f64::from(scan.time_increment);
            let robot = simulation.walk().state_2d(time).position;
            let legs: Vec<_> =
                simulation.world().people().iter().flat_map(|person| person.legs(time, &robot)).collect();
            let nearest = |shapes: &[portolan_worlds::two_d::Shape]| {
                shapes.iter().map(|s| s.distance(&point).abs()).fold(f64::INFINITY, f64::min)
            };
            let (wall, leg) = (nearest(shapes), nearest(&legs));
            assert!(wall.min(leg) < 1e-5, "scan {index} beam {beam}: {wall} m, {leg} m");
            on_legs += usize::from(leg < 1e-5);
        }
    }
    assert!(on_legs > 50, "{on_legs}");
}
