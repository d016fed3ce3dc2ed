//! How accurate maps of real recordings are. Limits are 1.3 times what was measured, which stands beside each.
//!
//! Without the data nothing here is tested; see TESTING.md.
#![allow(clippy::unwrap_used, clippy::panic)]

mod planar_slices;
mod wheels_and_fixes;

use crate::common;

use std::path::Path;

use common::{portolan, portolan_with_code, real, text, trajectory_errors};
use portolan_evaluation::{Alignment, Association, TimedPose, Trajectory, absolute_errors, read_tum};
use portolan_geometry::{Rigid2, Rigid3, Vector3};
use portolan_recording::{Message, RecordedMessage};
use portolan_testing::is_fast;

/// Maps into a folder. Reading may lose data: clouds or scans that are damaged or out of order in the recording.
#[track_caller]
fn map(recording: &str, folder: &Path, more: &[&str]) {
    let run = portolan(&[&["map", recording, "-o", &text(folder), "-q", "--no-xray"], more].concat());
    assert!(matches!(run.code, Some(0 | 3)), "{recording}: {:?} {}", run.code, run.stderr);
}

/// Mean absolute errors of the relations, metres and degrees. Relations beyond the ends of the trajectory count from
/// its ends.
fn relation_errors(folder: &Path, relations: &str) -> (f64, f64) {
    let map = text(&folder.join("map.pbstream"));
    let run = portolan_with_code(0, &["evaluate", "relations", &map, relations]);
    let value = |name: &str| {
        let line = run.stdout.lines().find_map(|line| line.strip_prefix(name)).unwrap();
        line.split_whitespace().next().unwrap().parse::<f64>().unwrap()
    };
    (value("Abs translational error"), value("Abs rotational error"))
}

/// The relations within the first seconds of a file of relations, as a file in `folder`.
fn relations_of_start(relations: &str, seconds: f64, folder: &Path) -> String {
    let all = std::fs::read_to_string(relations).unwrap();
    let times = |line: &str| {
        let mut times = line.split_whitespace().map(|word| word.parse::<f64>().unwrap());
        [times.next().unwrap(), times.next().unwrap()]
    };
    let lines: Vec<(&str, [f64; 2])> = all.lines().map(|line| (line, times(line))).collect();
    let start = lines.iter().flat_map(|(_, times)| *times).fold(f64::INFINITY, f64::min);
    let is_early = |times: &[f64; 2]| times.iter().all(|time| *time < start + seconds);
    let early = lines.iter().filter(|(_, times)| is_early(times)).map(|(line, _)| format!("{line}\n"));
    let file = folder.join("start.relations");
    std::fs::write(&file, early.collect::<String>()).unwrap();
    text(&file)
}

/// A log in 2D and the mean error of its relations when that was measured, metres.
struct Log<'a> {
    name: &'a str,
    more: &'a [&'a str],
    /// Relations of so many seconds from the first one on are judged; none: all.
    seconds: Option<f64>,
    measured: f64,
}

fn assert_accuracy(log: &Log) {
    let name = log.name;
    let Some(recording) = real(&format!("lidar2d/{name}/{name}.clf.bz2")) else { return };
    let Some(mut relations) = real(&format!("lidar2d/{name}/{name}.relations")) else { return };
    let folder = tempfile::tempdir().unwrap();
    map(&recording, folder.path(), log.more);
    if let Some(seconds) = log.seconds {
        relations = relations_of_start(&relations, seconds, folder.path());
    }
    let (metres, _) = relation_errors(folder.path(), &relations);
    assert!(metres <= 1.3 * log.measured, "{name}: {metres} m, measured {} m", log.measured);
}

