//! Lidar odometry: turns sweeps, IMU samples and odometry poses into registered sweeps.

use std::collections::VecDeque;

use portolan_geometry::Time;
use portolan_motion::{
    Beginning, DegenerateInterval, ExtrapolatorCounts, GravityInitialisation, WaitingSweeps,
};
use portolan_recall::Memory;
use portolan_sensor::{ImuData, OdometryData};
use thiserror::Error;

use crate::gap::{self, NextSweep};
use crate::issues::{Issue, Issues};
use crate::local_map::GrowingMap;
use crate::motion_state::MotionState;
use crate::occlusion::Occlusion;
use crate::phase::{Phase, State};
use crate::pieces::{Attempts, Ended, NewPiece, Recent};
use crate::pose_status::PoseStatus;
use crate::settings::OdometrySettings;
use crate::start::{FirstMotion, StartedTrajectory};
use crate::sweep::Sweep;
use crate::tracker::{Fallback, RegisteredSweep};

/// Reason why a sweep cannot be registered. It is also counted as an issue.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SweepError {
    /// It has no points.
    #[error("the sweep has no points")]
    Empty,
    /// Time runs backward.
    #[error("the sweep ends before the one before it")]
    TooOld,
}

/// Registers sweeps of a 3D lidar to planes of earlier sweeps.
pub struct LidarOdometry {
    settings: OdometrySettings,
    state: State,
    /// Sweeps to be registered, in order of time.
    waiting: VecDeque<Sweep>,
    /// Registered sweeps to be handed over.
    ready: VecDeque<RegisteredSweep>,
    /// Data since the last sweep that fitted the map.
    recent: Recent,
    /// The beginning of a piece of map whose first sweep is not registered yet.
    new_piece: Option<NewPiece>,
    ended: Ended,
    attempts: Attempts,
    occlusion: Occlusion,
    /// Whether no more sweeps will come.
    is_ended: bool,
    /// Time since which sweeps have not fitted, if the last ones did not.
    lost_since: Option<Time>,
    issues: Issues,
    memory: Memory,
}

impl LidarOdometry {
    /// An odometry without data.
    pub fn new(settings: OdometrySettings) -> Self {
        Self {
            state: State::WaitingForGravity(GravityInitialisation::new(
                settings.initialisation.leveling_time,
            )),
            settings,
            waiting: VecDeque::new(),
            ready: VecDeque::new(),
            recent: Recent::default(),
            new_piece: None,
            ended: Ended::default(),
            attempts: Attempts::default(),
            occlusion: Occlusion::default(),
            is_ended: false,
            lost_since: None,
            issues: Issues::default(),
            memory: Memory::default(),
        }
    }

    /// Sets the memory in which registered poses are remembered. To be called before any data is added.
    pub fn remember_with(&mut self, memory: &Memory) {
        self.memory = memory.clone();
    }

    /// Takes a sweep and the IMU samples since the last one. Gives the sweeps that are now registered:
    /// none while it waits for gravity and for the first sweep, several afterwards.
    ///
    /// # Errors
    ///
    /// If the sweep is empty, or ends before the last one.
    pub fn register(&mut self, sweep: &Sweep, imu: &[ImuData]) -> Result<Vec<RegisteredSweep>, SweepError> {
        // 1. Motion: the filter updates bias, gravity and velocity with each sample.
        imu.iter().for_each(|sample| self.add_imu(sample));
        // 2. Queue the sweep.
        self.push(sweep.clone())?;
        // 3. Register all sweeps that need not wait.
        Ok(std::iter::from_fn(|| self.advance(None)).collect())
    }

