//! Simulations in 3D against analytic truth.
#![allow(clippy::unwrap_used)] // helpers of tests fail as tests do

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, Vector3, quaternion_from_angle_axis};
use portolan_recording::{
    Imu, Message, PointCloud2, RecordedMessage, Recording, RecordingFormat, create, open,
};
use portolan_simulator::motion::{Carrier, Motion, SplineMotion};
use portolan_simulator::sensors::{
    BeamTable, Fault, GnssOptions, ImuOptions, LandmarkOptions, OdometryOptions, SpinningLidarOptions,
};
use portolan_simulator::{Scenario3dOptions, Simulation3d};
use portolan_worlds::three_d::Scene3d;
use portolan_worlds::three_d::SolidDraft;
use portolan_worlds::two_d::Material;

fn small(columns: usize) -> Vec<SpinningLidarOptions> {
    let beams = BeamTable { columns, ..BeamTable::vlp16() };
    vec![SpinningLidarOptions { beams, ..SpinningLidarOptions::default() }]
}

fn points(cloud: &PointCloud2) -> Vec<(Vector3, f64, u16)> {
    let point = |bytes: &[u8]| {
        let value = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
        (Vector3::new(value(0), value(4), value(8)), value(18), u16::from_le_bytes([bytes[16], bytes[17]]))
    };
    cloud.data.chunks_exact(cloud.point_step as usize).map(point).collect()
}

fn all_messages(recording: &dyn Recording) -> Vec<RecordedMessage> {
    let mut reader = recording.read(&|_| true).unwrap();
    std::iter::from_fn(|| reader.next_message().unwrap()).collect()
}

/// Every point, placed by the true pose at its own time, is on a wall of a box-shaped room.
#[test]
fn moving_sweeps_show_the_room_as_it_is() {
    let mut draft = SolidDraft::default();
    let (low, high) = ([-6.0, -4.0, 0.0], [6.0, 4.0, 3.5]);
    for axis in 0..3 {
        let (mut a, mut b) = (low, high);
        (a[axis], b[axis]) = (low[axis] - 0.2, low[axis]);
        draft.block(a, b, Material::Wall);
        (a, b) = (low, high);
        (a[axis], b[axis]) = (high[axis], high[axis] + 0.2);
        draft.block(a, b, Material::Wall);
    }
    let museum =
        Simulation3d::new(Scenario3dOptions { duration: Some(20.0), ..Scenario3dOptions::default() });
    let walk = museum.unwrap().motion().clone();
    let start = walk.state(6.0).map_from_base.translation.vector;
    // The museum's gait in a room of our own: far enough from its walls for 3 s.
    let mut lidars = small(300);
    lidars[0].beams.delays = (0..16).map(|i| 3e-4 * f64::from(i) / 16.0).collect();
    lidars[0].base_from_lidar = Rigid3::from_parts(
        na::Translation3::new(0.1, -0.2, 0.3),
        quaternion_from_angle_axis(&Vector3::new(0.3, 0.9, -0.4)),
    );
    let solids = draft.solids.iter().map(|solid| {
        let mut solid = *solid;
        if let portolan_worlds::three_d::Body::Box { centre, .. } = &mut solid.body {
            *centre += start - Vector3::new(0.0, 0.0, 1.3);
        }
        solid
    });
    let options =
        Scenario3dOptions { lidars, duration: Some(20.0), ..Scenario3dOptions::default() }.without_noise();
    let base_from_lidar = options.lidars[0].base_from_lidar;
    let simulation = Simulation3d::with_motion(options, solids.collect(), walk).unwrap();
    let (mut checked, mut largest, mut undistorted) = (0, 0.0_f64, 0.0_f64);
    for index in 50..75 {
        let cloud = simulation.sweep(0, index).unwrap();
        let pose_at = |time: f64| {
            let seconds = cloud.header.stamp.seconds_since(simulation.start_time()) + time;
            simulation.motion().state(seconds).map_from_base * base_from_lidar
        };
        for (point, time, _) in points(&cloud) {
            let off_wall = |pose: &Rigid3| {
                let p = (pose * na::Point3::from(point)).coords - start + Vector3::new(0.0, 0.0, 1.3);
                (0..3)
                    .map(|i| (p[i] - low[i]).abs().min((p[i] - high[i]).abs()))
                    .fold(f64::INFINITY, f64::min)
            };
            largest = largest.max(off_wall(&pose_at(time)));
            undistorted = undistorted.max(off_wall(&pose_at(0.0)));
            checked += 1;
        }
    }
    // Single precision of points and times: 1 µm and 4 ns.
    assert!(checked == 25 * 4800 && largest < 2e-6, "{checked} {largest}");
    assert!(undistorted > 0.02, "{undistorted}");
}

