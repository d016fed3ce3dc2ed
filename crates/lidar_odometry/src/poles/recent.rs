//! Vertical structures of the last sweeps, for sweeps whose motion is unmeasured.

use std::collections::VecDeque;

use portolan_geometry::{Point3f, Rigid3, Time, to_f32};

use super::{PoleMap, PolePoint};
use crate::deskew::PiecewiseLinearTrajectory;
use crate::segment::{MotionSource, TrajectorySegment};
use crate::settings::PoleSettings;
use crate::sweep::Sweep;

/// Points of vertical structures in the last sweeps.
#[derive(Clone)]
pub(crate) struct RecentPoles {
    settings: PoleSettings,
    sweeps: VecDeque<PolesOfSweep>,
}

#[derive(Clone)]
struct PolesOfSweep {
    end: Time,
    local_from_tracking: Rigid3,
    poles: SeenPoles,
}

/// Points of vertical structures in a sweep, relative to its end.
#[derive(Clone)]
pub(crate) enum SeenPoles {
    /// The points.
    Known(Vec<Point3f>),
    /// To be extracted when needed, since the pose of the sweep is remembered from an earlier run.
    Unpicked(Box<UnpickedPoles>),
}

/// A sweep whose vertical structures have not been extracted yet.
#[derive(Clone)]
pub(crate) struct UnpickedPoles {
    pub sweep: Sweep,
    /// The predicted segment.
    pub segment: TrajectorySegment,
    /// The registered motion compensation.
    pub to_end: PiecewiseLinearTrajectory,
}

impl SeenPoles {
    /// Those of a sweep with this prediction and registration, to be extracted later.
    pub fn unpicked(sweep: &Sweep, segment: &TrajectorySegment, to_end: &PiecewiseLinearTrajectory) -> Self {
        let (sweep, segment, to_end) = (sweep.clone(), segment.clone(), to_end.clone());
        Self::Unpicked(Box::new(UnpickedPoles { sweep, segment, to_end }))
    }

    fn picked(&mut self, settings: &PoleSettings) -> &[Point3f] {
        if let Self::Unpicked(unpicked) = self {
            let points = points_of(&unpicked.sweep, &unpicked.segment, settings);
            *self = Self::Known(deskewed(&points, &unpicked.to_end));
        }
        match self {
            Self::Known(points) => points,
            Self::Unpicked(_) => &[],
        }
    }
}

fn points_of(sweep: &Sweep, segment: &TrajectorySegment, settings: &PoleSettings) -> Vec<PolePoint> {
    let to_end = segment.deskewing(&Default::default());
    let points = sweep.points.iter().map(|p| p.timed());
    PolePoint::of_sweep(points, &to_end, &segment.end().rotation, settings)
}

fn deskewed(points: &[PolePoint], to_end: &PiecewiseLinearTrajectory) -> Vec<Point3f> {
    points.iter().map(|p| to_end.moved(&p.point.position, p.point.time)).collect()
}

/// Vertical structures of a sweep, and those of the previous sweeps, in the frame of the planes.
pub(crate) struct PolesToRegister {
    pub map: PoleMap,
    pub points: Vec<PolePoint>,
}

impl PolesToRegister {
    pub fn seen_from_end(&self, to_end: &PiecewiseLinearTrajectory) -> SeenPoles {
        SeenPoles::Known(deskewed(&self.points, to_end))
    }
}

impl RecentPoles {
    pub fn new(settings: &PoleSettings) -> Self {
        Self { settings: settings.clone(), sweeps: VecDeque::new() }
    }

    /// Whether to register poles: if no sensor measures translation or rotation of a sweep. With odometry
    /// it would help among trees, too, but in a bare tunnel, where some points of the walls pass for
    /// poles, it contradicts the odometry.
    pub fn are_wanted(segment: &TrajectorySegment) -> bool {
        segment.source == MotionSource::ConstantVelocity && !segment.rotation_is_measured()
    }

    /// Points and map to register, if poles are wanted.
    pub fn prepare(
        &mut self,
        sweep: &Sweep,
        segment: &TrajectorySegment,
        map_from_local: &Rigid3,
    ) -> Option<PolesToRegister> {
        if !Self::are_wanted(segment) {
            return None;
        }
        let settings = &self.settings;
        let points = points_of(sweep, segment, settings);
        let in_map = self.sweeps.iter_mut().rev().flat_map(|sweep| {
            let there = to_f32(&(map_from_local * sweep.local_from_tracking));
            sweep.poles.picked(settings).iter().map(move |p| there * p)
        });
        Some(PolesToRegister { map: PoleMap::new(in_map, settings), points })
    }

    /// Adds those of a registered sweep, relative to its end.
    pub fn add(&mut self, end: Time, local_from_tracking: Rigid3, poles: SeenPoles) {
        self.sweeps.push_back(PolesOfSweep { end, local_from_tracking, poles });
        let is_old = |first: &PolesOfSweep| end.seconds_since(first.end) > self.settings.memory;
        while self.sweeps.front().is_some_and(is_old) {
            self.sweeps.pop_front();
        }
    }
}