    /// Gives the next registered sweep; none if more data has to come first. Where a sweep fits no plane,
    /// `fallback` is asked. Sweeps that contradict the map are held back until others fit, or until the
    /// pose counts as lost: then they are registered once more, and the first of them begins a new piece
    /// of map.
    pub fn advance(&mut self, mut fallback: Option<&mut (dyn Fallback + '_)>) -> Option<RegisteredSweep> {
        while self.ready.is_empty() {
            // 1. Wait until an IMU has measured the vertical, or until it is clear that there is none.
            if !self.begin_if_ready(None) {
                return None;
            }
            let registered = match &mut self.state {
                State::WaitingForGravity(_) => return None,
                // 2. The first sweep waits for the second, which determines the initial velocity.
                State::FirstSweep(_) => self.register_first()?,
                // 3. All others are registered to planes of earlier sweeps, unless they are occluded.
                State::Tracking(tracker) => {
                    let loss = &self.settings.loss;
                    if self.waiting.front().is_some_and(|sweep| self.occlusion.hides(sweep, tracker, loss)) {
                        self.waiting.pop_front();
                        self.issues.count(Issue::PlaceHidden);
                        continue;
                    }
                    let sweeps = self.waiting.make_contiguous();
                    let gap = match gap::next_sweep(tracker, &self.settings, sweeps, self.is_ended) {
                        NextSweep::Waits => break,
                        NextSweep::AsPredicted => None,
                        NextSweep::AfterGap { motion, is_uncertain } => {
                            if is_uncertain {
                                self.issues.count(Issue::GapUncertain);
                            }
                            motion
                        }
                    };
                    let Some(sweep) = self.waiting.pop_front() else { break };
                    let fallback = fallback.as_deref_mut();
                    vec![tracker.register(gap, sweep, fallback, &mut self.issues)]
                }
            };
            // 4. Hand it over, hold it back, or begin a new piece of map.
            registered.into_iter().for_each(|registered| self.judge(registered));
        }
        if self.is_ended && self.waiting.is_empty() {
            let held = self.recent.release();
            self.lost_since = self.lost_since.or_else(|| held.first().map(|sweep| sweep.sweep.end));
            self.ready.extend(held);
        }
        self.ready.pop_front()
    }

    fn judge(&mut self, mut registered: RegisteredSweep) {
        match registered.status {
            PoseStatus::Confirmed => {
                self.recent.fitted(&registered);
                registered.new_piece = self.new_piece.take();
                self.ready.extend(self.recent.release());
                self.ready.push_back(registered);
            }
            PoseStatus::Suspect { .. } => self.recent.hold(registered),
            PoseStatus::Lost { since } => {
                let end = registered.sweep.end;
                self.recent.hold(registered);
                if self.attempts.is_time_for_another(end, &self.settings.loss) {
                    self.restart(since);
                }
            }
        }
    }

    /// Ends the piece of map that sweeps no longer fit, and registers all data since then once more, to an
    /// empty map. If that piece had hardly started, the new one begins with the newest sweeps, since earlier
    /// ones may not determine the motion.
    fn restart(&mut self, since: Time) {
        let initialisation =
            State::WaitingForGravity(GravityInitialisation::new(self.settings.initialisation.leveling_time));
        let State::Tracking(tracker) = std::mem::replace(&mut self.state, initialisation) else { return };
        self.ended.add(&tracker);
        self.attempts.end(!tracker.is_warming_up());
        if tracker.is_warming_up() {
            self.ready.extend(self.recent.give_up_all_but(self.settings.loss.sweeps));
        }
        let maps = tracker.local_map().all().map(|map| map.planes.now().compacted()).collect();
        self.new_piece = Some(NewPiece { since, old_from_new: self.recent.old_from_new(), maps });
        let replay = self.recent.replay();
        replay.sweeps.into_iter().rev().for_each(|sweep| self.waiting.push_front(sweep));
        replay.imu.iter().for_each(|sample| self.add_imu(sample));
        self.begin_if_ready(None);
        replay.odometry.iter().for_each(|pose| self.add_odometry(pose));
    }

    /// Registers the first sweep, and those after it from which its velocity was determined.
    fn register_first(&mut self) -> Option<Vec<RegisteredSweep>> {
        let State::FirstSweep(first) = &mut self.state else { return None };
        let sweeps = self.waiting.make_contiguous();
        let StartedTrajectory { tracker, registered, issues } =
            first.decide(&self.settings, &self.memory, sweeps, self.is_ended)?;
        self.attempts.begin(registered.first().map(|first| first.sweep.end));
        self.waiting.drain(..registered.len().min(self.waiting.len()));
        self.issues.add(&issues);
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
            State::WaitingForGravity(initialisation) => {
                initialisation.add_imu(data).err().map(Issue::of_imu_sample)
            }
            State::FirstSweep(first) => first.motion.add_imu(data),
            State::Tracking(tracker) => tracker.motion_mut().add_imu(data),
        };
        match issue {
            Some(issue) => self.issues.count(issue),
            None => self.recent.add_imu(data),
        }
    }

