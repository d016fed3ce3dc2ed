//! A recording as the front end sees it: sweeps, what an IMU measured, and the truth.

use std::error::Error;
use std::path::Path;

use portolan::evaluation::{Alignment, Association, TimedPose, Trajectory, absolute_errors};
use portolan::geometry::{Rigid3, Vector3};
use portolan::ingest::{IngestOptions, Ingestion};
use portolan::lidar_odometry::{LidarOdometry, OdometrySettings, Sweep};
use portolan::mapping::{Mapper, MapperSettings, MatchingResult, Space3d};
use portolan::numeric::rms;
use portolan::pipeline::prepare;
use portolan::recording::open;
use portolan::sensor::{ImuData, Measurement};
use portolan::trajectory_file::TrajectoryFile;

/// Starts are tried from every so many sweeps, and judged after so many.
const START_EVERY: usize = 8;
const JUDGED_AFTER: usize = 10;
/// Sweeps that are handed on behind those judged: some judge a start, or wait for it.
const BEHIND: usize = 12;

/// A recording in memory.
pub struct Drive {
    pub name: String,
    /// As `map` would choose them.
    pub settings: OdometrySettings,
    sweeps: Vec<Sweep>,
    imu: Vec<ImuData>,
    truth: Trajectory,
    /// The point that the truth is of, in the tracking frame.
    lever: Vector3,
}

impl Drive {
    /// `RECORDING:TRUTH[:X,Y,Z]`
    pub fn read(argument: &str) -> Result<Self, Box<dyn Error>> {
        let mut parts = argument.split(':');
        let (file, truth) = (parts.next().unwrap_or_default(), parts.next().ok_or("a truth is missing")?);
        let lever = match parts.next() {
            Some(text) => text.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?,
            None => vec![0.0; 3],
        };
        let truth =
            TrajectoryFile { path: Path::new(truth), trajectory_id: None, times: None }.read()?.trajectory;
        let recording = open(file)?;
        let (mut ingest, settings) = (IngestOptions::default(), OdometrySettings::default());
        ingest.use_odometry = Some(false);
        let mut preparation = prepare(recording.as_ref(), &ingest, None)?;
        preparation.options.map_builder.pose_graph.optimize_every_n_nodes = 0;
        let mut ingestion = Ingestion::with_plan(
            recording.as_ref(),
            preparation.inventory(),
            preparation.plan.clone(),
            &ingest,
        )?;
        let settings_of_mapper = MapperSettings { threads: 1, ..MapperSettings::default() };
        let mut mapper = Mapper::<Space3d>::new(&preparation.options, settings_of_mapper)?;
        let id = mapper.add_trajectory(&ingestion.sensors().into_iter().collect(), None)?;
        let (mut sweeps, mut imu) = (Vec::new(), Vec::new());
        let sweep = |scan: MatchingResult<Space3d>| Sweep { end: scan.time, points: scan.measured };
        while let Some((sensor, measurement)) = ingestion.next_measurement()? {
            if let Measurement::Imu(data) = &measurement {
                imu.push(*data);
            }
            sweeps.extend(mapper.add(id, &sensor, measurement)?.into_iter().map(sweep));
        }
        sweeps.extend(mapper.finish_trajectory(id)?.into_iter().map(sweep));
        let name = Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let lever = Vector3::from_column_slice(&lever);
        Ok(Self { name, settings, sweeps, imu, truth, lever })
    }

    /// ATE of the whole drive, metres.
    pub fn error(&self, settings: &OdometrySettings) -> Result<f64, Box<dyn Error>> {
        let (estimate, _) = Trajectory::new(self.tracked(settings, &self.sweeps));
        let errors = absolute_errors(&self.truth, &estimate, Association::default(), Alignment::Se3)?;
        Ok(errors.translation.rmse)
    }

    /// How far the place after ten sweeps is off, begun at many places of the drive, metres.
    pub fn error_of_starts(&self, settings: &OdometrySettings) -> f64 {
        let needed = JUDGED_AFTER + BEHIND;
        let starts = (0..self.sweeps.len().saturating_sub(needed)).step_by(START_EVERY);
        let errors: Vec<f64> = starts
            .filter_map(|start| {
                let poses = self.tracked(settings, self.sweeps.get(start..start + needed)?);
                let (first, last) = (poses.first()?, poses.get(JUDGED_AFTER)?);
                let true_motion = self.truth.lookup(first.time)?.inverse() * self.truth.lookup(last.time)?;
                let motion = first.map_from_tracking.inverse() * last.map_from_tracking;
                Some(motion.translation.vector.norm() - true_motion.translation.vector.norm())
            })
            .collect();
        rms(&errors).unwrap_or(f64::NAN)
    }

    /// The place that the truth is of at the ends of sweeps.
    fn tracked(&self, settings: &OdometrySettings, sweeps: &[Sweep]) -> Vec<TimedPose> {
        let mut odometry = LidarOdometry::new(settings.clone());
        let begin = sweeps.first().map(Sweep::begin);
        let mut imu = self.imu.iter().skip_while(|sample| Some(sample.time) < begin).peekable();
        let (mut poses, lever) = (Vec::new(), Rigid3::from_parts(self.lever.into(), Default::default()));
        let mut take = |odometry: &mut LidarOdometry| {
            while let Some(sweep) = odometry.advance(None) {
                let map_from_tracking = sweep.local_from_tracking * lever;
                poses.push(TimedPose { time: sweep.sweep.end, map_from_tracking });
            }
        };
        for sweep in sweeps {
            // One sample behind the sweep, so that its motion is known.
            let mut is_known = false;
            while !is_known && let Some(sample) = imu.next() {
                is_known = sample.time > sweep.end;
                odometry.add_imu(sample);
            }
            // What cannot be registered is left out.
            let _ = odometry.push(sweep.clone());
            take(&mut odometry);
        }
        odometry.end();
        take(&mut odometry);
        poses
    }
}
