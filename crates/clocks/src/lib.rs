#![doc = include_str!("../README.md")]

mod gyroscope;
mod lag;
mod mounting;
mod sweeps;
mod tracker;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use portolan_diagnose::{ClockOffset, ImuComparison, ImuMisalignment, ImuMounting};
use portolan_geometry::{Duration, Vector3};
use portolan_ingest::{IngestError, IngestOptions, Ingestion, Inventory, PlannedRange, SensorPlan, plan};
use portolan_recording::Recording;
use portolan_sensor::{ImuData, Measurement, SensorId, SensorKind, TimedPointCloudData};

use gyroscope::Gyroscope;
use sweeps::{Sweep, SweepGatherer};
use tracker::{SweepTracker, TrackedSweep};

/// Number of sweeps after which offsets are computed first; it is doubled each time that they are not
/// certain enough.
const SWEEPS: usize = 75;
/// Maximum number of sweeps that are used.
const MAX_SWEEPS: usize = 3000;
/// Standard deviation of an offset that is accurate enough, seconds.
const SURE: f64 = 0.002;
/// Difference between the offsets of lidars up to which they agree, seconds.
const SAME: f64 = 0.005;
/// Difference between the offsets of lidars up to which they agree, in standard deviations.
const DIFFERENT: f64 = 4.0;
/// Maximum number of sweeps that wait for later samples of the IMU.
const MAX_WAITING: usize = 20;
/// Vertical field of view below which clouds come from 2D scanners, radians.
const FLAT: f64 = 0.05;
/// Maximum number of sweeps used to determine whether a gyroscope is in degrees per second.
const SWEEPS_FOR_UNITS: usize = 2 * SWEEPS;
/// Root mean square of the angular velocity from which a gyroscope may be in degrees per second, rad/s.
const FAST: f64 = 0.5;

/// Compares the rotations of lidars in 3D with those of the IMU. Ends when the result is accurate enough.
/// What cannot be read gives no results: [`portolan_diagnose::check`] reports the reason. `progress`
/// receives the number of bytes read so far.
pub fn measure(
    recording: &dyn Recording,
    inventory: &Inventory,
    options: &IngestOptions,
    progress: &mut dyn FnMut(u64),
) -> ImuComparison {
    let mut measured = |pass| measure_scaled(recording, inventory, options, pass, progress);
    let as_planned = measured(Pass { scale: 1.0, most_sweeps: MAX_SWEEPS, is_exact: false });
    if as_planned.comparison.mounting.is_some() || as_planned.turns_alike && as_planned.rms_rate < FAST {
        return as_planned.comparison;
    }
    let exactly = |scale| Pass { scale, most_sweeps: SWEEPS_FOR_UNITS, is_exact: true };
    if as_planned.turns_alike && measured(exactly(1.0)).turns_alike {
        return as_planned.comparison;
    }
    // Sweeps that are de-skewed with rates in wrong units match nothing, so that they do not show the units.
    let in_degrees = measured(exactly(1f64.to_radians()));
    let imu = in_degrees.imu.filter(|_| in_degrees.turns_alike);
    let mounting = imu.map(|imu| ImuMounting { imu, turned: 0.0, factor: 1f64.to_degrees() });
    ImuComparison { mounting, ..as_planned.comparison }
}

/// Results with scaled rates of the gyroscope.
#[derive(Default)]
struct Measured {
    comparison: ImuComparison,
    /// Topic of the IMU.
    imu: Option<Arc<str>>,
    /// Whether it certainly rotates like all lidars.
    turns_alike: bool,
    /// Root mean square of its rates, rad/s.
    rms_rate: f64,
}

/// How sweeps and gyroscope are used.
#[derive(Clone, Copy)]
struct Pass {
    /// Factor for the rates of the gyroscope.
    scale: f64,
    most_sweeps: usize,
    /// Whether sweeps are registered to convergence.
    is_exact: bool,
}

fn measure_scaled(
    recording: &dyn Recording,
    inventory: &Inventory,
    options: &IngestOptions,
    Pass { scale, most_sweeps, is_exact }: Pass,
    progress: &mut dyn FnMut(u64),
) -> Measured {
    let Ok(Some((mut clocks, mut ingestion))) = Clocks::new(recording, inventory, options) else {
        return Measured::default();
    };
    if is_exact {
        clocks.lidars.values_mut().for_each(|lidar| lidar.tracker = SweepTracker::to_the_end());
    }
    // An error ends the reading; what was read before it is used.
    while let Ok(Some((id, measurement))) = ingestion.next_measurement() {
        clocks.add(&id, measurement, scale);
        if clocks.is_enough(most_sweeps) {
            break;
        }
        progress(ingestion.progress().0);
    }
    clocks.finish(ingestion.plan())
}