#[test]
fn aces_is_as_accurate_as_published_and_its_loop_closures_are_right() {
    if is_fast() {
        return;
    }
    let Some(aces) = real("lidar2d/aces") else { return };
    let folder = tempfile::tempdir().unwrap();
    map(&format!("{aces}/aces.bag"), folder.path(), &["--all-poses"]);
    let (metres, degrees) = relation_errors(folder.path(), &format!("{aces}/aces.relations"));
    assert!(metres <= 0.0375 && degrees <= 0.373, "{metres} m, {degrees} deg");
    let map = text(&folder.path().join("map.pbstream"));
    let truth = format!("{aces}/reference_poses.csv");
    let run = portolan_with_code(0, &["evaluate", "loops", &map, &truth, "--json"]);
    let judged: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    // Measured: 0.960; what is beyond 0.2 m is at most 0.3 m off, by poses that are good to 0.05 m.
    assert!(judged["fraction_right"].as_f64().unwrap() >= 0.95, "{judged}");
    let scans = std::fs::read_to_string(folder.path().join("all_poses.tum")).unwrap();
    let poses = scans.lines().filter(|line| !line.starts_with('#')).count() as u64;
    let report = std::fs::read(folder.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(poses, report["scans"].as_u64().unwrap());
}

#[test]
fn no_map_breaks_without_odometry() {
    if is_fast() {
        return;
    }
    // Half of them is enough to break: what is torn is torn by metres.
    let cut = |seconds: &'static str| ["--no-odometry", "--duration", seconds];
    for log in [
        Log { name: "aces", more: &cut("700"), seconds: Some(660.0), measured: 0.033 },
        Log { name: "fr079", more: &cut("500"), seconds: Some(480.0), measured: 0.068 },
    ] {
        assert_accuracy(&log);
    }
}

/// Stamps in bursts that go back.
#[test]
fn intel_is_accurate() {
    if is_fast() {
        return;
    }
    // The first relation is 33 s after the first scan.
    assert_accuracy(&Log {
        name: "intel",
        more: &["--duration", "300"],
        seconds: Some(260.0),
        measured: 0.066,
    });
}

/// Wheel odometry that stalls and jumps.
#[test]
fn mit_csail_is_accurate() {
    if is_fast() {
        return;
    }
    assert_accuracy(&Log { name: "mit-csail", more: &[], seconds: None, measured: 0.071 });
}

/// Scans that are half a metre to three metres apart.
#[test]
fn sparse_logs_are_accurate() {
    if is_fast() {
        return;
    }
    for (name, measured) in [("fr101-rawodo", 0.037), ("orebro", 0.060), ("fhw", 0.087)] {
        assert_accuracy(&Log { name, more: &[], seconds: None, measured });
    }
}

fn read(path: &str) -> Trajectory {
    read_tum(std::io::BufReader::new(std::fs::File::open(path).unwrap())).unwrap().0
}

/// Truth and estimate of a drive. `lever`: position of the lidar relative to the reference point of the
/// truth, metres.
fn drive(name: &str, lever: [f64; 3]) -> Option<(Trajectory, Trajectory)> {
    let recording = real(&format!("lidar3d/{name}.bag"))?;
    let truth = read(&real(&format!("lidar3d/{name}.truth.tum"))?);
    let folder = tempfile::tempdir().unwrap();
    map(&recording, folder.path(), &[]);
    let truth_from_lidar = Rigid3::from_parts(Vector3::from(lever).into(), Default::default());
    let moved = |pose: &TimedPose| TimedPose {
        map_from_tracking: pose.map_from_tracking * truth_from_lidar,
        ..*pose
    };
    let truth = Trajectory::new(truth.poses().iter().map(moved)).0;
    Some((truth, read(&text(&folder.path().join("trajectory.tum")))))
}

/// Root mean square of the position errors after alignment, metres.
fn error_of(truth: &Trajectory, estimate: &Trajectory) -> f64 {
    let errors = absolute_errors(truth, estimate, Association::default(), Alignment::Se3).unwrap();
    assert!(errors.count >= 20, "{}", errors.count);
    errors.translation.rmse
}

#[test]
fn real_drives_are_followed() {
    if is_fast() {
        return;
    }
    // 60 sweeps at 13 m/s against GNSS and INS, good to about 0.1 m. KISS-ICP: 0.046 m.
    let Some((truth, estimate)) = drive("kitti_0001", [0.81, -0.32, 0.80]) else { return };
    let error = error_of(&truth, &estimate);
    assert!(error <= 1.3 * 0.034, "{error} m");
    // 52 sweeps through a bend against wheels and INS. The path by the wheels is 1.5 % too short: see
    // docs/experiments/2026-11-skew.md. Without that the shape is judged.
    let Some((truth, estimate)) = drive("kitti_0005", [0.0; 3]) else { return };
    let error = error_of(&truth, &estimate);
    let scaled = |pose: &TimedPose| {
        let mut pose = *pose;
        pose.map_from_tracking.translation.vector *= 0.9824;
        pose
    };
    let shape = error_of(&truth, &Trajectory::new(estimate.poses().iter().map(scaled)).0);
    assert!(error <= 1.3 * 0.115 && shape <= 1.3 * 0.021, "{error} m, shape {shape} m");
}

/// A recording with each message, and its number, changed into others.
fn rewritten(
    recording: &str,
    output: &Path,
    mut change: impl FnMut(usize, RecordedMessage) -> Vec<RecordedMessage>,
) {
    let recording = portolan_recording::open(recording).unwrap();
    let mut reader = recording.read(&|_| true).unwrap();
    let mut writer = portolan_recording::create(output, None).unwrap();
    let messages = std::iter::from_fn(|| reader.next_message().unwrap()).enumerate();
    messages.flat_map(|(i, message)| change(i, message)).for_each(|m| writer.write(&m).unwrap());
    writer.finish().unwrap();
}

/// Those sweeps of a recording whose numbers are wanted.
fn sweeps(recording: &str, are_wanted: impl Fn(usize) -> bool, output: &Path) {
    rewritten(recording, output, |i, message| if are_wanted(i) { vec![message] } else { Vec::new() });
}

/// Where a scanner reaches 4 m, half of the scans of this log have fewer returns than a turn has corners.
#[test]
fn scans_of_a_few_beams_are_weighed_with_odometry() {
    let Some(recording) = real("lidar2d/fr101-rawodo/fr101-rawodo.clf.bz2") else { return };
    let relations = real("lidar2d/fr101-rawodo/fr101-rawodo.relations").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let short = folder.path().join("short.bag");
    rewritten(&recording, &short, |_, mut message| {
        if let Message::LaserScan(scan) = &mut message.message {
            scan.ranges.iter_mut().filter(|range| **range > 4.0).for_each(|range| *range = 81.83);
        }
        vec![message]
    });
    map(&text(&short), folder.path(), &[]);
    let (metres, _) = relation_errors(folder.path(), &relations);
    assert!(metres <= 1.3 * 0.189, "{metres} m");
}

/// Odometry that measures the translation but not the rotation during some seconds, in scans that are one to
/// three metres apart.
#[test]
fn turns_that_odometry_misses_are_found_in_sparse_scans() {
    let Some(recording) = real("lidar2d/orebro/orebro.clf.bz2") else { return };
    let relations = real("lidar2d/orebro/orebro.relations").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let missed = folder.path().join("missed.bag");
    let is_missed =
        |seconds: f64| [(121.4, 141.0), (227.0, 230.5)].iter().any(|(a, b)| (*a..*b).contains(&seconds));
    let mut start = None;
    let mut last: Option<[Rigid2; 2]> = None;
    rewritten(&recording, &missed, |_, mut message| {
        let seconds = message.log_time.seconds_since(*start.get_or_insert(message.log_time));
        if let Message::Odometry(odometry) = &mut message.message {
            let ([x, y, _], [_, _, sine, cosine]) = (odometry.pose.position, odometry.pose.orientation_xyzw);
            let given = Rigid2::new(x, y, 2.0 * sine.atan2(cosine));
            let written = last.map_or(given, |[given_before, written_before]| {
                let step = given_before.inverse() * given;
                written_before * Rigid2 { angle: if is_missed(seconds) { 0.0 } else { step.angle }, ..step }
            });
            last = Some([given, written]);
            let (sine, cosine) = (written.angle / 2.0).sin_cos();
            odometry.pose.position = [written.translation.x, written.translation.y, 0.0];
            odometry.pose.orientation_xyzw = [0.0, 0.0, sine, cosine];
        }
        vec![message]
    });
    map(&text(&missed), folder.path(), &[]);
    let (metres, _) = relation_errors(folder.path(), &relations);
    assert!(metres <= 1.3 * 0.07, "{metres} m");
}

/// Stamps come in bursts from the first second on.
#[test]
fn a_log_with_bursts_of_stamps_keeps_its_first_scans() {
    let Some(recording) = real("lidar2d/intel/intel.clf.bz2") else { return };
    let folder = tempfile::tempdir().unwrap();
    for more in [&["--duration", "90"][..], &["--duration", "90", "--no-odometry"]] {
        let out = text(&folder.path().join(more.len().to_string()));
        portolan_with_code(0, &[&["map", &recording, "-o", &out, "-q", "--no-xray"], more].concat());
    }
}

/// The cloud as a lidar sees it that looks down by so many degrees.
fn looking_down(mut message: RecordedMessage, degrees: f32) -> RecordedMessage {
    let Message::PointCloud2(cloud) = &mut message.message else { return message };
    let at = |name: &str| cloud.fields.iter().find(|field| field.name == name).unwrap().offset as usize;
    let (x, z, step) = (at("x"), at("z"), cloud.point_step as usize);
    let (sine, cosine) = degrees.to_radians().sin_cos();
    for point in cloud.data.chunks_exact_mut(step) {
        let read = |at: usize| f32::from_le_bytes(point[at..at + 4].try_into().unwrap());
        let (ahead, up) = (cosine * read(x) - sine * read(z), sine * read(x) + cosine * read(z));
        point[x..x + 4].copy_from_slice(&ahead.to_le_bytes());
        point[z..z + 4].copy_from_slice(&up.to_le_bytes());
    }
    message
}

/// Upright structures show the first motion; the vertical is not known from the mounting of a lidar.
#[test]
fn a_start_at_speed_is_found_by_a_lidar_that_looks_down() {
    let Some(recording) = real("lidar3d/kitti_0001.bag") else { return };
    let truth = read(&real("lidar3d/kitti_0001.truth.tum").unwrap());
    let folder = tempfile::tempdir().unwrap();
    let tilted = folder.path().join("tilted.bag");
    rewritten(&recording, &tilted, |_, message| vec![looking_down(message, 30.0)]);
    map(&text(&tilted), folder.path(), &[]);
    let estimate = read(&text(&folder.path().join("trajectory.tum")));
    let errors = absolute_errors(&truth, &estimate, Association::default(), Alignment::Se3).unwrap();
    let error = errors.translation.rmse;
    assert!(errors.count >= 58 && error <= 1.3 * 0.0302, "{} poses, {error} m", errors.count);
}

/// Recordings put together may have every message twice.
#[test]
fn duplicate_sweeps_do_not_change_the_map() {
    let Some(recording) = real("lidar3d/kitti_0001.bag") else { return };
    let folder = tempfile::tempdir().unwrap();
    let (twice, of_once, of_twice) =
        (folder.path().join("twice.bag"), folder.path().join("once"), folder.path().join("twice"));
    rewritten(&recording, &twice, |_, message| vec![message.clone(), message]);
    map(&recording, &of_once, &["--duration", "2"]);
    map(&text(&twice), &of_twice, &["--duration", "2"]);
    let trajectory = |folder: &Path| std::fs::read(folder.join("trajectory.tum")).unwrap();
    assert!(trajectory(&of_once) == trajectory(&of_twice));
}

/// At 13 m/s, with 3.9 m from sweep to sweep, the first two sweeps fit about as well where the car hardly moved.
#[test]
fn a_start_at_speed_is_found_with_sweeps_far_apart() {
    let Some(recording) = real("lidar3d/kitti_0001.bag") else { return };
    let truth = read(&real("lidar3d/kitti_0001.truth.tum").unwrap());
    for first in [0, 1] {
        let folder = tempfile::tempdir().unwrap();
        let sparse = folder.path().join("sparse.bag");
        sweeps(&recording, |i| i >= first && (i - first) % 3 == 0, &sparse);
        map(&text(&sparse), folder.path(), &[]);
        let estimate = read(&text(&folder.path().join("trajectory.tum")));
        let errors = absolute_errors(&truth, &estimate, Association::default(), Alignment::Se3).unwrap();
        // Measured: 0.040 and 0.037 m, without the lever arm of the truth.
        assert!(
            errors.count >= 19 && errors.translation.rmse <= 0.052,
            "{first}: {}",
            errors.translation.rmse
        );
    }
}

/// Nothing comes for two seconds, while a car brakes from 11.6 to 11.0 m/s: as if it had gone on as before, it is put 1.3 m
/// too far, where the street looks alike.
#[test]
fn a_car_that_brakes_in_a_gap_is_found_again() {
    let Some(recording) = real("lidar3d/kitti_0001.bag") else { return };
    let truth = read(&real("lidar3d/kitti_0001.truth.tum").unwrap());
    let folder = tempfile::tempdir().unwrap();
    let paused = folder.path().join("paused.bag");
    sweeps(&recording, |i| !(24..44).contains(&i), &paused);
    map(&text(&paused), folder.path(), &[]);
    let estimate = read(&text(&folder.path().join("trajectory.tum")));
    let errors = absolute_errors(&truth, &estimate, Association::default(), Alignment::Se3).unwrap();
    let error = errors.translation.rmse;
    assert!(errors.count >= 38 && error <= 0.045, "{} poses, {error} m", errors.count);
}

/// Nothing comes for four seconds, in which a car drives 17 m through a bend of 51 degrees; another one, 48 m, so that the
/// first sweep hardly sees what was seen before.
#[test]
fn cars_are_found_again_after_four_seconds_or_that_is_reported() {
    for (name, missing, code, measured) in
        [("kitti_0005", 9..49, 0, 0.048), ("kitti_0001", 10..50, 3, 0.047), ("kitti_0001", 9..49, 3, 0.705)]
    {
        let Some(recording) = real(&format!("lidar3d/{name}.bag")) else { return };
        let truth = read(&real(&format!("lidar3d/{name}.truth.tum")).unwrap());
        let folder = tempfile::tempdir().unwrap();
        let paused = text(&folder.path().join("paused.bag"));
        sweeps(&recording, |i| !missing.contains(&i), Path::new(&paused));
        portolan_with_code(code, &["map", &paused, "-o", &text(folder.path()), "-q", "--no-xray"]);
        let estimate = read(&text(&folder.path().join("trajectory.tum")));
        let errors = absolute_errors(&truth, &estimate, Association::default(), Alignment::Se3).unwrap();
        let error = errors.translation.rmse;
        assert!(errors.count >= 10 && error <= 1.3 * measured, "{name}: {} poses, {error} m", errors.count);
    }
}

/// Key frames of a carried lidar at 2 Hz, up to 29 degrees apart: their steps against odometry at the rate of the lidar.
#[test]
fn key_frames_far_apart_are_followed() {
    let Some(recording) = real("lidar3d/keyframes_os0.bag") else { return };
    let Some(odometry) = real("lidar3d/keyframes_os0.input.tum") else { return };
    let folder = tempfile::tempdir().unwrap();
    map(&recording, folder.path(), &[]);
    let (estimate, odometry) = (read(&text(&folder.path().join("trajectory.tum"))), read(&odometry));
    let steps = |trajectory: &Trajectory| -> Vec<Rigid3> {
        let pairs = trajectory.poses().windows(2);
        pairs.map(|pair| pair[0].map_from_tracking.inverse() * pair[1].map_from_tracking).collect()
    };
    let errors = steps(&estimate).into_iter().zip(steps(&odometry));
    let errors = errors.map(|(a, b)| (a.translation.vector - b.translation.vector).norm());
    let (count, worst) = errors.fold((0, 0.0_f64), |(count, worst), error| (count + 1, worst.max(error)));
    // Measured: 0.009 m.
    assert!(count == 33 && worst <= 0.012, "{count} steps, {worst} m");
}

/// Two drives of one car, whose clouds have no times and whose points do not stand in the order of measuring.
#[test]
fn raw_clouds_of_a_car_are_recognised() {
    for name in ["kitti_0001", "kitti_0005"] {
        let Some(recording) = real(&format!("lidar3d/{name}.bag")) else { return };
        let output = portolan_with_code(0, &["info", &recording]).stdout;
        assert!(
            output.contains("sweeps end at their stamps, go clockwise from azimuth -180°"),
            "{name}: {output}"
        );
    }
}

/// A simulated recording that is part of the data folder.
#[test]
fn a_spinning_lidar_is_mapped_in_3d() {
    if is_fast() {
        return;
    }
    let Some(recording) = real("lidar3d/corridor_imu.bag") else { return };
    let Some(truth) = real("lidar3d/corridor_imu.truth.tum") else { return };
    let folder = tempfile::tempdir().unwrap();
    let run = |more: &[&str]| {
        map(&recording, folder.path(), more);
        let errors = trajectory_errors(&text(&folder.path().join("trajectory.tum")), &truth);
        errors["absolute"]["translation"]["rmse"].as_f64().unwrap()
    };
    // Cartographer: 0.102 m with the IMU; it cannot do without. The lidar, which is followed without the IMU,
    // is 0.25 m from what the truth follows. Measured: 0.0035 m and 0.030 m.
    let (with_imu, without) = (run(&[]), run(&["--no-imu"]));
    assert!(with_imu <= 0.0046 && without <= 0.039, "{with_imu} m, without IMU {without} m");
}

#[test]
fn maps_in_3d_and_their_pictures_do_not_depend_on_threads() {
    if is_fast() {
        return;
    }
    let Some(recording) = real("lidar3d/corridor_imu.bag") else { return };
    let folder = tempfile::tempdir().unwrap();
    let files = [
        "map.pbstream",
        "trajectory.tum",
        "map_xray_top.png",
        "map_xray_front.png",
        "map_xray_side.png",
        "map_section.png",
    ];
    let start = |threads| {
        let output = text(folder.path());
        let cut = ["--duration", "12", "--threads", threads];
        portolan_with_code(0, &[&["map", &recording, "-o", &output, "-q"], &cut[..]].concat());
        files.map(|name| std::fs::read(folder.path().join(name)).unwrap())
    };
    let one = start("1");
    assert!(one == start("2") && one == start("4"), "the map depends on the number of threads");
}

/// The recording is simulated: no real one of the folder has an IMU in a container that is read here.
#[test]
fn an_imu_with_the_opposite_sign_is_left_out() {
    let Some(recording) = real("lidar3d/corridor_imu.bag") else { return };
    let truth = read(&real("lidar3d/corridor_imu.truth.tum").unwrap());
    let folder = tempfile::tempdir().unwrap();
    let mirrored = folder.path().join("mirrored.bag");
    rewritten(&recording, &mirrored, |_, mut message| {
        if let Message::Imu(imu) = &mut message.message {
            imu.angular_velocity.iter_mut().for_each(|rate| *rate = -*rate);
        }
        vec![message]
    });
    let out = text(&folder.path().join("out"));
    // The truth is of that frame; without an IMU that of the lidar would be tracked.
    let frame = ["--tracking-frame", "imu_link"];
    let run =
        portolan_with_code(0, &[&["map", &text(&mirrored), "-o", &out, "--no-xray"][..], &frame].concat());
    assert!(run.stderr.contains("rotates opposite to the lidar"), "{}", run.stderr);
    let estimate = read(&text(&Path::new(&out).join("trajectory.tum")));
    let errors = absolute_errors(&truth, &estimate, Association::default(), Alignment::Se3).unwrap();
    let error = errors.translation.rmse;
    assert!(error <= 1.3 * 0.009, "{error} m");
    let check = portolan_with_code(1, &["check", &text(&mirrored)]);
    assert!(check.stdout.contains("rotates opposite to the lidar"), "{}", check.stdout);
}
