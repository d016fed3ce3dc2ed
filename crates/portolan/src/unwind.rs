//! The map as a cloud: all raw points of a recording, placed by the finished trajectory.
//!
//! The recording is read a second time. Each point is put where the tracking frame was at the time of that
//! point, so that motion during a sweep is unwound with the final trajectory, not with the one that was
//! predicted. Points come sweep by sweep; nothing of the recording is kept.
//!
//! Pictures need less: scans that mapping kept on disk ([`KeptScans`]) are placed without the recording.

mod kept;
mod motion;
#[cfg(test)]
mod tests;

use portolan_geometry::{Dimension, Duration, Rigid3, Time};
use portolan_ingest::{IngestError, IngestOptions, Ingestion};
use portolan_pointcloud::CloudError;
use portolan_recording::Recording;
use portolan_sensor::{Measurement, TimedPointCloudData};

use crate::pipeline::{PipelineError, Preparation};
pub use kept::KeptScans;
pub use motion::SmoothMotion;
use motion::{LONGEST_SWEEP, SweepMotion, place};

/// A point in the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    /// Metres in the map.
    pub position: [f64; 3],
    /// As the sensor gave it; 0 without.
    pub intensity: f32,
    /// Seconds since 1970.
    pub time: f64,
}

/// What became of the points of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Unwound {
    /// Placed in the map.
    pub points: u64,
    /// Before the first or after the last pose of the trajectory, or in a gap of it.
    pub outside_trajectory: u64,
    /// Nearer or farther than mapping takes points.
    pub outside_range: u64,
    /// Whether it was stopped before the end.
    pub interrupted: bool,
}

/// Which points to take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnwindOptions {
    /// Nearer to their sensor they are left out, metres.
    pub min_range: f32,
    /// Farther from their sensor they are left out, metres.
    pub max_range: f32,
}

impl UnwindOptions {
    /// The range that mapping takes.
    pub fn as_mapped(preparation: &Preparation) -> Self {
        let builder = &preparation.options.trajectory_builder;
        let (min_range, max_range) = match preparation.dimension {
            Dimension::Two => {
                (builder.trajectory_builder_2d.min_range, builder.trajectory_builder_2d.max_range)
            }
            Dimension::Three => {
                (builder.trajectory_builder_3d.min_range, builder.trajectory_builder_3d.max_range)
            }
        };
        Self { min_range, max_range }
    }
}

/// Places all points of a recording by the poses of its trajectory (`map_from_tracking`). `visit` gets the
/// points of each sweep in order of the recording; `observe` the bytes read and all of them, and stops
/// everything by returning false.
///
/// # Errors
/// Fails if the recording cannot be read, or as `visit` does.
pub fn unwind(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
    poses: Vec<(Time, Rigid3)>,
    options: UnwindOptions,
    observe: &mut dyn FnMut(u64, u64) -> bool,
    visit: &mut dyn FnMut(&[MapPoint]) -> Result<(), CloudError>,
) -> Result<Unwound, PipelineError> {
    let motion = SmoothMotion::new(poses);
    let mut unwinder = Unwinder::new(&motion, options);
    let mut ingestion = range_sensors(recording, ingest, preparation)?;
    while let Some((_, measurement)) = ingestion.next_measurement()? {
        let Measurement::Range(sweep) = measurement else { continue };
        visit(unwinder.place(&sweep))?;
        let (position, total) = ingestion.progress();
        if !observe(position, total) {
            unwinder.unwound.interrupted = true;
            break;
        }
    }
    Ok(unwinder.unwound)
}

/// Reads what mapping read, but of the range sensors only.
fn range_sensors(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
) -> Result<Ingestion, IngestError> {
    let mut plan = preparation.plan.clone();
    (plan.imu, plan.odometry) = (None, None);
    (plan.nav_sat, plan.fixed_frame_pose, plan.landmarks) = (None, None, None);
    let ingest =
        IngestOptions { with_intensities: true, num_subdivisions_per_laser_scan: 1, ..ingest.clone() };
    Ingestion::with_plan(recording, preparation.inventory(), plan, &ingest)
}

/// Places sweeps.
struct Unwinder<'a> {
    motion: &'a SmoothMotion,
    options: UnwindOptions,
    sweep_motion: SweepMotion,
    points: Vec<MapPoint>,
    unwound: Unwound,
}

impl<'a> Unwinder<'a> {
    fn new(motion: &'a SmoothMotion, options: UnwindOptions) -> Self {
        let (points, sweep_motion) = (Vec::new(), SweepMotion::default());
        Self { motion, options, sweep_motion, points, unwound: Unwound::default() }
    }

    /// The points of a sweep in the map.
    fn place(&mut self, sweep: &TimedPointCloudData) -> &[MapPoint] {
        self.points.clear();
        let first = f64::from(sweep.points_in_tracking.iter().map(|p| p.time).fold(0.0, f32::min));
        let start = sweep.time + Duration::from_seconds(first);
        let is_short = -first < LONGEST_SWEEP && self.motion.covers(start..=sweep.time);
        if is_short && self.sweep_motion.fill(self.motion, start, sweep.time) {
            let motion = &self.sweep_motion;
            let position = |time: f64, point| Some(motion.to_map(time - first, point));
            place_all(sweep, self.options, position, &mut self.points, &mut self.unwound);
        } else {
            let motion = self.motion;
            let position = |time: f64, point| {
                Some(place(&motion.pose(sweep.time + Duration::from_seconds(time))?, point))
            };
            place_all(sweep, self.options, position, &mut self.points, &mut self.unwound);
        }
        self.unwound.points += self.points.len() as u64;
        &self.points
    }
}

fn place_all(
    sweep: &TimedPointCloudData,
    options: UnwindOptions,
    position: impl Fn(f64, [f32; 3]) -> Option<[f64; 3]>,
    points: &mut Vec<MapPoint>,
    unwound: &mut Unwound,
) {
    let end = sweep.time.unix_seconds();
    let (least, most) = (options.min_range.powi(2), options.max_range.powi(2));
    for (i, point) in sweep.points_in_tracking.iter().enumerate() {
        let range = (point.position - sweep.origin_in_tracking).norm_squared();
        if !(least..=most).contains(&range) {
            unwound.outside_range += 1;
            continue;
        }
        let time = f64::from(point.time);
        let Some(position) = position(time, point.position.coords.into()) else {
            unwound.outside_trajectory += 1;
            continue;
        };
        let intensity = sweep.intensities.get(i).copied().unwrap_or(0.0);
        points.push(MapPoint { position, intensity, time: end + time });
    }
}
