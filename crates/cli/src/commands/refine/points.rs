//! The raw points of a recording.

use std::path::PathBuf;

use portolan_recording::{IngestError, IngestOptions, Ingestion, Recording, Repair, SensorPlan, read_urdf};
use portolan_refinement::PointStore;
use portolan_sensor::Measurement;

use crate::GlobalArgs;
use crate::error::CliError;
use crate::interrupt;
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
    /// Points nearer to their sensor than this are left out, metres: whoever carries it.
    #[arg(long, value_name = "METRES", default_value_t = 0.3)]
    pub min_range: f32,
}

/// The points of a recording and how they were read.
pub struct ReadPoints {
    /// In order of time.
    pub store: PointStore,
    /// Which topics were used.
    pub plan: SensorPlan,
    /// What was repaired.
    pub repairs: Vec<Repair>,
}

/// Reads all points of the range sensors.
pub fn read_points(
    recording: &dyn Recording,
    args: &PointArgs,
    global: &GlobalArgs,
) -> Result<ReadPoints, CliError> {
    let options = IngestOptions {
        range_topics: args.points.clone(),
        tracking_frame: args.tracking_frame.clone(),
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
    let mut progress = Progress::start("reading", recording.size_bytes(), global.quiet);
    while let Some((_, measurement)) = ingestion.next_measurement()? {
        if let Measurement::Range(sweep) = measurement {
            store.push(&sweep);
        }
        if progress.is_due() {
            let (position, total) = ingestion.progress();
            progress.update(
                position,
                total,
                format!("{:.1} million points", store.points().len() as f64 / 1e6),
            );
        }
        if interrupt::interrupted() {
            return Err(CliError::Failed("stopped while reading: nothing was written".to_owned()));
        }
    }
    progress.finish();
    store.sort();
    Ok(ReadPoints { store, plan, repairs: ingestion.repairs() })
}
