//! The odometry: from sweeps, IMU samples and odometry poses to registered sweeps.

use std::collections::VecDeque;

use portolan_geometry::Time;
use portolan_motion::ExtrapolatorCounts;
use portolan_recall::Memory;
use portolan_sensor::{ImuData, OdometryData};
use thiserror::Error;

use crate::degenerate_intervals::DegenerateInterval;
use crate::gravity_initialisation::{Beginning, GravityInitialisation, WaitingSweeps};
use crate::issues::{Issue, Issues};
use crate::local_map::GrowingMap;
use crate::motion_state::MotionState;
use crate::phase::{Phase, State};
use crate::settings::OdometrySettings;
use crate::sweep::Sweep;
use crate::tracker::{Fallback, RegisteredSweep, Tracker};

/// Why a sweep cannot be registered. It is also counted.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SweepError {
    /// It has no points.
    #[error("the sweep has no points")]
    Empty,
    /// Time runs backward.
    #[error("the sweep ends before the one before it")]
    TooOld,
}

/// Registers sweeps of a 3D lidar to planes that it saw before.
pub struct LidarOdometry {
    settings: OdometrySettings,
    state: State,
    /// Sweeps that are not registered yet, in order of time.
    waiting: VecDeque<Sweep>,
    /// Whether no more sweeps will come.
    is_ended: bool,
    issues: Issues,
    memory: Memory,
}

impl LidarOdometry {
    /// An odometry that knows nothing yet.
    pub fn new(settings: OdometrySettings) -> Self {
        Self {
            state: State::WaitingForGravity(GravityInitialisation::new(&settings.initialisation)),
            settings,
            waiting: VecDeque::new(),
            is_ended: false,
            issues: Issues::default(),
            memory: Memory::default(),
        }
    }

    /// Remembers where sweeps were found with this. To be called before anything is added.
    pub fn remember_with(&mut self, memory: &Memory) {
        self.memory = memory.clone();
    }

    /// Takes a sweep and the IMU samples since the last one. Gives the sweeps whose turn has come: none while gravity is
    /// awaited and for the first one, more when that ends.
    ///
    /// # Errors
    ///
    /// If the sweep is empty, or ends before the last one.
    pub fn register(&mut self, sweep: &Sweep, imu: &[ImuData]) -> Result<Vec<RegisteredSweep>, SweepError> {
        // 1. Motion: bias, gravity and velocity are followed sample by sample.
        imu.iter().for_each(|sample| self.add_imu(sample));
        // 2. The sweep waits for its turn.
        self.push(sweep.clone())?;
        // 3. Register all whose turn has come.
        Ok(std::iter::from_fn(|| self.advance(None)).collect())
    }

    /// Registers the next of the sweeps that wait, if its turn has come. Where it fits no plane, another map is asked.
    pub fn advance(&mut self, fallback: Option<&mut dyn Fallback>) -> Option<RegisteredSweep> {
        // 1. Wait until an IMU has told which way is up, or until it is clear that there is none.
        let waiting = self.waiting_sweeps();
        if !self.begin_if_ready(waiting.as_ref()) {
            return None;
        }
        // 2. The first sweep waits for the second, which tells how fast everything was already moving.
        if matches!(self.state, State::FirstSweep(_)) {
            return self.register_first();
        }
        // 3. All others are registered to planes that those before them saw.
        let State::Tracking(tracker) = &mut self.state else { return None };
        Some(tracker.register(self.waiting.pop_front()?, fallback, &mut self.issues))
    }

    fn register_first(&mut self) -> Option<RegisteredSweep> {
        let needed = if self.is_ended { 1 } else { 2 };
        if self.waiting.len() < needed {
            return None;
        }
        let State::FirstSweep(motion) = std::mem::take(&mut self.state) else { return None };
        let (first, second) = (self.waiting.pop_front()?, self.waiting.front());
        let (mut tracker, registered) = Tracker::begin(&self.settings, *motion, first, second);
        tracker.remember_with(&self.memory);
        self.state = State::Tracking(Box::new(tracker));
        Some(registered)
    }

