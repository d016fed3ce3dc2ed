//! Landmarks on walls, which a camera detects at short range and from the front.

use std::sync::Arc;

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, Vector3};
use portolan_recording::{Header, LandmarkEntry, LandmarkList, Message, RecordedMessage};

use super::stream::{Clock, MessageStream, Schedule, Ticks};
use crate::motion::{Motion, rotation};
use crate::streams::{ROBOT_FRAME, pose_message};
use portolan_worlds::Random;
use portolan_worlds::three_d::{Moment, Ray3, SolidWorld};

/// Minimum cosine of the angle between the line of sight and the normal of a landmark that is seen.
const MOST_ASLANT: f64 = 0.35;

/// A camera that finds landmarks all around.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkOptions {
    /// Topic of its `cartographer_ros_msgs/LandmarkList`. Default `/landmark`.
    pub topic: String,
    /// Lists per second. Default 5.
    pub rate: f64,
    /// Maximum range, metres. Default 6.
    pub range: f64,
    /// Standard deviation of positions, metres. Default 0.02.
    pub position_noise: f64,
    /// Standard deviation of orientations, radians. Default 0.01.
    pub rotation_noise: f64,
    /// Height of the camera above `base_link`, metres. Default 0.3.
    pub camera_height: f64,
}

impl Default for LandmarkOptions {
    fn default() -> Self {
        Self {
            topic: "/landmark".to_owned(),
            rate: 5.0,
            range: 6.0,
            position_noise: 0.02,
            rotation_noise: 0.01,
            camera_height: 0.3,
        }
    }
}

impl LandmarkOptions {
    /// The same camera without errors.
    pub fn without_noise(self) -> Self {
        Self { position_noise: 0.0, rotation_noise: 0.0, ..self }
    }
}

/// The messages of the camera.
pub(crate) struct LandmarkStream<M> {
    options: LandmarkOptions,
    world: Arc<SolidWorld>,
    motion: Arc<M>,
    marks: Arc<[Rigid3]>,
    ticks: Ticks,
    seed: u64,
}

/// Poses of landmarks in the map, with x out of the wall.
pub(crate) fn landmark_poses(marks: &[(Vector3, Vector3)]) -> Arc<[Rigid3]> {
    let pose = |(place, normal): &(Vector3, Vector3)| {
        let yaw = libm::atan2(normal.y, normal.x);
        Rigid3::from_parts(na::Translation3::from(*place), rotation(0.0, 0.0, yaw))
    };
    marks.iter().map(pose).collect()
}

impl<M: Motion> LandmarkStream<M> {
    pub fn new(
        options: LandmarkOptions,
        (world, motion, marks): (Arc<SolidWorld>, Arc<M>, Arc<[Rigid3]>),
        (clock, schedule): (Clock, Schedule),
        seed: u64,
    ) -> Self {
        Self { options, world, motion, marks, ticks: Ticks::new(clock, schedule), seed }
    }

    fn is_seen(&self, camera: &Vector3, map_from_mark: &Rigid3) -> bool {
        let normal = map_from_mark.rotation * Vector3::x();
        let to_mark = map_from_mark.translation.vector + normal * 0.01 - camera;
        let range = to_mark.norm();
        if range > self.options.range || range < 0.1 || -to_mark.dot(&normal) < MOST_ASLANT * range {
            return false;
        }
        let ray = Ray3 { origin: *camera, direction: to_mark / range };
        self.world.echo(&ray, range - 0.05, (&Moment::default(), 0.0), None).is_none()
    }
}

impl<M: Motion> MessageStream for LandmarkStream<M> {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        let (index, seconds, stamp) = self.ticks.next()?;
        let o = &self.options;
        let mut random = Random::new(self.seed, "landmarks", index);
        let map_from_base = self.motion.state(seconds).map_from_base;
        let camera = (map_from_base * na::Point3::new(0.0, 0.0, o.camera_height)).coords;
        let mut landmarks = Vec::new();
        for (number, map_from_mark) in self.marks.iter().enumerate() {
            if !self.is_seen(&camera, map_from_mark) {
                continue;
            }
            let offset = random.gaussian_vector() * o.position_noise;
            let turn = random.gaussian_vector() * o.rotation_noise;
            let turn = rotation(turn.x, turn.y, turn.z);
            let noise = Rigid3::from_parts(na::Translation3::from(offset), turn);
            landmarks.push(LandmarkEntry {
                id: format!("mark_{number}"),
                tracking_from_landmark: pose_message(&(map_from_base.inverse() * map_from_mark * noise)),
                translation_weight: 1.0 / o.position_noise.max(1e-3),
                rotation_weight: 1.0 / o.rotation_noise.max(1e-3),
            });
        }
        let header = Header { stamp, frame_id: ROBOT_FRAME.into() };
        let message = Message::LandmarkList(LandmarkList { header, landmarks });
        Some(RecordedMessage { topic: o.topic.as_str().into(), log_time: stamp, message })
    }
}
