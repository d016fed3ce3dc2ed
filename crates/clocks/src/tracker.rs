//! Tracks the rotation of a lidar by matching each sweep to the surfaces of the last seconds.

use std::collections::VecDeque;

use portolan_geometry::nalgebra::{Matrix3, Rotation3};
use portolan_geometry::{Duration, Point3f, Quaternion, Rigid3, Time, Vector3, to_f32};
use portolan_lidar_odometry::{
    PlaneMap, PosePrior, Registration, RegistrationResult, RegistrationSettings, Sigmas,
};
use portolan_sensor::voxel_filter_indices;

use super::gyroscope::Gyroscope;
use super::sweeps::Sweep;

/// Edge of the voxels of the surfaces, metres.
const EDGE: f64 = 1.0;
/// Number of sweeps in a map after which the next one is started; a map is dropped when the next one has as
/// many.
const SWEEPS_OF_A_MAP: u32 = 15;
/// Approximate number of points of a sweep that are matched.
const WANTED_POINTS: f32 = 1500.0;
/// Fraction of matched points below which a match is rejected.
const MIN_MATCHED_FRACTION: f64 = 0.15;
/// Interval between sweeps above which their relative rotation is not used, seconds.
const MAX_INTERVAL: f64 = 0.35;
/// Maximum number of iterations in which a sweep is de-skewed with the velocity from its match.
const TURNS: u32 = 3;
/// Spacing of the interpolated rotations within a sweep, seconds.
const ROTATION_SPACING: f64 = 0.001;
/// Maximum number of consecutive sweeps without a match: the first sweeps alone do not show many surfaces.
const MAX_UNMATCHED: u32 = 10;
/// Standard deviation of the rotation predicted by the gyroscope, radians. It is so wide that an offset of
/// its clock does no harm; scans measure rotations a hundred times more accurately.
const TURN_SIGMA: f64 = 0.05;
/// Unmeasured acceleration of the carrier, m/s².
const ACCELERATION: f64 = 6.0;
/// Standard deviation of the translation from the first sweep to the second, metres.
const FIRST_SIGMA: f64 = 1.0;

/// A sweep and the orientation of the tracking frame in its middle.
#[derive(Clone, Debug)]
pub(super) struct TrackedSweep {
    pub time: Time,
    /// Orientation of the tracking frame in a local frame.
    pub rotation: Quaternion,
    /// Its covariance: of a rotation vector in the tracking frame, rad².
    pub covariance: Matrix3<f64>,
    /// Sweeps with different segment numbers have different local frames.
    pub segment: u32,
}

struct LocalMap {
    local_from_map: Rigid3,
    planes: PlaneMap,
    sweeps: u32,
}

struct Last {
    time: Time,
    local_from_tracking: Rigid3,
    /// In the local frame, m/s.
    velocity: Vector3,
    is_first: bool,
}

impl Last {
    fn first(time: Time) -> Self {
        Self { time, local_from_tracking: Rigid3::identity(), velocity: Vector3::zeros(), is_first: true }
    }

    /// Prediction with constant velocity and the rotation of the gyroscope.
    fn predicted(&self, time: Time, gyroscope: &Gyroscope) -> Option<Rigid3> {
        let seconds = time.seconds_since(self.time);
        let turn = gyroscope.turn(self.time, time).filter(|_| (1e-3..MAX_INTERVAL).contains(&seconds))?;
        let place = self.local_from_tracking.translation.vector + self.velocity * seconds;
        Some(Rigid3::from_parts(place.into(), self.local_from_tracking.rotation * turn))
    }
}

/// Tracks one lidar.
pub(super) struct SweepTracker {
    registration: Registration,
    maps: VecDeque<LocalMap>,
    last: Option<Last>,
    segment: u32,
    unmatched: u32,
    spacing: f32,
    /// Points of a sweep de-skewed to its middle, those of them that are matched, and the indices of these.
    deskewed: Vec<Point3f>,
    chosen: Vec<Point3f>,
    kept: Vec<u32>,
}