fn integrate(
    samples: &[Imu],
    start: &portolan_simulator::motion::MotionState,
    base_from_imu: &Rigid3,
) -> Rigid3 {
    let world_from_imu = start.map_from_base * base_from_imu;
    let mut rotation = world_from_imu.rotation;
    let mut position = world_from_imu.translation.vector;
    let arm = start.map_from_base.rotation * base_from_imu.translation.vector;
    let omega = start.map_from_base.rotation * start.angular_velocity_in_base;
    let mut velocity = start.velocity_in_map + omega.cross(&arm);
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    for pair in samples.windows(2) {
        let dt = pair[1].header.stamp.seconds_since(pair[0].header.stamp);
        let (a, b) = (Vector3::from(pair[0].angular_velocity), Vector3::from(pair[1].angular_velocity));
        // The second term corrects for the turn of the axis within the step (coning).
        let turn = (a + b) * (0.5 * dt) + a.cross(&b) * (dt * dt / 12.0);
        let next = rotation * quaternion_from_angle_axis(&turn);
        let before = rotation * Vector3::from(pair[0].linear_acceleration) + gravity;
        let after = next * Vector3::from(pair[1].linear_acceleration) + gravity;
        position += velocity * dt + (before / 3.0 + after / 6.0) * dt * dt;
        velocity += 0.5 * (before + after) * dt;
        rotation = next;
    }
    Rigid3::from_parts(na::Translation3::from(position), rotation) * base_from_imu.inverse()
}

