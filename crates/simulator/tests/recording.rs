//! The simulation as a recording: order, determinism, files, faults.
#![allow(clippy::unwrap_used)] // helpers of tests fail as tests do

use portolan_geometry::Vector2;
use portolan_recording::{LaserScan, Message, RecordedMessage, Recording, RecordingFormat, create, open};
use portolan_simulator::sensors::{Fault, FaultTarget, LidarMount, LidarOptions};
use portolan_simulator::{ScenarioOptions, Simulation};
use portolan_worlds::two_d::{FloorPlan, Material, Scene, Shape};

fn options(seed: u64, duration: f64) -> ScenarioOptions {
    ScenarioOptions { seed, duration: Some(duration), ..ScenarioOptions::default() }
}

fn with_faults(faults: &[&str]) -> Simulation {
    let faults = faults.iter().map(|text| text.parse::<Fault>().unwrap()).collect();
    Simulation::new(ScenarioOptions { faults, ..options(1, 20.0) }).unwrap()
}

fn all_messages(recording: &dyn Recording) -> Vec<RecordedMessage> {
    let mut reader = recording.read(&|_| true).unwrap();
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        messages.push(message);
    }
    assert!(reader.issues().is_empty());
    messages
}

fn stamps(simulation: &Simulation, topic: &str) -> Vec<f64> {
    let on_topic = all_messages(simulation).into_iter().filter(|m| &*m.topic == topic);
    on_topic.map(|m| m.message.header().unwrap().stamp.seconds_since(simulation.start_time())).collect()
}

fn scans(messages: &[RecordedMessage]) -> Vec<&LaserScan> {
    messages
        .iter()
        .filter_map(|m| if let Message::LaserScan(s) = &m.message { Some(s) } else { None })
        .collect()
}

#[test]
fn messages_come_in_order_and_as_many_as_announced() {
    let back = LidarOptions {
        topic: "/scan_back".to_owned(),
        frame: "laser_back".to_owned(),
        mount: LidarMount { x: -0.2, yaw: std::f64::consts::PI, ..LidarMount::default() },
        rate: 7.0,
        ..LidarOptions::default()
    };
    let lidars = vec![LidarOptions::default(), back];
    let simulation = Simulation::new(ScenarioOptions { lidars, ..options(3, 15.0) }).unwrap();
    let messages = all_messages(&simulation);
    assert!(messages.windows(2).all(|pair| pair[0].log_time <= pair[1].log_time));
    let (first, last) = simulation.time_range().unwrap();
    assert!(messages.iter().all(|m| (first..=last).contains(&m.log_time)));
    let topics = simulation.topics();
    let names: Vec<&str> = topics.iter().map(|t| &*t.topic).collect();
    assert_eq!(names, ["/imu", "/odom", "/scan", "/scan_back", "/tf_static"]);
    for topic in &topics {
        let here: Vec<_> = messages.iter().filter(|m| m.topic == topic.topic).collect();
        assert_eq!(topic.count, Some(here.len() as u64), "{}", topic.topic);
        assert!(here.iter().all(|m| m.message.type_name() == &*topic.type_name));
    }
    let Some(Message::Tf(tf)) = messages.iter().map(|m| &m.message).find(|m| matches!(m, Message::Tf(_)))
    else {
        panic!("no tf");
    };
    let children: Vec<&str> = tf.transforms.iter().map(|t| &*t.child_frame_id).collect();
    assert!(tf.is_static && children == ["laser", "laser_back", "imu_link"]);
    let mut reader = simulation.read(&|info| &*info.topic == "/odom").unwrap();
    while let Some(message) = reader.next_message().unwrap() {
        assert!(matches!(message.message, Message::Odometry(_)));
    }
    assert!(reader.position_bytes() < simulation.size_bytes());
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |threads: usize, extension: &str| {
        let path = folder.path().join(format!("{threads}.{extension}"));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let simulation = Simulation::new(options(5, 20.0)).unwrap();
            let mut writer = create(&path, None::<RecordingFormat>).unwrap();
            let count = simulation.write_messages(&mut *writer).unwrap();
            assert_eq!(count, simulation.topics().iter().filter_map(|t| t.count).sum::<u64>());
            writer.finish().unwrap();
        });
        std::fs::read(&path).unwrap()
    };
    for extension in ["bag", "mcap"] {
        let one = bytes(1, extension);
        assert!(one.len() > 100_000 && one == bytes(2, extension) && one == bytes(4, extension));
    }
}

#[test]
fn written_files_hold_the_same_messages() {
    let folder = tempfile::tempdir().unwrap();
    let simulation = Simulation::new(options(6, 8.0)).unwrap();
    for name in ["walk.bag", "walk.mcap"] {
        let path = folder.path().join(name);
        let mut writer = create(&path, None).unwrap();
        simulation.write_messages(&mut *writer).unwrap();
        writer.finish().unwrap();
        let (made, read) = (all_messages(&simulation), all_messages(&*open(&path).unwrap()));
        assert_eq!(made.len(), read.len());
        for (made, read) in made.iter().zip(&read) {
            assert_eq!((&made.topic, made.log_time), (&read.topic, read.log_time));
            assert_eq!(made.message, read.message, "{name}");
        }
    }
}

