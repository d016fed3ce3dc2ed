//! Files that once kept the program busy for ever or took all memory: each with the verbs that showed it, under limits
//! of three times what was measured, on a machine as fast as that was. And Ctrl-C while a large recording is mapped.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use crate::common;

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use common::{PORTOLAN, real, simulated, text};
use portolan_geometry::Time;
use portolan_recording::{Message, RecordedMessage, create, open};
use portolan_testing::is_fast;

/// What a run took.
struct Taken {
    code: Option<i32>,
    processor_seconds: f64,
    megabytes: f64,
}

/// Ticks of the clock that processor times are counted in, for each second.
const TICKS: f64 = 100.0;
/// What is measured may be exceeded by this factor.
const FACTOR: f64 = 3.0;

fn spawn(arguments: &[&str]) -> Child {
    // A guard against what the limits are there to show: no run needs ten times as much.
    let limits = "ulimit -v 4194304; ulimit -t 60; ulimit -c 0; exec \"$@\"";
    let mut command = Command::new("sh");
    command.args(["-c", limits, "sh", env!("CARGO_BIN_EXE_portolan")]).args(arguments);
    command.args(["--threads", "2"]);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// What checking text took where the limits were measured, processor seconds.
const CHECKING: f64 = 0.1;

/// By which factor this machine is slower at the moment than the one where limits were measured: machines share processors and
/// memory with others.
fn slowness() -> f64 {
    static SLOWNESS: OnceLock<f64> = OnceLock::new();
    *SLOWNESS.get_or_init(|| {
        let text = "€".repeat(30_000_000).into_bytes();
        let processor_seconds = || stat("thread-self").unwrap().0;
        let start = processor_seconds();
        // The standard library's own code: as fast whatever the tests are compiled for.
        std::hint::black_box(std::str::from_utf8(&text).is_ok());
        let slowness = ((processor_seconds() - start) / CHECKING).max(1.0);
        eprintln!("slower by {slowness:.2}");
        slowness
    })
}

/// Processor time so far, seconds, and whether it has ended but for being waited for.
fn state(child: &Child) -> Option<(f64, bool)> {
    stat(&child.id().to_string())
}

fn stat(process: &str) -> Option<(f64, bool)> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let fields: Vec<&str> = stat.rsplit_once(") ")?.1.split_whitespace().collect();
    let ticks = |i: usize| fields.get(i)?.parse::<f64>().ok();
    Some(((ticks(11)? + ticks(12)?) / TICKS, fields.first() == Some(&"Z")))
}

/// Largest memory so far.
fn peak_megabytes(child: &Child) -> Option<f64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().trim_end_matches(" kB").parse::<f64>().ok()? / 1024.0)
}

fn run(arguments: &[&str]) -> Taken {
    let mut child = spawn(arguments);
    let mut taken = Taken { code: None, processor_seconds: 0.0, megabytes: 0.0 };
    while let Some((seconds, has_ended)) = state(&child) {
        taken.processor_seconds = seconds;
        taken.megabytes = peak_megabytes(&child).unwrap_or(0.0).max(taken.megabytes);
        if has_ended {
            break;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    taken.code = child.wait().unwrap().code();
    taken
}

/// Runs a verb, which must end with this code within the limits that follow from what was measured.
fn within(arguments: &[&str], code: i32, processor_seconds: f64, megabytes: f64) {
    let taken = run(arguments);
    let figures = format!("{arguments:?}: {:.2} s, {:.0} MB", taken.processor_seconds, taken.megabytes);
    eprintln!("{figures}");
    assert_eq!(taken.code, Some(code), "{figures}");
    assert!(taken.processor_seconds <= FACTOR * slowness() * processor_seconds, "{figures}");
    assert!(taken.megabytes <= FACTOR * megabytes, "{figures}");
}

/// A verb on a file of the real data; left out where that is not there. `OUT` is a folder for results.
fn on_real(file: &str, verb: &[&str], code: i32, processor_seconds: f64, megabytes: f64) {
    let Some(path) = real(&format!("hostile/{file}")) else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = text(&folder.path().join("out"));
    let word = |word: &&str| match *word {
        "FILE" => path.clone(),
        "OUT" => out.clone(),
        word => word.to_owned(),
    };
    let arguments: Vec<String> = verb.iter().map(word).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    within(&arguments, code, processor_seconds, megabytes);
}

#[test]
fn a_clock_set_while_recording_takes_no_time() {
    on_real("D1_ntp.bag", &["check", "FILE"], 0, 0.05, 13.0);
    on_real("D1_ntp.bag", &["map", "FILE", "-o", "OUT"], 0, 0.9, 72.0);
}

#[test]
fn a_database_with_endless_rows_is_read_once() {
    for file in ["D2_min.db3", "D2b_hang.db3"] {
        on_real(file, &["info", "FILE"], 3, 0.06, 14.0);
        on_real(file, &["check", "FILE"], 1, 0.2, 14.0);
        on_real(file, &["map", "FILE", "-o", "OUT"], 3, 1.3, 40.0);
    }
}

#[test]
fn countless_attributes_are_refused() {
    on_real("D9_attr.e57", &["evaluate", "cloud", "FILE"], 1, 0.05, 13.0);
    on_real("D9_attr.e57", &["register", "FILE", "FILE"], 1, 0.05, 13.0);
}

#[test]
fn a_chunk_with_a_false_size_takes_memory_for_its_content_only() {
    on_real("D10_chunk.bag", &["info", "FILE"], 3, 0.1, 81.0);
    on_real("D10_chunk.bag", &["check", "FILE"], 1, 0.1, 81.0);
}

/// When something was measured or recorded, before a clock was set: so many ticks since 1970 instead of since the start.
fn before_setting(message: &mut RecordedMessage, start: Time) {
    let early = |time: &mut Time| *time = Time::from_ros(1, 0) + (*time - start);
    early(&mut message.log_time);
    match &mut message.message {
        Message::LaserScan(scan) => early(&mut scan.header.stamp),
        Message::Imu(sample) => early(&mut sample.header.stamp),
        Message::Odometry(odometry) => early(&mut odometry.header.stamp),
        Message::Tf(transforms) => {
            transforms.transforms.iter_mut().for_each(|transform| early(&mut transform.header.stamp));
        }
        _ => {}
    }
}

#[test]
fn a_clock_set_from_1970_to_now_takes_no_time() {
    let folder = tempfile::tempdir().unwrap();
    let whole = open(simulated(folder.path(), "walk.bag", &[])).unwrap();
    let path = folder.path().join("set.bag");
    let mut writer = create(&path, None).unwrap();
    let (mut reader, mut start, mut count) = (whole.read(&|_| true).unwrap(), None, 0);
    while let Some(mut message) = reader.next_message().unwrap() {
        let start = *start.get_or_insert(message.log_time);
        if message.log_time.seconds_since(start) < 3.0 {
            before_setting(&mut message, start);
            count += 1;
        }
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    assert!(count > 100, "{count}");
    let path = text(&path);
    within(&["check", &path], 0, 0.03, 26.0);
    within(&["info", &path], 0, 0.03, 22.0);
    within(&["map", &path, "-o", &text(&folder.path().join("map"))], 0, 0.15, 32.0);
}

#[test]
fn files_without_end_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&folder.path().join(name));
    std::fs::File::create(at("sparse")).unwrap().set_len(6 << 30).unwrap();
    for input in ["/dev/zero", &at("sparse")] {
        within(&["convert", input, "-o", &at("out.tum")], 1, 0.03, 13.0);
        within(&["optimize", input, "-o", &at("out.g2o")], 1, 0.03, 26.0);
    }
}

#[test]
fn points_at_one_place_are_judged_in_bounded_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("same.xyz");
    std::fs::write(&path, "1.0 2.0 3.0\n".repeat(20_000)).unwrap();
    let path = text(&path);
    within(&["evaluate", "cloud", &path], 0, 0.03, 16.0);
    within(&["register", &path, &path], 1, 0.03, 15.0);
}

