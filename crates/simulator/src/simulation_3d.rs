//! A simulation in 3D: a world, a walk through it, and sensors; with the ground truth.

use std::sync::Arc;

use portolan_geometry::{Rigid3, Time, Vector3};
use portolan_recording::{Message, PointCloud2};

use crate::motion::{Itinerary, ItineraryRequest, Motion, SplineMotion, motion_along};
use crate::rig::{OtherSensor, Request, Rig, RigLidar, Source, Timeline, simulation};
use crate::sensors::{GnssStream, LandmarkStream, MessageStream, Schedule, SpinningLidar, landmark_poses};
use crate::{Scenario3dOptions, SimulatorError};
use portolan_worlds::Random;
use portolan_worlds::three_d::{Pedestrian, Solid, SolidPlan, SolidWorld};

/// Maximum number of points of all lidars that are made ahead of the reader; always at least two sweeps of
/// each.
const POINTS_AHEAD: usize = 1 << 19;

/// A recording in 3D that is made while it is read, with its ground truth. Clones share all data.
#[derive(Clone, Debug)]
pub struct Simulation3d {
    pub(crate) inner: Arc<Inner3d>,
}

#[derive(Debug)]
pub(crate) struct Inner3d {
    pub options: Scenario3dOptions,
    pub world: Arc<SolidWorld>,
    pub marks: Arc<[Rigid3]>,
    pub timeline: Timeline<SplineMotion>,
    pub lidars: Vec<(SpinningLidar, Schedule)>,
}

impl Simulation3d {
    /// Draws the world, plans the walk and adds people; measurements are made when they are read.
    ///
    /// # Errors
    /// The options are not valid ([`Scenario3dOptions::check`]), or there is no path through the world.
    pub fn new(options: Scenario3dOptions) -> Result<Self, SimulatorError> {
        options.check()?;
        let plan = options.plan();
        let mut random = Random::new(options.seed, "itinerary", 0);
        let request = ItineraryRequest {
            loops: &plan.loops,
            speed: options.speed,
            rest: options.rest,
            duration: options.duration,
            standing: options.standing,
        };
        let gait = if options.standing { 0.0 } else { options.gait };
        let motion = Itinerary::plan(&request, &mut random)
            .and_then(|path| motion_along(&path, options.carrier(), options.base_height, gait, &mut random))
            .ok_or(SimulatorError::NoPath)?;
        let people = people(&plan, options.people(), &mut Random::new(options.seed, "people", 0));
        let world = SolidWorld::new(plan.solids, people);
        Ok(Self::assemble(options, world, motion, landmark_poses(&plan.marks)))
    }

    /// A simulation in a world and with a motion given by the user, without people; of the options, those
    /// of sensors, faults, seed, start and duration are used.
    ///
    /// # Errors
    /// The options are not valid ([`Scenario3dOptions::check`]).
    pub fn with_motion(
        options: Scenario3dOptions,
        solids: Vec<Solid>,
        motion: SplineMotion,
    ) -> Result<Self, SimulatorError> {
        options.check()?;
        Ok(Self::assemble(options, SolidWorld::new(solids, Vec::new()), motion, Arc::new([])))
    }

    fn assemble(
        options: Scenario3dOptions,
        world: SolidWorld,
        motion: SplineMotion,
        marks: Arc<[Rigid3]>,
    ) -> Self {
        let duration = options.duration.unwrap_or(motion.duration());
        let lidars = options.lidars.iter().map(|lidar| {
            let lidar = SpinningLidar::new(lidar.clone(), options.seed);
            let schedule =
                Schedule::starting_at(lidar.options.phase, lidar.options.rate, duration, lidar.sweep_time());
            (lidar, schedule)
        });
        let lidars = lidars.collect();
        let timeline = Timeline::new(motion, options.start_time, duration);
        let world = Arc::new(world);
        Self { inner: Arc::new(Inner3d { options, world, timeline, marks, lidars }) }
    }

    /// The world with its people.
    pub fn world(&self) -> &SolidWorld {
        &self.inner.world
    }

    /// The exact motion; its time 0 is [`Simulation3d::start_time`].
    pub fn motion(&self) -> &SplineMotion {
        &self.inner.timeline.motion
    }

    /// True poses of the landmarks in the map, in the order of their numbers.
    pub fn landmarks(&self) -> &[Rigid3] {
        &self.inner.marks
    }

    /// The true pose of `base_link` in the map, to rounding; none outside the recording.
    pub fn truth_at(&self, time: Time) -> Option<Rigid3> {
        self.motion_at(time).map(|state| state.map_from_base)
    }

