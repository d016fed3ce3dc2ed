//! Predicts by fitting poses, IMU and odometry of the last seconds (`slam3d.md` §2).
//!
//! Nodes are poses of the tracking frame in a frame whose z points up. The queued poses are the same in the
//! local map, which may be tilted against it. The prediction is the fitted pose of one more node at the
//! requested time.

use std::collections::{BTreeMap, VecDeque};

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, interpolate, is_valid_pose};
use portolan_sensor::{ImuData, OdometryData};
use portolan_solver::{
    Loss, Problem, RotationFreedom, SolverOptions, TranslationFreedom, VariableId, factors,
};

use crate::imu_integration::{integrate_imu, velocity_change};
use crate::interpolation::odometry_at;

/// Gravity before it is estimated, m/s²: the value of Cartographer, and not [`crate::USUAL_GRAVITY`],
/// because results have to be the same.
const GRAVITY_AT_START: f64 = 9.8;
/// Time difference to the newest pose below which a time counts as its own, seconds.
const SAME_TIME: f64 = 1e-6;
/// Maximum number of samples that are kept while no pose arrives.
const CAPACITY: usize = 20_000;

/// Settings of the fit of poses, IMU and odometry.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuBasedSettings {
    /// Duration of the poses and measurements that are fitted, seconds.
    pub pose_queue_duration: f64,
    /// Gravity, m/s²; 0 or less: estimated.
    pub gravity_constant: f64,
    /// Weight of the positions of scan matches.
    pub pose_translation_weight: f64,
    /// Weight of the rotations of scan matches.
    pub pose_rotation_weight: f64,
    /// Weight of measured accelerations.
    pub imu_acceleration_weight: f64,
    /// Weight of measured rotations.
    pub imu_rotation_weight: f64,
    /// Weight of the translations of odometry.
    pub odometry_translation_weight: f64,
    /// Weight of the rotations of odometry.
    pub odometry_rotation_weight: f64,
    /// Maximum number of iterations of one fit.
    pub max_num_iterations: u32,
    /// Whether the solver accepts steps that temporarily increase the cost.
    pub use_nonmonotonic_steps: bool,
}

impl Default for ImuBasedSettings {
    /// Equal weights, over five seconds as in Cartographer.
    fn default() -> Self {
        Self {
            pose_queue_duration: 5.0,
            gravity_constant: 9.806,
            pose_translation_weight: 1.0,
            pose_rotation_weight: 1.0,
            imu_acceleration_weight: 1.0,
            imu_rotation_weight: 1.0,
            odometry_translation_weight: 1.0,
            odometry_rotation_weight: 1.0,
            max_num_iterations: 10,
            use_nonmonotonic_steps: false,
        }
    }
}

/// A prediction for a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Prediction {
    pub time: Time,
    /// In the local map.
    pub local_from_tracking: Rigid3,
    /// Rotation from the tracking frame to a level one.
    pub gravity_from_tracking: Quaternion,
}

/// Fits the poses of the last seconds.
#[derive(Clone, Debug)]
pub(super) struct ImuBasedExtrapolator {
    settings: ImuBasedSettings,
    poses: VecDeque<(Time, Rigid3)>,
    imu: BTreeMap<Time, ImuData>,
    odometry: BTreeMap<Time, OdometryData>,
    /// Nodes as fitted last.
    solution: BTreeMap<Time, Rigid3>,
    gravity_from_local: Rigid3,
}

impl ImuBasedExtrapolator {
    pub fn new(settings: &ImuBasedSettings) -> Self {
        Self {
            settings: settings.clone(),
            poses: VecDeque::new(),
            imu: BTreeMap::new(),
            odometry: BTreeMap::new(),
            solution: BTreeMap::new(),
            gravity_from_local: Rigid3::identity(),
        }
    }