#[test]
fn seeds_give_other_walks_and_buildings() {
    let make = |seed, building_seed| {
        Simulation::new(ScenarioOptions { building_seed, ..options(seed, 10.0) }).unwrap()
    };
    let (a, b, c) = (make(1, None), make(2, None), make(2, Some(1)));
    assert_ne!(a.plan().shapes, b.plan().shapes);
    assert_eq!(a.plan().shapes, c.plan().shapes, "the same building");
    let end = |s: &Simulation| s.truth_at(s.end_time()).unwrap().translation.vector;
    assert!((end(&a) - end(&c)).norm() > 0.1, "another walk");
    assert_ne!(a.scan(0, 5), c.scan(0, 5));
    assert_eq!(a.scan(0, 5), make(1, None).scan(0, 5));
    for scene in Scene::ALL {
        let draw = |seed| Simulation::new(ScenarioOptions { scene, ..options(seed, 5.0) }).unwrap();
        assert_eq!(draw(8).plan().shapes, draw(8).plan().shapes);
    }
}

#[test]
fn stamps_can_be_duplicated_or_go_backward() {
    let times = stamps(&with_faults(&["duplicate:scan:10", "backward:imu:100:0.25"]), "/scan");
    let equal = times.windows(2).filter(|pair| pair[0] == pair[1]).count();
    assert_eq!(equal, times.len() / 10);
    let times = stamps(&with_faults(&["backward:imu:100:0.25"]), "/imu");
    let backward = times.windows(2).filter(|pair| pair[1] < pair[0]).count();
    assert_eq!((backward, times.len() / 100), (20, 20));
    assert!((times[99] - (0.99 - 0.25)).abs() < 1e-6);
}

#[test]
fn gaps_and_clock_offsets_have_the_requested_times() {
    let simulation = with_faults(&["gap:odom:5:7.5", "clock:odom:-0.1"]);
    let times = stamps(&simulation, "/odom");
    assert!(times.iter().all(|t| !(4.95..7.35).contains(t)));
    assert!((times[0] + 0.1).abs() < 1e-6);
    let announced = simulation.topics().into_iter().find(|t| &*t.topic == "/odom").unwrap().count;
    assert_eq!(announced, Some(times.len() as u64));
    assert_eq!(times.len(), 1001 - 125);
}

#[test]
fn scans_can_be_empty_or_without_numbers() {
    let messages = all_messages(&with_faults(&["nan:5", "empty:7"]));
    let scans = scans(&messages);
    for (i, scan) in scans.iter().enumerate() {
        let (nan, empty) = ((i + 1) % 5 == 0, (i + 1) % 7 == 0);
        assert_eq!(scan.ranges.is_empty(), empty);
        assert_eq!(!empty && scan.ranges.iter().all(|r| r.is_nan()), nan && !empty);
    }
}

#[test]
fn odometry_jumps_in_its_own_frame() {
    let poses = |faults: &[&str]| -> Vec<[f64; 3]> {
        let messages = all_messages(&with_faults(faults));
        let odometry = messages.iter().filter_map(|m| match &m.message {
            Message::Odometry(o) => Some(o.pose),
            _ => None,
        });
        odometry
            .map(|p| [p.position[0], p.position[1], 2.0 * p.orientation_xyzw[2].atan2(p.orientation_xyzw[3])])
            .collect()
    };
    let (plain, jumped) = (poses(&[]), poses(&["jump:10:1:0.5:0.3"]));
    assert_eq!(plain[499], jumped[499]);
    let (dx, dy) = (jumped[500][0] - plain[500][0], jumped[500][1] - plain[500][1]);
    assert!((dx.hypot(dy) - 1.25_f64.sqrt()).abs() < 1e-9);
    let (sine, cosine) = plain[500][2].sin_cos();
    assert!((cosine * dx + sine * dy - 1.0).abs() < 1e-9);
    // Later steps are those of the robot, seen from the jumped frame.
    let step = |poses: &[[f64; 3]]| (poses[900][0] - poses[600][0]).hypot(poses[900][1] - poses[600][1]);
    assert!((step(&plain) - step(&jumped)).abs() < 1e-9);
}

#[test]
fn transforms_and_gravity_can_be_missing() {
    let topics = |faults: &[&str]| with_faults(faults).topics().iter().any(|t| &*t.topic == "/tf_static");
    assert!(topics(&["no-tf:scan"]) && !topics(&["no-tf:scan", "no-tf:imu"]));
    let mean_up = |faults: &[&str]| {
        let messages = all_messages(&with_faults(faults));
        let up = messages.iter().filter_map(|m| match &m.message {
            Message::Imu(imu) => Some(imu.linear_acceleration[2]),
            _ => None,
        });
        up.sum::<f64>() / 2001.0
    };
    assert!((mean_up(&[]) - 9.81).abs() < 0.2 && mean_up(&["no-gravity"]).abs() < 0.2);
    let bad = vec![Fault::NanScan { every: 0 }, Fault::MissingTransform { target: FaultTarget::Scan }];
    assert!(Simulation::new(ScenarioOptions { faults: bad, ..options(1, 5.0) }).is_err());
}

#[test]
fn plans_that_cannot_be_used_are_refused() {
    let plan = Simulation::new(options(1, 5.0)).unwrap().plan().clone();
    let refused = |change: &dyn Fn(&mut FloorPlan)| {
        let mut plan = plan.clone();
        change(&mut plan);
        Simulation::in_plan(options(1, 5.0), plan).unwrap_err().to_string()
    };
    assert!(refused(&|plan| plan.size.x = f64::NAN).contains("sides"));
    assert!(refused(&|plan| plan.passages[0].to = 10_000).contains("place 10000"));
    assert!(refused(&|plan| plan.places[0].position.y = 1e9).contains("not on or near the floor"));
    let far = Shape::circle(Vector2::new(0.0, 0.0), f64::INFINITY, Material::Wall);
    assert!(refused(&|plan| plan.shapes.push(far)).contains("surface"));
    assert!(refused(&|plan| (plan.places.clear(), plan.passages.clear()).0).contains("junction"));
    assert!(Simulation::in_plan(options(1, 5.0), plan.clone()).is_ok());
}
