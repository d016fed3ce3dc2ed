//! Reads the raw points of a recording.

use portolan_ingest::{IngestOptions, Ingestion, SensorPlan};
use portolan_issue::Issue;
use portolan_recording::Recording;
use portolan_refinement::{MotionSensors, PointStore};
use portolan_sensor::Measurement;

use crate::job::JobError;

/// The points of a recording and how they were read.
pub struct ReadPoints {
    /// In order of time.
    pub store: PointStore,
    /// Measurements of other sensors, if requested.
    pub sensors: MotionSensors,
    /// Which topics were used.
    pub plan: SensorPlan,
    /// Repairs and losses.
    pub issues: Vec<Issue>,
}

impl ReadPoints {
    /// Whether data were lost while reading.
    pub fn lost_data(&self) -> bool {
        self.issues.iter().any(Issue::lost_data)
    }
}

/// Sensors besides the lidars that measure motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionSensor {
    /// Angular velocity and specific force.
    Imu,
    /// Wheel odometry.
    Odometry,
    /// Satellite fixes.
    Fixes,
}

/// Progress of reading.
#[derive(Clone, Copy, Debug)]
pub enum PointReading<'a> {
    /// The topics to be read are chosen.
    Planned(&'a SensorPlan),
    /// Measurements were read.
    Progress {
        /// Bytes or messages read so far.
        position: u64,
        /// Total number of bytes or messages.
        total: u64,
        /// Points read so far.
        points: usize,
    },
}

/// Reads all points of the range sensors that are not nearer than `min_range` metres, and the measurements of
/// these other sensors.
///
/// # Errors
/// A recording without range sensors, or one that cannot be read.
pub fn read_points(
    recording: &dyn Recording,
    options: &IngestOptions,
    min_range: f32,
    others: &[MotionSensor],
    observe: &mut dyn FnMut(PointReading<'_>),
) -> Result<ReadPoints, JobError> {
    let mut ingestion = Ingestion::new(recording, options)?;
    let plan = ingestion.plan().clone();
    observe(PointReading::Planned(&plan));
    let mut store = PointStore::new(min_range);
    let mut sensors = MotionSensors::default();
    while let Some((sensor, measurement)) = ingestion.next_measurement()? {
        match measurement {
            Measurement::Range(sweep) => store.push_from(&sensor.id, &sweep),
            Measurement::Imu(sample) if others.contains(&MotionSensor::Imu) => sensors.push_imu(&sample),
            Measurement::Odometry(sample) if others.contains(&MotionSensor::Odometry) => {
                sensors.push_odometry(&sample);
            }
            Measurement::FixedFramePose(sample) if others.contains(&MotionSensor::Fixes) => {
                sensors.push_fix(&sample);
            }
            _ => {}
        }
        let (position, total) = ingestion.progress();
        observe(PointReading::Progress { position, total, points: store.points().len() });
    }
    store.sort();
    Ok(ReadPoints { store, sensors, plan, issues: ingestion.issues() })
}