    /// Takes a pose that is newer than all others.
    pub fn add_pose(&mut self, time: Time, local_from_tracking: Rigid3) {
        if self.poses.back().is_some_and(|(last, _)| *last == time) {
            // Two nodes at the same time would leave their relative motion undefined.
            self.poses.pop_back();
        }
        self.poses.push_back((time, local_from_tracking));
        let oldest_needed = time - Duration::from_seconds(self.settings.pose_queue_duration);
        while self.poses.len() > 3 && self.poses.get(1).is_some_and(|(second, _)| *second <= oldest_needed) {
            self.poses.pop_front();
        }
        if let Some((oldest, _)) = self.poses.front().copied() {
            self.solution = self.solution.split_off(&oldest);
            trim(&mut self.imu, oldest);
            trim(&mut self.odometry, oldest);
        }
    }

    pub fn add_imu(&mut self, data: ImuData) {
        self.imu.insert(data.time, data);
        limit(&mut self.imu);
    }

    pub fn add_odometry(&mut self, data: OdometryData) {
        self.odometry.insert(data.time, data);
        limit(&mut self.odometry);
    }

    /// The prediction for a time not before the newest pose; none without poses, and where the IMU was
    /// silent.
    pub fn extrapolate(&mut self, time: Time) -> Option<Prediction> {
        let (newest_time, newest) = self.poses.back().copied()?;
        let resting = Prediction {
            time,
            local_from_tracking: newest,
            gravity_from_tracking: self.gravity_from_local.rotation * newest.rotation,
        };
        if self.poses.len() < 3 || time.seconds_since(newest_time) < SAME_TIME {
            return Some(resting);
        }
        self.fit(time)
    }

    fn fit(&mut self, time: Time) -> Option<Prediction> {
        let nodes = self.initial_nodes(time)?;
        let mut problem = Problem::new();
        let free = (TranslationFreedom::Free, RotationFreedom::Free);
        let gravity_frame = problem.add_se3_with(&self.gravity_from_local, free.0, free.1);
        let newest = self.poses.len() - 1;
        let variables: Vec<(Time, VariableId)> = nodes
            .iter()
            .enumerate()
            .map(|(i, (time, pose))| {
                let (translation, rotation) = match i == newest {
                    true => (TranslationFreedom::Constant, RotationFreedom::ConstantYaw),
                    false => free,
                };
                (*time, problem.add_se3_with(pose, translation, rotation))
            })
            .collect();
        self.add_poses(&mut problem, gravity_frame, &variables);
        self.add_odometry_factors(&mut problem, &variables);
        self.add_imu_factors(&mut problem, &variables);
        let solver = SolverOptions {
            max_num_iterations: self.settings.max_num_iterations,
            use_nonmonotonic_steps: self.settings.use_nonmonotonic_steps,
            ..SolverOptions::default()
        };
        problem.solve(&solver).ok()?;
        self.gravity_from_local = problem.se3(gravity_frame);
        self.solution = variables.iter().map(|(time, id)| (*time, problem.se3(*id))).collect();
        let predicted = problem.se3(variables.last()?.1);
        let gravity_from_newest = problem.se3(variables.get(newest)?.1);
        let (_, local_from_newest) = self.poses.back()?;
        let local_from_tracking = local_from_newest * gravity_from_newest.inverse() * predicted;
        let prediction = Prediction { time, local_from_tracking, gravity_from_tracking: predicted.rotation };
        is_valid_pose(&local_from_tracking).then_some(prediction)
    }

    /// Nodes of the last fit, of newer poses, and of the prediction.
    fn initial_nodes(&self, time: Time) -> Option<Vec<(Time, Rigid3)>> {
        let known = |t: &Time| self.solution.get(t).copied();
        let newest = self.poses.len() - 1;
        let mut nodes: Vec<(Time, Rigid3)> = self
            .poses
            .iter()
            .enumerate()
            .map(|(i, (t, pose))| {
                let fitted = known(t).filter(|_| i != newest);
                (*t, fitted.unwrap_or(self.gravity_from_local * pose))
            })
            .collect();
        let [.., (before_time, before), (last_time, last)] = *nodes.as_slice() else { return None };
        let motion = integrate_imu(&self.imu, last_time, time)?;
        let (interval, ahead) = (last_time.seconds_since(before_time), time.seconds_since(last_time));
        let velocity = (last.translation.vector - before.translation.vector) / interval;
        let fall = na::Vector3::z() * (0.5 * self.gravity() * ahead * ahead);
        let translation =
            last.translation.vector + velocity * ahead + last.rotation * motion.delta_translation - fall;
        nodes.push((time, Rigid3::from_parts(translation.into(), last.rotation * motion.delta_rotation)));
        Some(nodes)
    }