impl Default for SweepTracker {
    fn default() -> Self {
        // Only rotations are needed here, and surfaces at grazing incidence constrain them: without these
        // the offset of a sparse second lidar among trees is not found.
        let options = RegistrationSettings {
            min_matched_fraction: 0.0,
            grazing_weight: 0.1,
            ..RegistrationSettings::default()
        };
        Self {
            registration: Registration::new(options),
            maps: VecDeque::new(),
            last: None,
            segment: 0,
            unmatched: 0,
            spacing: 0.4,
            deskewed: Vec::new(),
            chosen: Vec::new(),
            kept: Vec::new(),
        }
    }
}

impl SweepTracker {
    /// Registers sweeps to convergence: an iteration that ends early agrees with the predicting gyroscope,
    /// right or not.
    pub fn to_the_end() -> Self {
        let default = Self::default();
        let options = RegistrationSettings { small_step: 0.02, ..default.registration.settings().clone() };
        Self { registration: Registration::new(options), ..default }
    }

    /// Takes the next sweep; none if its rotation is not determined.
    pub fn add(&mut self, sweep: &Sweep, gyroscope: &Gyroscope) -> Option<TrackedSweep> {
        let Some(rotations) = Rotations::of(sweep, gyroscope) else {
            self.lose();
            return None;
        };
        let predicted = self.last.as_ref().and_then(|last| last.predicted(sweep.middle, gyroscope));
        let Some(predicted) = predicted.filter(|_| self.unmatched < MAX_UNMATCHED) else {
            self.lose();
            self.deskew(sweep, &rotations, &Vector3::zeros());
            self.last = Some(Last::first(sweep.middle));
            self.insert(&sweep.origin);
            return None;
        };
        let found = self.follow(sweep, &rotations, &predicted);
        match &found {
            Some(_) => self.unmatched = 0,
            None => {
                self.unmatched += 1;
                if let Some(last) = &mut self.last {
                    (last.time, last.local_from_tracking) = (sweep.middle, predicted);
                }
            }
        }
        self.insert(&sweep.origin);
        found
    }

    fn lose(&mut self) {
        self.maps.clear();
        self.last = None;
        self.unmatched = 0;
        self.segment += 1;
    }

    fn follow(&mut self, sweep: &Sweep, rotations: &Rotations, predicted: &Rigid3) -> Option<TrackedSweep> {
        let last = self.last.as_ref()?;
        let seconds = sweep.middle.seconds_since(last.time);
        let (from, is_first) = (last.local_from_tracking, last.is_first);
        let mut velocity = last.velocity;
        let sigma = match is_first {
            true => FIRST_SIGMA,
            false => 0.02 + 0.5 * ACCELERATION * seconds * seconds,
        };
        let mut pose = *predicted;
        let mut found = None;
        for turn in 0..TURNS {
            self.deskew(sweep, rotations, &(pose.rotation.inverse() * velocity));
            if turn == 0 {
                self.choose();
            }
            self.chosen.clear();
            self.chosen.extend(self.kept.iter().filter_map(|i| self.deskewed.get(*i as usize)));
            let map = self.maps.front()?;
            let map_from_local = map.local_from_map.inverse();
            let prior = PosePrior {
                pose: map_from_local * predicted,
                sigmas: Sigmas { translation: sigma, rotation: TURN_SIGMA },
            };
            let scale = if turn == 0 { (3.0 * sigma).clamp(0.3, 2.0) } else { 0.0 };
            let initial = map_from_local * pose;
            let matched =
                self.registration.register_scan(&map.planes, &self.chosen, &initial, &prior, scale)?;
            if matched.matched_fraction < MIN_MATCHED_FRACTION {
                return None;
            }
            pose = map.local_from_map * matched.pose;
            let shift = pose.translation.vector - from.translation.vector;
            let change = (shift / seconds - velocity).norm() * sweep.half;
            velocity = shift / seconds;
            found = Some(matched);
            if change < 0.003 {
                break;
            }
        }
        let found = found?;
        let covariance = covariance_of_rotation(&found, sigma)?;
        self.last = Some(Last { time: sweep.middle, local_from_tracking: pose, velocity, is_first: false });
        Some(TrackedSweep { time: sweep.middle, rotation: pose.rotation, covariance, segment: self.segment })
    }

