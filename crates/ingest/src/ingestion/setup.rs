//! Sets up sensors and samplers as planned.

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_sensor::FixedRatioSampler;

use super::{Coordinates, Role, Samplers, Sensor, TimesByAzimuth};
use crate::azimuth_time::AzimuthTimes;
use crate::beam_elevation::Raise;
use crate::beam_smoothing::BeamSmoothing;
use crate::clock::{Ascending, SensorClock};
use crate::even_stamps::{EvenStamps, StampPolicy};
use crate::held_pose::HeldPose;
use crate::options::SamplingRatios;
use crate::plan::{PlanError, PlannedOdometry, PlannedRange, PlannedSensor, SensorPlan};
use crate::point_time::PointTimeOrigin;
use crate::stuck_sample::StuckSample;
use crate::survey::Inventory;
use crate::sweep_stamps::SweepStamps;
use crate::turn_clock::TurnClock;

impl Samplers {
    pub(super) fn new(ratios: &SamplingRatios) -> Result<Self, PlanError> {
        let sampler =
            |ratio| FixedRatioSampler::new(ratio).map_err(|e| PlanError::Option { detail: e.to_string() });
        Ok(Self {
            range: sampler(ratios.rangefinder)?,
            odometry: sampler(ratios.odometry)?,
            fixed_frame_pose: sampler(ratios.fixed_frame_pose)?,
            imu: sampler(ratios.imu)?,
            landmarks: sampler(ratios.landmarks)?,
        })
    }

    /// Sampler for sensors with this role.
    pub(super) fn of(&mut self, role: &Role) -> &mut FixedRatioSampler {
        match role {
            Role::Range { .. } => &mut self.range,
            Role::Odometry { .. } => &mut self.odometry,
            Role::NavSat | Role::FixedFramePose => &mut self.fixed_frame_pose,
            Role::Imu { .. } => &mut self.imu,
            Role::Landmarks => &mut self.landmarks,
        }
    }
}

/// Stamps of sweeps are checked where points count from them, unless the user says that the stamps are right.
fn sweep_stamps(range: &PlannedRange, policy: StampPolicy) -> Option<SweepStamps> {
    let rate = range.statistics.rate;
    let counts_from_stamp = range.point_time.is_some_and(|t| t.origin != PointTimeOrigin::Epoch);
    let is_steady = range.statistics.is_spinning() && rate > 0.0 && rate.is_finite();
    (policy != StampPolicy::AsIs && counts_from_stamp && is_steady).then(|| SweepStamps::new(1.0 / rate))
}

/// Topics whose first stamps are checked: those of laser scanners, and of odometry used with them.
pub(super) fn topics_of_scans(inventory: &Inventory, plan: &SensorPlan) -> Vec<Arc<str>> {
    let is_scan = |topic: &Arc<str>| {
        let survey = inventory.topics.iter().find(|survey| survey.info.topic == *topic);
        survey.is_some_and(|survey| &*survey.info.type_name != "sensor_msgs/PointCloud2")
    };
    let mut topics: Vec<Arc<str>> =
        plan.range.iter().map(|range| range.source.topic.clone()).filter(is_scan).collect();
    if !topics.is_empty() {
        topics.extend(plan.odometry.as_ref().and_then(PlannedOdometry::topic).cloned());
    }
    topics
}

/// The sensors of each topic. One topic may serve twice, for example as a pose and as odometry. `disturbed`:
/// seconds between the messages of topics whose stamps are not trusted from the beginning.
pub(super) fn sensors(
    plan: &SensorPlan,
    stamps: StampPolicy,
    disturbed: &BTreeMap<Arc<str>, f64>,
) -> BTreeMap<Arc<str>, Vec<Sensor>> {
    let mut sensors: BTreeMap<Arc<str>, Vec<Sensor>> = BTreeMap::new();
    let mut add = |source: &PlannedSensor, role: Role| {
        // Fixes and landmarks have no steady rate.
        let is_steady = matches!(role, Role::Range { .. } | Role::Imu { .. } | Role::Odometry { .. });
        sensors.entry(source.topic.clone()).or_default().push(Sensor {
            even_stamps: EvenStamps::new(if is_steady { stamps } else { StampPolicy::AsIs })
                .with_disturbed_period(disturbed.get(&source.topic).copied())
                .with_jitter(source.jitter.as_ref()),
            id: source.sensor.clone(),
            topic: source.topic.clone(),
            role,
            clock: SensorClock::new(source.clock_shift, source.usual_lag),
            order: Ascending::default(),
        });
    };
    for range in &plan.range {
        add(&range.source, role_of_range(range, stamps));
    }
    if let Some(imu) = &plan.imu {
        add(
            &imu.source,
            Role::Imu { scale: imu.scale, correction: imu.correction, stuck: StuckSample::default() },
        );
    }
    if let Some(PlannedOdometry { source, transforms_from: None }) = &plan.odometry {
        add(source, Role::Odometry { held: plan.longest_odometry_hold.map(HeldPose::new) });
    }
    if let Some(source) = &plan.nav_sat {
        add(source, Role::NavSat);
    }
    if let Some(source) = &plan.fixed_frame_pose {
        add(source, Role::FixedFramePose);
    }
    if let Some(source) = &plan.landmarks {
        add(source, Role::Landmarks);
    }
    sensors
}

fn role_of_range(range: &PlannedRange, stamps: StampPolicy) -> Role {
    let rate = range.statistics.rate;
    let is_asked = range.azimuth_times != AzimuthTimes::Off && rate > 0.0 && rate.is_finite();
    let by_azimuth = is_asked.then(|| TimesByAzimuth {
        meaning: range.azimuth_times,
        clock: TurnClock::new(range.turn.map_or(1.0, |turn| turn.in_intervals) / rate),
        keeps_stamps: stamps == StampPolicy::AsIs,
        turn: range.turn,
    });
    Role::Range {
        point_time: range.point_time,
        by_azimuth,
        sweep_stamps: sweep_stamps(range, stamps),
        coordinates: Coordinates {
            length_unit: range.length_unit,
            raise: (range.beam_elevation != 0.0).then(|| Raise::new(range.beam_elevation)),
        },
        scan_duration: range.scan_duration,
        smoothing: range.range_noise.and_then(BeamSmoothing::of),
        directions: Box::default(),
    }
}

/// Whether some sensor moves against the tracking frame, so that `/tf` must be read.
pub(super) fn moves(inventory: &Inventory, plan: &SensorPlan) -> bool {
    let mut frames: Vec<&str> = plan.range.iter().map(|r| &*r.source.frame).collect();
    frames.extend(plan.imu.iter().map(|i| &*i.source.frame));
    frames.extend(plan.landmarks.iter().map(|l| &*l.frame));
    frames.extend(plan.odometry.iter().map(|odometry| &*odometry.source.frame));
    frames.iter().any(|f| !f.is_empty() && inventory.tree.lookup_static(&plan.tracking_frame, f).is_none())
}