/// The largest time that may pass between Ctrl-C and the end, seconds of the processor (those of the clock say how busy
/// the machine is). Measured: up to 0.3, half of it to write the map.
const PROMPT: f64 = 0.8;

/// Whether a program has a handler of SIGINT by now: until then, it has done nothing, and the signal just ends it.
fn handles_interruptions(child: &Child) -> bool {
    const SIGINT: u64 = 1 << 1;
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & SIGINT != 0)
}

/// Sends SIGINT when `is_time`, and gives the processor time until the end; none if it ended before.
fn interrupted(arguments: &[&str], is_time: impl Fn(Duration) -> bool) -> Option<f64> {
    let mut child = spawn(arguments);
    let start = Instant::now();
    let mut interrupted_at: Option<f64> = None;
    let mut last = 0.0;
    while let Some((seconds, has_ended)) = state(&child) {
        last = seconds;
        if has_ended {
            break;
        }
        if interrupted_at.is_none() && is_time(start.elapsed()) && handles_interruptions(&child) {
            Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
            interrupted_at = Some(seconds);
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let code = child.wait().unwrap().code();
    interrupted_at.map(|interrupted_at| {
        assert!(matches!(code, Some(0 | 130)), "{code:?}");
        last - interrupted_at
    })
}

/// Interrupts a mapping after shares of the time that it takes, and as soon as each of its files appears.
fn interrupt_everywhere(recording: &Path, more: &[&str], files: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let recording = text(recording);
    let output = |name: &str| text(&folder.path().join(name));
    let started = Instant::now();
    assert!(run(&[&["map", &recording, "-o", &output("whole"), "-q"], more].concat()).code.is_some());
    let takes = started.elapsed();
    let check = |name: &str, is_time: &dyn Fn(Duration) -> bool| {
        let out = output(name);
        let arguments = [&["map", &recording, "-o", &out, "-q"], more].concat();
        let until_end = interrupted(&arguments, is_time).unwrap_or(0.0);
        eprintln!("interrupted at {name}: {until_end:.2} s");
        assert!(until_end < PROMPT, "interrupted at {name}: {until_end} s");
        let left = std::fs::read_dir(&out).into_iter().flatten().flatten();
        let temporary = left.filter(|file| file.file_name().to_string_lossy().ends_with(".tmp")).count();
        assert_eq!(temporary, 0, "interrupted at {name}");
    };
    for share in [0.02, 0.3, 0.6, 0.9] {
        check(&format!("{share}"), &|elapsed| elapsed > takes.mul_f64(share));
    }
    for file in files {
        let place = folder.path().join(file).join(file);
        check(file, &|_| place.exists());
    }
}

#[test]
fn mapping_heeds_an_interruption_in_every_phase() {
    if is_fast() {
        return;
    }
    let long = ["corridors", "--seconds", "300", "--seed", "5", "--beams", "180"];
    let files = ["trajectory.tum", "map.pbstream", "map.png", "map.pgm"];
    interrupt_everywhere(&PORTOLAN.simulated("bag", &long), &[], &files);
    let space = ["garage", "--seconds", "12", "--seed", "5", "--beams", "300"];
    let files = ["map.pbstream", "map.png", "map_xray_top.png", "report.json"];
    interrupt_everywhere(&PORTOLAN.simulated("bag", &space), &["--cloud", "cloud.laz"], &files);
}