    /// De-skews the points to the middle of the sweep; `velocity` is in the tracking frame.
    fn deskew(&mut self, sweep: &Sweep, rotations: &Rotations, velocity: &Vector3) {
        let velocity = velocity.cast::<f32>();
        self.deskewed.clear();
        let seen = |(offset, position): &(f32, Point3f)| {
            Point3f::from(rotations.at(*offset) * position.coords + velocity * *offset)
        };
        self.deskewed.extend(sweep.points.iter().map(seen));
    }

    /// Chooses points that evenly cover the sweep.
    fn choose(&mut self) {
        self.kept = voxel_filter_indices(&self.deskewed, |p| *p, self.spacing);
        if !self.kept.is_empty() {
            let correction = (self.kept.len() as f32 / WANTED_POINTS).sqrt().clamp(0.7, 1.4);
            self.spacing = (self.spacing * correction).clamp(0.02, 5.0);
        }
    }

    /// Inserts the de-skewed points at the last pose.
    fn insert(&mut self, origin: &Point3f) {
        let Some(last) = &self.last else { return };
        if self.maps.back().is_none_or(|map| map.sweeps >= SWEEPS_OF_A_MAP) {
            let (local_from_map, planes) = (last.local_from_tracking, PlaneMap::new(EDGE as f32));
            self.maps.push_back(LocalMap { local_from_map, planes, sweeps: 0 });
        }
        if self.maps.len() > 2 {
            self.maps.pop_front();
        }
        for map in &mut self.maps {
            let map_from_tracking = to_f32(&(map.local_from_map.inverse() * last.local_from_tracking));
            let origin = map_from_tracking * origin;
            map.planes.insert_all(self.deskewed.iter().map(|point| map_from_tracking * point), &origin);
            map.sweeps += 1;
        }
    }
}

/// Covariance of the rotation of a match, with the translation marginalised.
fn covariance_of_rotation(found: &RegistrationResult, translation_sigma: f64) -> Option<Matrix3<f64>> {
    let information = &found.information;
    let block = |i: usize, j: usize| information.fixed_view::<3, 3>(i, j).into_owned();
    let held = Matrix3::from_diagonal_element(1.0 / (translation_sigma * translation_sigma));
    let translation = (block(0, 0) + held).try_inverse()?;
    let marginal = block(3, 3) - block(3, 0) * translation * block(0, 3)
        + Matrix3::from_diagonal_element(1.0 / (TURN_SIGMA * TURN_SIGMA));
    let mut covariance = marginal.try_inverse()?;
    for axis in &found.degenerate.rotations {
        covariance += axis * axis.transpose() * (TURN_SIGMA * TURN_SIGMA);
    }
    let to_tracking = found.pose.rotation.inverse().to_rotation_matrix();
    Some(to_tracking * covariance * to_tracking.inverse())
}

/// Rotations of the tracking frame during the sweep, to its orientation in the middle.
struct Rotations {
    half: f32,
    rotations: Vec<Rotation3<f32>>,
}

impl Rotations {
    fn of(sweep: &Sweep, gyroscope: &Gyroscope) -> Option<Self> {
        let count = (2.0 * sweep.half / ROTATION_SPACING).ceil().clamp(0.0, 1000.0) as usize;
        let spacing = 2.0 * sweep.half / count.max(1) as f64;
        let rotation = |i: usize| {
            let time = sweep.middle + Duration::from_seconds(spacing * i as f64 - sweep.half);
            Some(gyroscope.turn(sweep.middle, time)?.cast::<f32>().to_rotation_matrix())
        };
        let rotations = (0..=count).map(rotation).collect::<Option<_>>()?;
        Some(Self { half: sweep.half as f32, rotations })
    }

    fn at(&self, offset: f32) -> &Rotation3<f32> {
        let last = self.rotations.len() - 1;
        let share = (offset + self.half) / (2.0 * self.half).max(1e-6);
        &self.rotations[((share * last as f32 + 0.5) as usize).min(last)]
    }
}

#[cfg(test)]
mod tests;
