//! Pieces of map: buffers the data while it is undecided whether the pose is lost, so that a new piece can
//! begin where the old one ended, and hands over the old piece.

use std::collections::VecDeque;

use portolan_geometry::{Rigid3, Time, Vector3, quaternion_from_angle_axis, yaw};
use portolan_motion::{DegenerateInterval, ExtrapolatorCounts};
use portolan_sensor::{ImuData, OdometryData};

use crate::plane_map::PlaneMap;
use crate::settings::LossSettings;
use crate::sweep::Sweep;
use crate::tracker::{RegisteredSweep, Tracker};

/// Maximum number of samples kept, which bounds memory also if no sweep comes.
const MOST_SAMPLES: usize = 20_000;

/// Beginning of a new piece of map: sweeps no longer fitted the previous one.
#[derive(Clone, Debug)]
pub struct NewPiece {
    /// End of the first sweep that did not fit.
    pub since: Time,
    /// Transform from the new local map to the old one, as if the platform had stayed at its last accepted
    /// pose.
    pub old_from_new: Rigid3,
    /// Planar voxel maps that were being filled, oldest first.
    pub maps: Vec<PlaneMap>,
}

/// Data since the last sweep that fitted, and shortly before.
#[derive(Clone, Debug, Default)]
pub(crate) struct Recent {
    /// Sweeps that contradict the map.
    held: Vec<RegisteredSweep>,
    imu: VecDeque<ImuData>,
    odometry: VecDeque<OdometryData>,
    /// Pose of the last sweep that fitted.
    last_confirmed: Rigid3,
}

/// Data to be registered once more, to an empty map.
pub(crate) struct Replay {
    pub sweeps: Vec<Sweep>,
    pub imu: VecDeque<ImuData>,
    pub odometry: VecDeque<OdometryData>,
}

impl Recent {
    pub fn add_imu(&mut self, data: &ImuData) {
        keep(&mut self.imu, *data);
    }

    pub fn add_odometry(&mut self, data: &OdometryData) {
        keep(&mut self.odometry, *data);
    }

    /// Holds back a sweep that contradicts the map.
    pub fn hold(&mut self, sweep: RegisteredSweep) {
        self.held.push(sweep);
    }

    /// Handles a sweep that fits: older samples are no longer needed.
    pub fn fitted(&mut self, sweep: &RegisteredSweep) {
        let begin = sweep.sweep.begin();
        while self.imu.front().is_some_and(|sample| sample.time < begin) {
            self.imu.pop_front();
        }
        while self.odometry.front().is_some_and(|pose| pose.time < begin) {
            self.odometry.pop_front();
        }
        self.last_confirmed = sweep.local_from_tracking;
    }

    /// Gives the sweeps that were held back.
    pub fn release(&mut self) -> Vec<RegisteredSweep> {
        std::mem::take(&mut self.held)
    }

    /// Gives the sweeps that were held back except the newest ones, at the pose of the last sweep that
    /// fitted, since their motion is unknown.
    pub fn give_up_all_but(&mut self, newest: usize) -> Vec<RegisteredSweep> {
        let kept = self.held.split_off(self.held.len().saturating_sub(newest));
        let mut given_up = std::mem::replace(&mut self.held, kept);
        given_up.iter_mut().for_each(|sweep| sweep.place_at(&self.last_confirmed));
        given_up
    }

    /// Transform from a local map that begins at the last sweep that fitted to the old one; both are
    /// level.
    pub fn old_from_new(&self) -> Rigid3 {
        let heading = quaternion_from_angle_axis(&(Vector3::z() * yaw(&self.last_confirmed.rotation)));
        Rigid3::from_parts(self.last_confirmed.translation, heading)
    }

    /// All data since the last sweep that fitted.
    pub fn replay(&mut self) -> Replay {
        let sweeps = self.release().into_iter().map(|registered| registered.sweep).collect();
        Replay { sweeps, imu: std::mem::take(&mut self.imu), odometry: std::mem::take(&mut self.odometry) }
    }
}

fn keep<T>(samples: &mut VecDeque<T>, sample: T) {
    samples.push_back(sample);
    if samples.len() > MOST_SAMPLES {
        samples.pop_front();
    }
}

/// Attempts to begin a piece of map. After each consecutive failure the wait for the next attempt doubles,
/// which bounds their number.
#[derive(Clone, Debug, Default)]
pub(crate) struct Attempts {
    /// Number of failures since a piece last went beyond its first sweeps.
    failed: u32,
    /// End of the first sweep of this piece.
    began_at: Option<Time>,
}

impl Attempts {
    /// A piece begins; its first sweep ended at this time.
    pub fn begin(&mut self, end: Option<Time>) {
        self.began_at = end;
    }

    /// A piece ends. `has_succeeded`: it went beyond its first sweeps.
    pub fn end(&mut self, has_succeeded: bool) {
        self.failed = if has_succeeded { 0 } else { self.failed.saturating_add(1) };
    }

    /// Whether the piece has lasted long enough.
    pub fn is_time_for_another(&self, end: Time, settings: &LossSettings) -> bool {
        let wait = settings.seconds * f64::from(self.failed.min(32)).exp2();
        let age = self.began_at.map_or(f64::MAX, |began| end.seconds_since(began));
        age >= wait.min(settings.longest_wait)
    }
}

/// Results kept of pieces that ended.
#[derive(Clone, Debug, Default)]
pub(crate) struct Ended {
    pub intervals: Vec<DegenerateInterval>,
    pub counts: ExtrapolatorCounts,
}

impl Ended {
    pub fn add(&mut self, tracker: &Tracker) {
        self.intervals.extend_from_slice(tracker.degenerate_intervals());
        self.counts = self.counts.plus(&tracker.motion().extrapolator.counts());
    }
}
