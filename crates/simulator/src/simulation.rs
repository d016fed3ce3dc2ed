//! A simulation: a building, a walk through it, and sensors; with the ground truth.

use std::sync::Arc;

use portolan_geometry::{Rigid3, Time};
use portolan_recording::{LaserScan, Message};

use crate::motion::{Motion, TourRequest, Walk, plan_people, plan_tour};
use crate::rig::{Request, Rig, RigLidar, Timeline, simulation};
use crate::sensors::{Lidar, Schedule};
use crate::{ScenarioOptions, SimulatorError};
use portolan_worlds::Random;
use portolan_worlds::two_d::{ClearanceGrid, FloorPlan, World, draw_plan};

/// Maximum number of beams of a lidar that are made ahead of the reader; always at least one scan.
const BEAMS_AHEAD: usize = 1 << 15;
/// Cell of the grid on which paths are planned, metres.
const PATH_CELL: f64 = 0.1;

/// A recording that is made while it is read, with its ground truth. Clones share all data.
#[derive(Clone, Debug)]
pub struct Simulation {
    pub(crate) inner: Arc<Inner>,
}

#[derive(Debug)]
pub(crate) struct Inner {
    pub options: ScenarioOptions,
    pub plan: FloorPlan,
    pub world: World,
    pub timeline: Timeline<Walk>,
    pub lidars: Vec<(Lidar, Schedule)>,
}

impl Simulation {
    /// Draws the building, plans the walk and adds people; measurements are made when they are read.
    ///
    /// # Errors
    /// The options are not valid ([`ScenarioOptions::check`]), or the robot fits at no junction of the building.
    pub fn new(options: ScenarioOptions) -> Result<Self, SimulatorError> {
        options.check()?;
        let building_seed = options.building_seed.unwrap_or(options.seed);
        let plan = draw_plan(options.scene, &options.plan_style(), building_seed);
        Self::in_plan(options, plan)
    }

    /// A simulation in a floor plan given by the user; `size` and the style of the options are not used,
    /// and `scene` only for the default number of people. The tour follows the places and passages of the
    /// plan.
    ///
    /// # Errors
    /// As [`Simulation::new`]; or the plan is not valid ([`FloorPlan::check`]).
    pub fn in_plan(options: ScenarioOptions, plan: FloorPlan) -> Result<Self, SimulatorError> {
        options.check()?;
        plan.check()?;
        let grid = ClearanceGrid::new(&plan.shapes, plan.size, PATH_CELL, options.robot_radius);
        let request = TourRequest {
            plan: &plan,
            grid: &grid,
            limits: options.motion,
            needed_clearance: options.robot_radius,
            rest: options.rest,
            duration: options.duration,
        };
        let walk =
            plan_tour(&request, &mut Random::new(options.seed, "walk", 0)).ok_or(SimulatorError::NoPath)?;
        let people = options.people.unwrap_or(options.scene.default_people());
        let people = plan_people(&plan, &grid, people, &mut Random::new(options.seed, "people", 0));
        let world = World::new(plan.shapes.clone(), people);
        Ok(Self::assemble(options, plan, world, walk))
    }

    /// A simulation with a floor plan and a walk given by the user, without people. The options determine
    /// sensors, faults, seed and times.
    ///
    /// # Errors
    /// The options ([`ScenarioOptions::check`]) or the plan ([`FloorPlan::check`]) are not valid.
    pub fn with_walk(options: ScenarioOptions, plan: FloorPlan, walk: Walk) -> Result<Self, SimulatorError> {
        options.check()?;
        plan.check()?;
        let world = World::new(plan.shapes.clone(), Vec::new());
        Ok(Self::assemble(options, plan, world, walk))
    }

    fn assemble(options: ScenarioOptions, plan: FloorPlan, world: World, walk: Walk) -> Self {
        let duration = options.duration.unwrap_or(walk.duration());
        let lidars = options
            .lidars
            .iter()
            .map(|lidar| {
                let lidar = Lidar::new(lidar.clone(), options.seed);
                let schedule = Schedule::new(lidar.options.rate, duration, lidar.sweep_time());
                (lidar, schedule)
            })
            .collect();
        let timeline = Timeline::new(walk, options.start_time, duration);
        Self { inner: Arc::new(Inner { options, plan, world, timeline, lidars }) }
    }

    /// The floor plan with its places.
    pub fn plan(&self) -> &FloorPlan {
        &self.inner.plan
    }

    /// The building with its people.
    pub fn world(&self) -> &World {
        &self.inner.world
    }

    /// The exact motion; its time 0 is [`Simulation::start_time`].
    pub fn walk(&self) -> &Walk {
        &self.inner.timeline.motion
    }

    /// The true pose of `base_link` in the map, to rounding; none outside the recording. Stamps of
    /// sensors with a clock offset must be corrected by it first.
    pub fn truth_at(&self, time: Time) -> Option<Rigid3> {
        let is_within = (self.start_time()..=self.end_time()).contains(&time);
        is_within.then(|| {
            self.inner.timeline.motion.state_2d(self.inner.timeline.clock.seconds(time)).map_from_base()
        })
    }

    /// Pose of a lidar on the robot, by its index in the options.
    pub fn base_from_lidar(&self, lidar: usize) -> Option<Rigid3> {
        self.inner.lidars.get(lidar).map(|(l, _)| l.options.base_from_lidar())
    }

    /// Number of scans of a lidar, before any faults.
    pub fn scan_count(&self, lidar: usize) -> u64 {
        self.inner.lidars.get(lidar).map_or(0, |(_, schedule)| schedule.count())
    }

    /// Scan number `index` of a lidar, without faults; none beyond the end.
    pub fn scan(&self, lidar: usize, index: u64) -> Option<LaserScan> {
        let (lidar, schedule) = self.inner.lidars.get(lidar)?;
        (index < schedule.count()).then(|| self.inner.scan(lidar, schedule, index))
    }
}

simulation!(Simulation, ScenarioOptions);

impl Rig for Inner {
    type Motion = Walk;

    fn request(&self) -> Request<'_> {
        let o = &self.options;
        Request { seed: o.seed, faults: &o.faults, imu: o.imu.as_ref(), odometry: o.odometry.as_ref() }
    }

    fn timeline(&self) -> &Timeline<Walk> {
        &self.timeline
    }

    fn lidar_count(&self) -> usize {
        self.lidars.len()
    }

    fn lidar(&self, index: usize) -> Option<RigLidar<'_>> {
        let (lidar, schedule) = self.lidars.get(index)?;
        let o = &lidar.options;
        let values = if o.intensities { 2 } else { 1 };
        Some(RigLidar {
            topic: &lidar.topic,
            type_name: "sensor_msgs/LaserScan",
            frame: &o.frame,
            base_from_lidar: o.base_from_lidar(),
            schedule,
            message_bytes: 80 + 4 * (o.beams * values) as u64,
            sweep_time: lidar.sweep_time(),
            ahead: (BEAMS_AHEAD / o.beams).clamp(1, 256) as u64,
        })
    }

    fn lidar_message(&self, index: usize, number: u64) -> Option<Message> {
        let (lidar, schedule) = self.lidars.get(index)?;
        Some(Message::LaserScan(self.scan(lidar, schedule, number)))
    }
}

impl Inner {
    pub fn scan(&self, lidar: &Lidar, schedule: &Schedule, index: u64) -> LaserScan {
        let since_start = schedule.time_of(index);
        let stamp = self.timeline.clock.moment(since_start);
        lidar.scan(&self.world, &self.timeline.motion, index, since_start.seconds(), stamp)
    }
}