    /// Adds a sweep to those that wait for [`Self::advance`].
    ///
    /// # Errors
    ///
    /// If the sweep is empty, or ends before the last one.
    pub fn push(&mut self, sweep: Sweep) -> Result<(), SweepError> {
        if sweep.points.is_empty() {
            self.issues.count(Issue::EmptySweep);
            return Err(SweepError::Empty);
        }
        let last = self.waiting.back().map(|last| last.end).or_else(|| self.last_pose_time());
        if last.is_some_and(|last| sweep.end < last) {
            self.issues.count(Issue::SweepTooOld);
            return Err(SweepError::TooOld);
        }
        self.waiting.push_back(sweep);
        Ok(())
    }

    /// Takes an IMU sample, in order of time.
    pub fn add_imu(&mut self, data: &ImuData) {
        let issue = match &mut self.state {
            State::WaitingForGravity(initialisation) => initialisation.add_imu(data),
            State::FirstSweep(motion) => motion.add_imu(data),
            State::Tracking(tracker) => tracker.motion_mut().add_imu(data),
        };
        issue.into_iter().for_each(|issue| self.issues.count(issue));
    }

    /// Takes an odometry pose, in order of time.
    pub fn add_odometry(&mut self, data: &OdometryData) {
        let issue = match &mut self.state {
            State::WaitingForGravity(initialisation) => {
                initialisation.add_odometry(data);
                None
            }
            State::FirstSweep(motion) => motion.add_odometry(data),
            State::Tracking(tracker) => tracker.motion_mut().add_odometry(data),
        };
        issue.into_iter().for_each(|issue| self.issues.count(issue));
    }

    /// Begins the trajectory if enough is known, or if too little comes to wait for more; sweeps may wait elsewhere.
    /// Whether it has begun.
    pub fn begin_if_ready(&mut self, waiting: Option<&WaitingSweeps>) -> bool {
        if let State::WaitingForGravity(initialisation) = &self.state
            && (self.is_ended || initialisation.is_ready(waiting))
        {
            self.begin(waiting);
        }
        !matches!(self.state, State::WaitingForGravity(_))
    }

    /// Begins the trajectory with what is known, if that is anything at all.
    pub fn begin(&mut self, waiting: Option<&WaitingSweeps>) {
        let State::WaitingForGravity(initialisation) = &mut self.state else { return };
        let extrapolator = self.settings.extrapolator.extrapolator();
        let Some(Beginning { extrapolator, imu }) = initialisation.begin(extrapolator, waiting) else {
            return;
        };
        let (motion, issues) = MotionState::new(&self.settings, extrapolator, &imu);
        issues.into_iter().for_each(|issue| self.issues.count(issue));
        self.state = State::FirstSweep(Box::new(motion));
    }

    /// Says that no more sweeps will come: what waits need not wait any longer.
    pub fn end(&mut self) {
        self.is_ended = true;
    }

    fn waiting_sweeps(&self) -> Option<WaitingSweeps> {
        let (first, last) = (self.waiting.front()?, self.waiting.back()?);
        Some(WaitingSweeps { first_point: first.begin(), first_end: first.end, last_end: last.end })
    }

    /// Where it stands.
    pub fn phase(&self) -> Phase {
        self.state.phase()
    }

    /// Whether the trajectory began with an IMU; none before it begins.
    pub fn has_imu(&self) -> Option<bool> {
        self.state.motion().map(|motion| motion.has_imu)
    }

    /// Time of the last pose, or of the beginning; none before.
    pub fn last_pose_time(&self) -> Option<Time> {
        self.state.motion()?.extrapolator.last_pose_time()
    }

    /// The maps around that sweeps are registered to, oldest first.
    pub fn local_maps(&self) -> impl Iterator<Item = &GrowingMap> {
        let tracker = match &self.state {
            State::Tracking(tracker) => Some(tracker),
            _ => None,
        };
        tracker.into_iter().flat_map(|tracker| tracker.local_map().all())
    }

    /// Intervals in which sweeps left a direction unconstrained, in order of their beginning.
    pub fn degenerate_intervals(&self) -> &[DegenerateInterval] {
        match &self.state {
            State::Tracking(tracker) => tracker.degenerate_intervals(),
            _ => &[],
        }
    }

    /// What was wrong with the data so far.
    pub fn issues(&self) -> &Issues {
        &self.issues
    }

    /// What was wrong with poses, odometry and IMU since the first sweep.
    pub fn extrapolator_counts(&self) -> ExtrapolatorCounts {
        self.state.motion().map(|motion| motion.extrapolator.counts()).unwrap_or_default()
    }
}