/// The offset of the clock of the IMU on which all lidars agree, if it is certain: shifting its stamps by it
/// corrects all clocks. None where lidars disagree: then one of them is wrong.
pub fn common_offset(offsets: &[ClockOffset]) -> Option<ClockOffset> {
    let best =
        offsets.iter().min_by(|a, b| a.sigma.total_cmp(&b.sigma)).filter(|best| best.is_significant())?;
    let agrees =
        |o: &ClockOffset| (o.seconds - best.seconds).abs() <= SAME.max(DIFFERENT * o.sigma.hypot(best.sigma));
    offsets.iter().all(agrees).then(|| best.clone())
}

/// Smallest misalignment that is corrected, radians: sensors are mounted with an error of a degree or two,
/// and objects that move beside the lidar pass like its rotation.
const LEAST_MISALIGNMENT: f64 = 0.035;
/// Number of standard deviations that a corrected misalignment has to exceed.
const SURE_SIGMAS: f64 = 6.0;
/// Difference between the misalignments from lidars up to which they agree, radians.
const SAME_MISALIGNMENT: f64 = 0.02;

/// The misalignment of the IMU on which all lidars agree, if it is certain; each with its standard
/// deviation.
fn common_misalignment(misalignments: &[(Vector3, f64)]) -> Option<(Vector3, f64)> {
    let (rotation, sigma) = *misalignments.iter().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let is_sure = rotation.norm() > LEAST_MISALIGNMENT.max(SURE_SIGMAS * sigma);
    let agrees = |other: &(Vector3, f64)| (other.0 - rotation).norm() < SAME_MISALIGNMENT;
    (is_sure && misalignments.iter().all(agrees)).then_some((rotation, sigma))
}

/// All sensors while the recording is read.
struct Clocks {
    gyroscope: Gyroscope,
    lidars: BTreeMap<SensorId, Lidar>,
    /// Number of sweeps of one lidar at which offsets are computed next.
    next: usize,
}

/// One lidar while the recording is read.
#[derive(Default)]
struct Lidar {
    gatherer: SweepGatherer,
    waiting: VecDeque<Sweep>,
    tracker: SweepTracker,
    tracked: Vec<TrackedSweep>,
    sweeps: usize,
}

impl Clocks {
    /// None if there is nothing to compare.
    fn new(
        recording: &dyn Recording,
        inventory: &Inventory,
        options: &IngestOptions,
    ) -> Result<Option<(Self, Ingestion)>, IngestError> {
        let mut plan = plan(inventory, options)?;
        let Some(imu) = &plan.imu else { return Ok(None) };
        let shift = imu.source.clock_shift;
        // A clock that was already corrected is known to be wrong.
        let is_usable = |range: &PlannedRange| {
            range.source.clock_shift == shift && range.statistics.vertical_field_of_view > FLAT
        };
        plan.range.retain(is_usable);
        if plan.range.is_empty() {
            return Ok(None);
        }
        (plan.odometry, plan.nav_sat, plan.fixed_frame_pose, plan.landmarks) = (None, None, None, None);
        let lidars = plan.range.iter().map(|range| (range.source.sensor.clone(), Lidar::default())).collect();
        let ingestion = Ingestion::with_plan(recording, inventory, plan, options)?;
        Ok(Some((Self { gyroscope: Gyroscope::default(), lidars, next: SWEEPS }, ingestion)))
    }

    fn add(&mut self, id: &SensorId, measurement: Measurement, scale: f64) {
        match measurement {
            Measurement::Imu(imu) => {
                self.gyroscope.add(&ImuData { angular_velocity: scale * imu.angular_velocity, ..imu });
            }
            Measurement::Range(cloud) if id.kind == SensorKind::Range => {
                if let Some(lidar) = self.lidars.get_mut(id) {
                    lidar.add(cloud, &self.gyroscope);
                }
            }
            _ => {}
        }
    }

    /// Whether all offsets are accurate enough, or enough sweeps were used.
    fn is_enough(&mut self, most_sweeps: usize) -> bool {
        let most = self.lidars.values().map(|lidar| lidar.sweeps).max().unwrap_or(0);
        if most < self.next {
            return false;
        }
        self.next *= 2;
        let is_sure = |lidar: &Lidar| {
            lag::find_lag(&lidar.tracked, &self.gyroscope).is_some_and(|found| found.sigma < SURE)
        };
        most >= most_sweeps || self.lidars.values().all(is_sure)
    }