    /// Number of sweeps of a lidar, before any faults.
    pub fn sweep_count(&self, lidar: usize) -> u64 {
        self.inner.lidars.get(lidar).map_or(0, |(_, schedule)| schedule.count())
    }

    /// Sweep number `index` of a lidar, without faults; none beyond the end.
    pub fn sweep(&self, lidar: usize, index: u64) -> Option<PointCloud2> {
        let (lidar, schedule) = self.inner.lidars.get(lidar)?;
        (index < schedule.count()).then(|| self.inner.sweep(lidar, schedule, index))
    }
}

simulation!(Simulation3d, Scenario3dOptions);

impl Rig for Inner3d {
    type Motion = SplineMotion;

    fn request(&self) -> Request<'_> {
        let o = &self.options;
        Request { seed: o.seed, faults: &o.faults, imu: o.imu.as_ref(), odometry: o.odometry.as_ref() }
    }

    fn timeline(&self) -> &Timeline<SplineMotion> {
        &self.timeline
    }

    fn lidar_count(&self) -> usize {
        self.lidars.len()
    }

    fn lidar(&self, index: usize) -> Option<RigLidar<'_>> {
        let (lidar, schedule) = self.lidars.get(index)?;
        let share = POINTS_AHEAD / self.lidars.len().max(1);
        Some(RigLidar {
            topic: &lidar.topic,
            type_name: "sensor_msgs/PointCloud2",
            frame: &lidar.options.frame,
            base_from_lidar: lidar.options.base_from_lidar,
            schedule,
            message_bytes: lidar.message_bytes(),
            sweep_time: lidar.sweep_time(),
            ahead: (share / lidar.points_per_sweep()).clamp(2, 256) as u64,
        })
    }

    fn lidar_message(&self, index: usize, number: u64) -> Option<Message> {
        let (lidar, schedule) = self.lidars.get(index)?;
        Some(Message::PointCloud2(self.sweep(lidar, schedule, number)))
    }

    fn other_sensors(&self) -> Vec<OtherSensor<'_>> {
        let mut others: Vec<OtherSensor> = Vec::new();
        if let Some(gnss) = &self.options.gnss {
            others.push((&gnss.topic, "sensor_msgs/NavSatFix", gnss.rate, 130, Source::Gnss));
        }
        if let Some(marks) = &self.options.landmarks {
            let type_name = "cartographer_ros_msgs/LandmarkList";
            others.push((&marks.topic, type_name, marks.rate, 200, Source::Landmarks));
        }
        others
    }

    fn other_frames(&self) -> Vec<(&str, Rigid3)> {
        self.options.gnss.iter().map(|gnss| (gnss.frame.as_str(), gnss.base_from_antenna)).collect()
    }

    fn open_other(&self, source: Source) -> Option<Box<dyn MessageStream>> {
        let (motion, world) = (Arc::clone(&self.timeline.motion), Arc::clone(&self.world));
        let seed = self.options.seed;
        match source {
            Source::Gnss => {
                let gnss = self.options.gnss.clone()?;
                let when = (self.timeline.clock, self.schedule(gnss.rate));
                Some(Box::new(GnssStream::new(gnss, (world, motion), when, seed)))
            }
            Source::Landmarks => {
                let marks = self.options.landmarks.clone()?;
                let when = (self.timeline.clock, self.schedule(marks.rate));
                let poses = Arc::clone(&self.marks);
                Some(Box::new(LandmarkStream::new(marks, (world, motion, poses), when, seed)))
            }
            _ => None,
        }
    }
}

impl Inner3d {
    pub fn sweep(&self, lidar: &SpinningLidar, schedule: &Schedule, index: u64) -> PointCloud2 {
        let since_start = schedule.time_of(index);
        let stamp = self.timeline.clock.moment(since_start);
        lidar.sweep(&self.world, &*self.timeline.motion, (index, since_start.seconds(), stamp))
    }
}

/// People on the strolls of a plan, several on one if there are not enough strolls.
fn people(plan: &SolidPlan, count: usize, random: &mut Random) -> Vec<Pedestrian> {
    let strolls: Vec<&Vec<Vector3>> = plan.strolls.iter().filter(|path| path.len() > 1).collect();
    let person = |i: usize| {
        let path = strolls.get(i % strolls.len().max(1))?;
        Pedestrian::new(path, random.between(0.5, 1.3), random.between(0.0, 100.0))
    };
    (0..count).filter_map(person).collect()
}