    fn gravity(&self) -> f64 {
        let chosen = self.settings.gravity_constant;
        if chosen > 0.0 { chosen } else { GRAVITY_AT_START }
    }

    fn add_poses(&self, problem: &mut Problem, gravity_frame: VariableId, nodes: &[(Time, VariableId)]) {
        let weights = (self.settings.pose_translation_weight, self.settings.pose_rotation_weight);
        for ((_, pose), (_, node)) in self.poses.iter().zip(nodes) {
            add_between(problem, [gravity_frame, *node], *pose, weights);
        }
    }

    fn add_odometry_factors(&self, problem: &mut Problem, nodes: &[(Time, VariableId)]) {
        let (Some(first), Some(last)) = (self.odometry.keys().next(), self.odometry.keys().next_back())
        else {
            return;
        };
        let weights = (self.settings.odometry_translation_weight, self.settings.odometry_rotation_weight);
        for pair in nodes.windows(2) {
            let &[(start, a), (end, b)] = pair else { continue };
            if !(first < &start && &end < last) {
                continue;
            }
            let (Some(odom_from_a), Some(odom_from_b)) =
                (odometry_at(&self.odometry, start), odometry_at(&self.odometry, end))
            else {
                continue;
            };
            add_between(problem, [a, b], odom_from_a.inverse() * odom_from_b, weights);
        }
    }

    fn add_imu_factors(&self, problem: &mut Problem, nodes: &[(Time, VariableId)]) {
        let gravity = problem.add_nonnegative(self.gravity());
        if self.settings.gravity_constant > 0.0 {
            problem.set_constant(gravity);
        }
        let calibration = problem.add_rotation(&Quaternion::identity(), RotationFreedom::Constant);
        for pair in nodes.windows(2) {
            let &[(start, a), (end, b)] = pair else { continue };
            let Some(motion) = integrate_imu(&self.imu, start, end) else { continue };
            let factor = factors::ImuRotation {
                variables: [a, b, calibration],
                first_from_second: motion.delta_rotation,
                weight: self.settings.imu_rotation_weight,
            };
            let added = problem.add_factor(factor, Loss::None);
            debug_assert!(added.is_ok());
        }
        for triple in nodes.windows(3) {
            let &[(t1, a), (t2, b), (t3, c)] = triple else { continue };
            let Some(delta_velocity_in_second) = velocity_change(&self.imu, [t1, t2, t3]) else { continue };
            let factor = factors::ImuAcceleration {
                variables: [a, b, c, gravity, calibration],
                delta_velocity_in_second,
                first_duration: t2.seconds_since(t1),
                second_duration: t3.seconds_since(t2),
                weight: self.settings.imu_acceleration_weight,
            };
            let added = problem.add_factor(factor, Loss::None);
            debug_assert!(added.is_ok());
        }
    }

    /// A pose between the newest pose and a prediction.
    pub fn between(&self, prediction: &Prediction, time: Time) -> Rigid3 {
        match self.poses.back() {
            Some((newest_time, newest)) if *newest_time < prediction.time => {
                let time = time.clamp(*newest_time, prediction.time);
                interpolate(*newest_time, newest, prediction.time, &prediction.local_from_tracking, time)
            }
            _ => prediction.local_from_tracking,
        }
    }
}

fn add_between(
    problem: &mut Problem,
    variables: [VariableId; 2],
    measurement: Rigid3,
    (translation_weight, rotation_weight): (f64, f64),
) {
    let factor = factors::Se3Between { variables, measurement, translation_weight, rotation_weight };
    let added = problem.add_factor(factor, Loss::None);
    debug_assert!(added.is_ok());
}

/// Keeps one entry at or before a time, and all after it.
fn trim<T>(data: &mut BTreeMap<Time, T>, oldest: Time) {
    if let Some(first) = data.range(..=oldest).next_back().map(|(time, _)| *time) {
        *data = data.split_off(&first);
    }
}

fn limit<T>(data: &mut BTreeMap<Time, T>) {
    while data.len() > CAPACITY {
        data.pop_first();
    }
}