    fn finish(mut self, plan: &SensorPlan) -> Measured {
        let Some(imu) = &plan.imu else { return Measured::default() };
        let (mut offsets, mut mountings, mut turns_alike) = (Vec::new(), Vec::new(), true);
        let mut misalignments = Vec::new();
        for range in &plan.range {
            let Some(lidar) = self.lidars.get_mut(&range.source.sensor) else { continue };
            lidar.track(&self.gyroscope, 0);
            let turns = lag::turns(&lidar.tracked);
            mountings.push(mounting::find_mounting(&turns, &self.gyroscope));
            turns_alike &= mounting::turns_alike(&turns, &self.gyroscope);
            let Some(found) = lag::find_lag(&lidar.tracked, &self.gyroscope) else { continue };
            misalignments.push((found.misalignment, found.misalignment_sigma));
            offsets.push(ClockOffset {
                lidar: range.source.topic.clone(),
                imu: imu.source.topic.clone(),
                // A delay of the IMU is an advance of the lidar.
                seconds: -found.seconds,
                sigma: found.sigma,
                has_point_times: range.point_time.is_some(),
            });
        }
        let mounting = mountings.into_iter().reduce(|all, one| all.and(one)).flatten();
        let mounting =
            mounting.map(|(turned, factor)| ImuMounting { imu: imu.source.topic.clone(), turned, factor });
        let is_significant = mounting.is_none() && misalignments.len() == plan.range.len();
        let common = if is_significant { common_misalignment(&misalignments) } else { None };
        let misalignment = common.map(|(rotation, sigma)| {
            let imu = imu.source.topic.clone();
            ImuMisalignment { imu, rotation, sigma }
        });
        let comparison = ImuComparison { offsets, mounting, misalignment };
        let rms_rate = self.gyroscope.rms_rate();
        Measured { comparison, imu: Some(imu.source.topic.clone()), turns_alike, rms_rate }
    }
}

impl Lidar {
    fn add(&mut self, cloud: TimedPointCloudData, gyroscope: &Gyroscope) {
        self.waiting.extend(self.gatherer.add(cloud));
        self.track(gyroscope, MAX_WAITING);
    }

    /// Tracks the sweeps whose rotation the gyroscope has measured, until at most `may_wait` wait.
    fn track(&mut self, gyroscope: &Gyroscope, may_wait: usize) {
        while let Some(sweep) = self.waiting.front() {
            let end = sweep.middle + Duration::from_seconds(sweep.half);
            let is_known = gyroscope.end().is_some_and(|known| known >= end);
            if !is_known && self.waiting.len() <= may_wait {
                return;
            }
            self.sweeps += 1;
            self.tracked.extend(self.tracker.add(sweep, gyroscope));
            self.waiting.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offset(seconds: f64, sigma: f64) -> ClockOffset {
        let (lidar, imu) = ("/points".into(), "/imu".into());
        ClockOffset { lidar, imu, seconds, sigma, has_point_times: true }
    }

    #[test]
    fn a_misalignment_is_corrected_where_all_lidars_agree() {
        let degrees = |misalignments: &[(f64, f64)]| {
            let misalignments: Vec<(Vector3, f64)> =
                misalignments.iter().map(|(d, s)| (Vector3::x() * d.to_radians(), s.to_radians())).collect();
            common_misalignment(&misalignments).map(|(rotation, _)| rotation.norm().to_degrees().round())
        };
        assert_eq!(degrees(&[(10.0, 0.6)]), Some(10.0));
        assert_eq!(degrees(&[(9.5, 0.9), (10.0, 0.6)]), Some(10.0));
        assert_eq!(degrees(&[(10.0, 2.0)]), None);
        assert_eq!(degrees(&[(1.9, 0.1)]), None);
        assert_eq!(degrees(&[(0.0, 0.1), (10.0, 0.2)]), None);
        assert_eq!(degrees(&[]), None);
    }

    #[test]
    fn the_clock_of_the_imu_is_shifted_where_all_lidars_agree() {
        let seconds = |offsets: &[ClockOffset]| common_offset(offsets).map(|offset| offset.seconds);
        assert_eq!(seconds(&[offset(-0.045, 0.001)]), Some(-0.045));
        assert_eq!(seconds(&[offset(-0.041, 0.002), offset(-0.045, 0.001)]), Some(-0.045));
        // One of the lidars is off, but it is unknown which one.
        assert_eq!(seconds(&[offset(0.0, 0.001), offset(-0.045, 0.001)]), None);
        assert_eq!(seconds(&[offset(-0.045, 0.01)]), None);
        assert_eq!(seconds(&[offset(-0.005, 0.0001)]), None);
        assert_eq!(seconds(&[]), None);
    }
}
