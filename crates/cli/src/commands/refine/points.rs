//! The raw points of a recording.

use std::path::PathBuf;

use portolan_ingest::{BeamElevation, IngestError, IngestOptions, Ingestion, SensorPlan, read_urdf};
use portolan_issue::Issue;
use portolan_recording::Recording;
use portolan_refinement::{MotionSensors, PointStore};
use portolan_sensor::Measurement;

use crate::GlobalArgs;
use crate::commands::argument::{beam_elevation, shifts, time_offset};
use crate::commands::map::{PointTimesArg, StampsArg};
use crate::error::CliError;
use crate::progress::{Progress, say};

/// Where the points come from; found without being told.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Points (found without being told)")]
pub struct PointArgs {
    /// Topic of points; may be given several times, for several sensors.
    #[arg(long, value_name = "TOPIC")]
    pub points: Vec<String>,
    /// The frame whose poses the trajectory holds.
    #[arg(long, value_name = "FRAME")]
    pub tracking_frame: Option<String>,
    /// Robot description whose fixed joints say where the sensors are.
    #[arg(long, value_name = "FILE")]
    pub urdf: Option<PathBuf>,
    /// Where the times of the points of clouds come from, as in `map`.
    #[arg(long, alias = "azimuth-times", value_name = "HOW", default_value = "auto")]
    pub point_times: PointTimesArg,
    /// Raise all beams of the lidar, as in `map`: "auto", "off", or degrees.
    #[arg(long, value_name = "HOW", default_value = "auto", value_parser = beam_elevation, allow_hyphen_values = true)]
    pub beam_elevation: BeamElevation,
    /// Move the stamps of a topic, and the times of its points, by seconds, as in `map`: `/points_rear=-0.05`. May be
    /// given several times.
    #[arg(long, value_name = "TOPIC=SECONDS", value_parser = time_offset)]
    pub clock_offset: Vec<(String, f64)>,
    /// How stamps are taken, as in `map`.
    #[arg(long, value_name = "HOW", default_value = "auto")]
    pub stamps: StampsArg,
    /// Points nearer to their sensor than this are left out, metres: whoever carries it.
    #[arg(long, value_name = "METRES", default_value_t = 0.3)]
    pub min_range: f32,
}

/// The points of a recording and how they were read.
pub struct ReadPoints {
    /// In order of time.
    pub store: PointStore,
    /// What other sensors measured, as far as it was asked for.
    pub sensors: MotionSensors,
    /// Which topics were used.
    pub plan: SensorPlan,
    /// What was repaired.
    pub issues: Vec<Issue>,
}

impl ReadPoints {
    /// Whether data were lost while reading.
    pub fn lost_data(&self) -> bool {
        self.issues.iter().any(Issue::lost_data)
    }
}

/// Sensors besides the lidars that know of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum OtherSensor {
    /// Angular velocities, and which way is down.
    Imu,
    /// The way by the wheels.
    Odometry,
    /// Places by satellite.
    Fixes,
}

/// Reads all points of the range sensors.
pub fn read_points(
    recording: &dyn Recording,
    args: &PointArgs,
    global: &GlobalArgs,
) -> Result<ReadPoints, CliError> {
    read_points_and(recording, args, &[], global)
}

/// Reads all points of the range sensors, and what these others measured.
pub fn read_points_and(
    recording: &dyn Recording,
    args: &PointArgs,
    others: &[OtherSensor],
    global: &GlobalArgs,
) -> Result<ReadPoints, CliError> {
    let options = IngestOptions {
        use_nav_sat: others.contains(&OtherSensor::Fixes).then_some(true),
        range_topics: args.points.clone(),
        tracking_frame: args.tracking_frame.clone(),
        azimuth_times: args.point_times.into(),
        beam_elevation: args.beam_elevation,
        time_offsets: shifts(&args.clock_offset),
        stamps: args.stamps.into(),
        description: args.urdf.as_deref().map(read_urdf).transpose()?,
        ..IngestOptions::default()
    };
    let failed = |error: IngestError| CliError::Failed(error.to_string());
    let mut ingestion = Ingestion::new(recording, &options).map_err(failed)?;
    let plan = ingestion.plan().clone();
    if !global.quiet {
        say(&format!("the trajectory is taken as that of frame \"{}\"", plan.tracking_frame));
    }
    let mut store = PointStore::new(args.min_range);
    let mut sensors = MotionSensors::default();
    let mut progress = Progress::start("reading", recording.size_bytes(), global.quiet);
    while let Some((sensor, measurement)) = ingestion.next_measurement()? {
        match measurement {
            Measurement::Range(sweep) => store.push_from(&sensor.id, &sweep),
            Measurement::Imu(sample) if others.contains(&OtherSensor::Imu) => sensors.push_imu(&sample),
            Measurement::Odometry(sample) if others.contains(&OtherSensor::Odometry) => {
                sensors.push_odometry(&sample);
            }
            Measurement::FixedFramePose(sample) if others.contains(&OtherSensor::Fixes) => {
                sensors.push_fix(&sample);
            }
            _ => {}
        }
        if progress.is_due() {
            let (position, total) = ingestion.progress();
            progress.update(
                position,
                total,
                format!("{:.1} million points", store.points().len() as f64 / 1e6),
            );
        }
    }
    progress.finish();
    store.sort();
    Ok(ReadPoints { store, sensors, plan, issues: ingestion.issues() })
}