    /// Takes an odometry pose, in order of time.
    pub fn add_odometry(&mut self, data: &OdometryData) {
        let issue = match &mut self.state {
            State::WaitingForGravity(initialisation) => {
                initialisation.add_odometry(data);
                None
            }
            State::FirstSweep(first) => first.motion.add_odometry(data),
            State::Tracking(tracker) => tracker.motion_mut().add_odometry(data),
        };
        match issue {
            Some(issue) => self.issues.count(issue),
            None => self.recent.add_odometry(data),
        }
    }

    /// Begins the trajectory if the data suffices, or if too little comes to wait for more. `elsewhere`:
    /// sweeps that wait outside. Gives whether it has started.
    pub fn begin_if_ready(&mut self, elsewhere: Option<&WaitingSweeps>) -> bool {
        let waiting = self.waiting_sweeps(elsewhere);
        if let State::WaitingForGravity(initialisation) = &self.state
            && (self.is_ended || initialisation.is_ready(waiting.as_ref()))
        {
            self.begin(elsewhere);
        }
        !matches!(self.state, State::WaitingForGravity(_))
    }

    /// Begins the trajectory with the data so far, if there is any.
    pub fn begin(&mut self, elsewhere: Option<&WaitingSweeps>) {
        let waiting = self.waiting_sweeps(elsewhere);
        let State::WaitingForGravity(initialisation) = &mut self.state else { return };
        let extrapolator = self.settings.extrapolator.extrapolator();
        let Some(Beginning { extrapolator, imu }) = initialisation.begin(extrapolator, waiting.as_ref())
        else {
            return;
        };
        let (motion, issues) = MotionState::new(&self.settings, extrapolator, &imu);
        issues.into_iter().for_each(|issue| self.issues.count(issue));
        self.state = State::FirstSweep(Box::new(FirstMotion::new(motion)));
    }

    /// Marks the end of the data: sweeps that wait for more are registered as they are.
    pub fn end(&mut self) {
        self.is_ended = true;
    }

    /// Time since which sweeps have not fitted, if the last ones of all did not.
    pub fn lost_since(&self) -> Option<Time> {
        self.lost_since
    }

    /// The sweeps that wait here, followed by those that wait outside.
    fn waiting_sweeps(&self, elsewhere: Option<&WaitingSweeps>) -> Option<WaitingSweeps> {
        let (Some(first), Some(last)) = (self.waiting.front(), self.waiting.back()) else {
            return elsewhere.copied();
        };
        let last_end = elsewhere.map_or(last.end, |more| more.last_end.max(last.end));
        Some(WaitingSweeps { first_point: first.begin(), first_end: first.end, last_end })
    }

    /// Its phase.
    pub fn phase(&self) -> Phase {
        self.state.phase()
    }

    /// Whether the trajectory began with an IMU; none before it begins.
    pub fn has_imu(&self) -> Option<bool> {
        self.state.motion().map(|motion| motion.has_imu)
    }

    /// Time of the last pose, or of the start of the trajectory; none before.
    pub fn last_pose_time(&self) -> Option<Time> {
        self.state.motion()?.extrapolator.last_pose_time()
    }

    /// The active local maps that sweeps are registered to, oldest first.
    pub fn local_maps(&self) -> impl Iterator<Item = &GrowingMap> {
        let tracker = match &self.state {
            State::Tracking(tracker) => Some(tracker),
            _ => None,
        };
        tracker.into_iter().flat_map(|tracker| tracker.local_map().all())
    }

    /// Degenerate intervals, in order of their beginning.
    pub fn degenerate_intervals(&self) -> Vec<DegenerateInterval> {
        let mut all = self.ended.intervals.clone();
        if let State::Tracking(tracker) = &self.state {
            all.extend_from_slice(tracker.degenerate_intervals());
        }
        all
    }

    /// Ratio of the distance by the odometry of the platform to that by sweeps, where it differs
    /// significantly from one; its motions are corrected by it.
    pub fn odometry_factor(&self) -> Option<f64> {
        self.state.motion()?.odometry_factor()
    }

    /// Faults of the data so far.
    pub fn issues(&self) -> &Issues {
        &self.issues
    }

    /// Faults of poses, odometry and IMU since the first sweep.
    pub fn extrapolator_counts(&self) -> ExtrapolatorCounts {
        let now = self.state.motion().map(|motion| motion.extrapolator.counts()).unwrap_or_default();
        self.ended.counts.plus(&now)
    }
}