#[test]
fn a_perfect_imu_integrates_to_the_truth() {
    let tilted = Rigid3::from_parts(
        na::Translation3::new(0.3, -0.2, 0.5),
        quaternion_from_angle_axis(&Vector3::new(0.5, -0.4, 1.2)),
    );
    for base_from_imu in [Rigid3::identity(), tilted] {
        let imu = ImuOptions { rate: 1000.0, base_from_imu, ..ImuOptions::default() };
        let options = Scenario3dOptions {
            duration: Some(60.0),
            imu: Some(imu),
            lidars: Vec::new(),
            ..Scenario3dOptions::default()
        };
        let simulation = Simulation3d::new(options.without_noise()).unwrap();
        let messages = all_messages(&simulation).into_iter();
        let samples: Vec<Imu> = messages
            .filter_map(|m| if let Message::Imu(imu) = m.message { Some(imu) } else { None })
            .collect();
        assert_eq!(samples.len(), 60_001);
        let start = simulation.motion_at(simulation.start_time()).unwrap();
        let end = integrate(&samples, &start, &base_from_imu);
        let error = end.inverse() * simulation.truth_at(samples.last().unwrap().header.stamp).unwrap();
        assert!(error.translation.vector.norm() < 0.02 && error.rotation.angle() < 1e-4, "{error}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |threads: usize, extension: &str| {
        let path = folder.path().join(format!("{threads}.{extension}"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut options = Scenario3dOptions::new(Scene3d::Museum, 5, 2);
            options.lidars.iter_mut().for_each(|l| l.beams.columns = 120);
            options.gnss = Some(GnssOptions::default());
            options.landmarks = Some(LandmarkOptions::default());
            options.odometry = Some(OdometryOptions::default());
            options.duration = Some(6.0);
            let simulation = Simulation3d::new(options).unwrap();
            let mut writer = create(&path, None::<RecordingFormat>).unwrap();
            for message in all_messages(&simulation) {
                writer.write(&message).unwrap();
            }
            writer.finish().unwrap();
        });
        std::fs::read(&path).unwrap()
    };
    for extension in ["bag", "mcap"] {
        let one = bytes(1, extension);
        assert!(one.len() > 100_000);
        assert!(one == bytes(2, extension) && one == bytes(4, extension));
        let read = open(folder.path().join(format!("1.{extension}"))).unwrap();
        let names: Vec<String> = read.topics().iter().map(|t| t.topic.to_string()).collect();
        assert_eq!(names, ["/fix", "/imu", "/landmark", "/odom", "/points2_1", "/points2_2", "/tf_static"]);
    }
}

#[test]
fn topics_are_announced_and_faults_happen() {
    for scene in Scene3d::ALL {
        let mut options = Scenario3dOptions { lidars: small(90), ..Scenario3dOptions::new(scene, 2, 1) };
        options.duration = Some(8.0);
        options.faults =
            ["nan:10", "empty:7", "gap:imu:2:3"].iter().map(|text| text.parse::<Fault>().unwrap()).collect();
        let simulation = Simulation3d::new(options).unwrap();
        let messages = all_messages(&simulation);
        assert!(messages.windows(2).all(|pair| pair[0].log_time <= pair[1].log_time));
        for topic in simulation.topics() {
            let count = messages.iter().filter(|m| m.topic == topic.topic).count();
            assert_eq!(topic.count, Some(count as u64), "{scene} {}", topic.topic);
        }
        let clouds = messages
            .iter()
            .filter_map(|m| if let Message::PointCloud2(c) = &m.message { Some(c) } else { None });
        let clouds: Vec<&PointCloud2> = clouds.collect();
        assert!(clouds.len() > 70 && clouds[6].width == 0 && points(clouds[9])[0].0.x.is_nan());
        let seen = clouds[21].width as f64 / (90.0 * 16.0);
        assert!(seen > 0.4, "{scene}: {seen}");
    }
}

#[test]
fn lidars_die_and_imus_saturate_or_are_turned() {
    let faults = ["dies:4", "saturate:0.5:9", "swap-axes"];
    let mut options = Scenario3dOptions::new(Scene3d::Museum, 2, 2);
    options.lidars.iter_mut().for_each(|lidar| lidar.beams.columns = 60);
    options.faults = faults.iter().map(|text| text.parse::<Fault>().unwrap()).collect();
    options.duration = Some(8.0);
    let simulation = Simulation3d::new(options).unwrap();
    let messages = all_messages(&simulation);
    let last = |topic: &str| messages.iter().rev().find(|m| &*m.topic == topic).unwrap().log_time;
    assert!(last("/points2_1").seconds_since(simulation.start_time()) > 7.8);
    assert!((last("/points2_2").seconds_since(simulation.start_time()) - 4.1).abs() < 0.1);
    for topic in simulation.topics() {
        let count = messages.iter().filter(|m| m.topic == topic.topic).count();
        assert_eq!(topic.count, Some(count as u64), "{}", topic.topic);
    }
    let imu = messages.iter().filter_map(|m| if let Message::Imu(i) = &m.message { Some(i) } else { None });
    let (mut on_y, mut largest) = (0.0, 0.0_f64);
    for sample in imu {
        on_y += sample.linear_acceleration[1] / 1601.0;
        let all = sample.linear_acceleration.iter().map(|v| v.abs() / 9.0);
        largest = all.chain(sample.angular_velocity.iter().map(|v| v.abs() / 0.5)).fold(largest, f64::max);
    }
    assert!(on_y > 8.0 && largest == 1.0, "{on_y} {largest}");
}

/// The whole tour keeps away from walls and furniture, climbs stairs, and ends at home.
#[test]
fn tours_are_free_of_obstacles_and_end_where_they_began() {
    for (scene, seeds, climb) in [
        (Scene3d::Museum, 1..6, 8.0),
        (Scene3d::Garage, 1..4, 5.5),
        (Scene3d::Park, 1..4, 0.3),
        (Scene3d::Tunnel, 1..4, -0.1),
        (Scene3d::Field, 1..3, 0.02),
    ] {
        for seed in seeds {
            let options = Scenario3dOptions { people: Some(0), ..Scenario3dOptions::new(scene, seed, 1) };
            let simulation = Simulation3d::new(options).unwrap();
            let (mut low, mut high, mut nearest) = (f64::INFINITY, f64::NEG_INFINITY, (f64::INFINITY, 0.0));
            let moment = simulation.world().moment(&Vector3::zeros(), 0.0, 0.0, 0.0);
            let mut time = 0.0;
            while time < simulation.duration() {
                let state = simulation.motion().state(time);
                let place = state.map_from_base.translation.vector;
                (low, high) = (low.min(place.z), high.max(place.z));
                for i in 0..8 {
                    let (s, c) = (f64::from(i) * 0.785).sin_cos();
                    let ray =
                        portolan_worlds::three_d::Ray3 { origin: place, direction: Vector3::new(c, s, 0.0) };
                    let hit = simulation.world().cast(&ray, 3.0, &moment, 0.0);
                    let range = hit.filter(|h| h.material != Material::Foliage).map_or(3.0, |h| h.range);
                    if range < nearest.0 {
                        nearest = (range, time);
                    }
                }
                assert!(
                    state.velocity_in_map.norm() < 2.0 && state.acceleration_in_map.norm() < 9.0,
                    "{state:?}"
                );
                assert!(state.angular_velocity_in_base.norm() < 3.5, "{scene} {seed} {time} {state:?}");
                time += 0.1;
            }
            assert!(nearest.0 > 0.25, "{scene} {seed}: {nearest:?}");
            assert!(high - low > climb, "{scene} {seed}: {low} to {high}");
            let ends = [0.0, simulation.duration()]
                .map(|t| simulation.motion().state(t).map_from_base.translation.vector);
            assert!((ends[1] - ends[0]).norm() < 0.1, "{ends:?}");
        }
    }
}

#[test]
fn satellites_are_seen_outside_and_landmarks_in_front() {
    let options = Scenario3dOptions {
        lidars: Vec::new(),
        imu: None,
        people: Some(0),
        gnss: Some(GnssOptions::default().without_noise()),
        landmarks: Some(LandmarkOptions::default().without_noise()),
        ..Scenario3dOptions::default()
    };
    let simulation = Simulation3d::new(options).unwrap();
    let (mut inside, mut outside, mut seen) = (0, 0, 0);
    for message in all_messages(&simulation) {
        let stamp = message.log_time;
        match message.message {
            Message::NavSatFix(fix) => {
                let place = simulation.truth_at(stamp).unwrap().translation.vector;
                let has_fix = fix.status >= 0;
                let is_inside = place.y > 0.5;
                inside += usize::from(is_inside);
                outside += usize::from(has_fix);
                assert!(!(has_fix && is_inside), "{place:?}");
                assert!(!has_fix || (fix.altitude - 250.0 - place.z - 0.7).abs() < 0.05);
            }
            Message::LandmarkList(list) => {
                for mark in list.landmarks {
                    let number: usize = mark.id.trim_start_matches("mark_").parse().unwrap();
                    let [x, y, z] = mark.tracking_from_landmark.position;
                    let pose = simulation.truth_at(stamp).unwrap();
                    let place = (pose * na::Point3::new(x, y, z)).coords;
                    assert!((place - simulation.landmarks()[number].translation.vector).norm() < 1e-9);
                    seen += 1;
                }
            }
            _ => {}
        }
    }
    assert!(inside > 500 && outside > 60 && seen > 300, "{inside} {outside} {seen}");
}

#[test]
fn standing_is_still_and_surfaces_are_written() {
    let options = Scenario3dOptions {
        standing: true,
        duration: Some(30.0),
        lidars: small(60),
        ..Scenario3dOptions::default()
    };
    let simulation = Simulation3d::new(options.without_noise()).unwrap();
    let (first, last) = (simulation.sweep(0, 0).unwrap(), simulation.sweep(0, 298).unwrap());
    assert!(first.data == last.data);
    let (mut json, mut ply) = (Vec::new(), Vec::new());
    simulation.write_surfaces_json(&mut json).unwrap();
    simulation.write_surfaces_ply(&mut ply).unwrap();
    let json = String::from_utf8(json).unwrap();
    assert_eq!(json.lines().count(), simulation.world().fixed().solids().len() + 2);
    assert!(ply.starts_with(b"ply\n") && ply.len() > 1_000_000);
    let mut tum = Vec::new();
    simulation.write_truth_tum(&mut tum, 200.0).unwrap();
    assert_eq!(tum.iter().filter(|b| **b == b'\n').count(), 6001);
    let still = SplineMotion::standing(Vector3::zeros(), 0.0, 1.0);
    assert_eq!(still.state(0.5).velocity_in_map, Vector3::zeros());
}

#[test]
fn worlds_of_every_size_can_be_walked() {
    for scene in Scene3d::ALL {
        for (size, storeys, clutter, carrier) in [
            (scene.minimum_size(), 1, 0.0, Carrier::Wheels),
            (scene.minimum_size(), 6, 3.0, Carrier::Walker),
            ([110.0, 90.0], 2, 1.0, Carrier::Walker),
        ] {
            let mut options = Scenario3dOptions { lidars: small(36), ..Scenario3dOptions::new(scene, 4, 1) };
            options.size = Some(size);
            options.storeys = Some(storeys);
            options.clutter = clutter;
            options.carrier = Some(carrier);
            options.people = Some(30);
            options.duration = Some(40.0);
            let simulation = Simulation3d::new(options).unwrap();
            let poses: Vec<Vector3> =
                simulation.truth(2.0).map(|(_, pose)| pose.translation.vector).collect();
            let length: f64 = poses.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            assert!(
                length > 20.0 && poses.iter().all(|p| p.iter().all(|v| v.is_finite())),
                "{scene} {size:?}"
            );
            let cloud = simulation.sweep(0, 100).unwrap();
            assert!(cloud.width > 36 * 16 / 4, "{scene} {size:?} {}", cloud.width);
        }
    }
}
