//! Reads the raw points of a recording.

use portolan::job::refine::{MotionSensor, PointReading, ReadPoints};
use portolan_ingest::IngestOptions;
use portolan_recording::Recording;

use crate::GlobalArgs;
use crate::commands::argument::{not_negative, shifts, time_offset};
use crate::commands::handling::HandlingArgs;
use crate::error::CliError;
use crate::progress::{Progress, print_line};

/// Source of the points; detected automatically.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Points (detected automatically)")]
pub struct PointArgs {
    /// Topic of points; may be given several times, for several sensors.
    #[arg(long, value_name = "TOPIC")]
    pub points: Vec<String>,
    /// Frame whose poses the trajectory has.
    #[arg(long, value_name = "FRAME")]
    pub tracking_frame: Option<String>,
    #[command(flatten)]
    pub handling: HandlingArgs,
    /// Add seconds to the stamps of a topic and to the times of its points, as in `map`:
    /// `/points_rear=-0.05`. May be given several times.
    #[arg(long, value_name = "TOPIC=SECONDS", value_parser = time_offset)]
    pub clock_offset: Vec<(String, f64)>,
    /// Leave out points nearer to their sensor than this, metres: they are on the platform itself.
    #[arg(long, value_name = "METRES", default_value_t = 0.3, value_parser = not_negative)]
    pub min_range: f64,
}

/// Sensors besides the lidars that measure motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum OtherSensor {
    /// Angular velocity, and the direction of gravity.
    Imu,
    /// Wheel odometry.
    Odometry,
    /// Satellite fixes.
    Fixes,
}

impl From<OtherSensor> for MotionSensor {
    fn from(sensor: OtherSensor) -> Self {
        match sensor {
            OtherSensor::Imu => Self::Imu,
            OtherSensor::Odometry => Self::Odometry,
            OtherSensor::Fixes => Self::Fixes,
        }
    }
}

/// Reads all points of the range sensors.
pub fn read_points(
    recording: &dyn Recording,
    args: &PointArgs,
    global: &GlobalArgs,
) -> Result<ReadPoints, CliError> {
    read_points_and(recording, args, &[], global)
}

/// Reads all points of the range sensors, and the measurements of the other sensors.
pub fn read_points_and(
    recording: &dyn Recording,
    args: &PointArgs,
    others: &[OtherSensor],
    global: &GlobalArgs,
) -> Result<ReadPoints, CliError> {
    let mut options = IngestOptions {
        use_nav_sat: others.contains(&OtherSensor::Fixes).then_some(true),
        range_topics: args.points.clone(),
        tracking_frame: args.tracking_frame.clone(),
        time_offsets: shifts(&args.clock_offset),
        ..IngestOptions::default()
    };
    args.handling.configure(&mut options)?;
    let mut progress = None;
    let mut observe = |state: PointReading<'_>| match state {
        PointReading::Planned(plan) => {
            if !global.quiet {
                print_line(&format!("the trajectory is taken as that of frame \"{}\"", plan.tracking_frame));
            }
            progress = Some(Progress::start("reading", recording.size_bytes(), global.quiet));
        }
        PointReading::Progress { position, total, points } => {
            if let Some(progress) = &mut progress
                && progress.is_due()
            {
                progress.update(position, total, format!("{:.1} million points", points as f64 / 1e6));
            }
        }
    };
    let sensors: Vec<MotionSensor> = others.iter().map(|sensor| (*sensor).into()).collect();
    let read = portolan::job::refine::read_points(
        recording,
        &options,
        args.min_range as f32,
        &sensors,
        &mut observe,
    )?;
    if let Some(progress) = progress {
        progress.finish();
    }
    Ok(read)
}
