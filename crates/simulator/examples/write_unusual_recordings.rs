//! Writes recordings of sensors that are mounted, set up or broken in unusual ways, with their truth.
//!
//! ```text
//! cargo run --release -p portolan-simulator --example write_unusual_recordings -- OUT-DIRECTORY [SECONDS [KIND ...]]
//! ```
//! Each is a walk through the museum. Without kinds all of them are written.

use std::error::Error;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use portolan_geometry::{Duration, Rigid3, Time, rotation_from_roll_pitch_yaw};
use portolan_recording::{Message, PointCloud2, Recording, RecordingWriter};
use portolan_simulator::{Scenario3dOptions, Simulation3d};
use portolan_worlds::three_d::Scene3d;

/// A kind: its name, what it changes in the scenario, and what in each message.
type Kind = (&'static str, fn(&mut Scenario3dOptions), fn(&mut Message, Context));

/// Where a message stands in its recording.
#[derive(Clone, Copy)]
struct Context {
    /// How many clouds came before.
    clouds: u64,
    /// When the recording begins.
    start: Time,
}

const KINDS: [Kind; 17] = [
    ("plain", |_| (), |_, _| ()),
    ("tilted", |o| mount(o, [0.2, 0.5, 0.3]), |_, _| ()),
    ("on-its-side", |o| mount(o, [0.0, std::f64::consts::FRAC_PI_2, 0.0]), |_, _| ()),
    ("upside-down", |o| mount(o, [std::f64::consts::PI, 0.0, 0.0]), |_, _| ()),
    ("large-biases", large_biases, |_, _| ()),
    ("imu-mounted-upside-down", |o| mount_imu(o, [std::f64::consts::PI, 0.0, 0.4]), |_, _| ()),
    ("imu-unknown-upside-down", |_| (), |m, _| turn_imu(m, |[x, y, z]| [x, -y, -z])),
    ("imu-unknown-quarter-turn", |_| (), |m, _| turn_imu(m, |[x, y, z]| [y, -x, z])),
    ("imu-unknown-axes", |_| (), |m, _| turn_imu(m, |[x, y, z]| [z, x, y])),
    ("hurried", |o| (o.speed, o.gait) = (2.2, 3.0), |_, _| ()),
    ("intensities-to-1", |_| (), |m, _| brighten(m, 1.0 / 255.0)),
    ("intensities-to-65535", |_| (), |m, _| brighten(m, 257.0)),
    ("no-points", |_| (), |m, c| repeat(m, if c.clouds % 5 == 2 { 0 } else { 1 })),
    ("two-million-points", |_| (), |m, c| repeat(m, if c.clouds % 100 == 50 { 500 } else { 1 })),
    ("lidar-clock-jumps", |_| (), |m, c| jump(m, c, 10.0, 5.0, false)),
    ("all-clocks-jump", |_| (), |m, c| jump(m, c, 10.0, 100.0, true)),
    ("all-clocks-jump-back", |_| (), |m, c| jump(m, c, 10.0, -3.0, true)),
];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(arguments.first().ok_or("which directory shall they be written to?")?);
    let seconds: f64 = arguments.get(1).map_or("30", String::as_str).parse()?;
    let wanted = arguments.get(2..).unwrap_or_default();
    std::fs::create_dir_all(folder)?;
    for (name, prepare, change) in KINDS {
        if wanted.is_empty() || wanted.iter().any(|w| w == name) {
            let mut options = Scenario3dOptions::new(Scene3d::Museum, 1, 1);
            options.duration = Some(seconds);
            for lidar in &mut options.lidars {
                lidar.beams.columns = 300;
            }
            prepare(&mut options);
            let count = write(&Simulation3d::new(options)?, &folder.join(name), change)?;
            writeln!(std::io::stdout(), "{name}: {count} messages")?;
        }
    }
    Ok(())
}

fn write(
    simulation: &Simulation3d,
    stem: &Path,
    change: fn(&mut Message, Context),
) -> Result<u64, Box<dyn Error>> {
    let mut writer: Box<dyn RecordingWriter> = portolan_recording::create(stem.with_extension("mcap"), None)?;
    let mut reader = simulation.read(&|_| true)?;
    let (mut count, mut clouds) = (0, 0);
    while let Some(mut message) = reader.next_message()? {
        change(&mut message.message, Context { clouds, start: simulation.start_time() });
        clouds += u64::from(matches!(message.message, Message::PointCloud2(_)));
        writer.write(&message)?;
        count += 1;
    }
    writer.finish()?;
    let mut truth = BufWriter::new(File::create(stem.with_extension("truth.tum"))?);
    simulation.write_truth_tum(&mut truth, 200.0)?;
    truth.flush()?;
    Ok(count)
}

fn turned(pose: &Rigid3, [roll, pitch, yaw]: [f64; 3]) -> Rigid3 {
    Rigid3::from_parts(pose.translation, rotation_from_roll_pitch_yaw(roll, pitch, yaw))
}

fn mount(options: &mut Scenario3dOptions, angles: [f64; 3]) {
    for lidar in &mut options.lidars {
        lidar.base_from_lidar = turned(&lidar.base_from_lidar, angles);
    }
}

fn mount_imu(options: &mut Scenario3dOptions, angles: [f64; 3]) {
    if let Some(imu) = &mut options.imu {
        imu.base_from_imu = turned(&imu.base_from_imu, angles);
    }
}

fn large_biases(options: &mut Scenario3dOptions) {
    if let Some(imu) = &mut options.imu {
        (imu.gyroscope_bias, imu.accelerometer_bias) = (0.05, 0.3);
    }
}

fn turn_imu(message: &mut Message, turn: fn([f64; 3]) -> [f64; 3]) {
    if let Message::Imu(imu) = message {
        imu.angular_velocity = turn(imu.angular_velocity);
        imu.linear_acceleration = turn(imu.linear_acceleration);
    }
}

fn brighten(message: &mut Message, factor: f32) {
    let Message::PointCloud2(cloud) = message else { return };
    let Some(offset) = cloud.fields.iter().find(|f| f.name == "intensity").map(|f| f.offset as usize) else {
        return;
    };
    for point in cloud.data.chunks_exact_mut(cloud.point_step as usize) {
        if let Some(bytes) = point.get_mut(offset..offset + 4)
            && let Ok(value) = <[u8; 4]>::try_from(&*bytes)
        {
            bytes.copy_from_slice(&(f32::from_le_bytes(value) * factor).to_le_bytes());
        }
    }
}

/// Every point so many times.
fn repeat(message: &mut Message, times: u32) {
    let Message::PointCloud2(cloud) = message else { return };
    let PointCloud2 { width, height, row_step, data, .. } = cloud;
    (*width, *height, *row_step) = (*width * *height * times, 1, *row_step * *height * times);
    *data = data.repeat(times as usize);
}

/// Stamps are off by so many seconds after a time.
fn jump(message: &mut Message, context: Context, after: f64, seconds: f64, all: bool) {
    let stamp = match message {
        Message::PointCloud2(cloud) => &mut cloud.header.stamp,
        Message::Imu(imu) if all => &mut imu.header.stamp,
        _ => return,
    };
    if stamp.seconds_since(context.start) > after {
        *stamp += Duration::from_seconds(seconds);
    }
}
