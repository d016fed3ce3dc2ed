//! Vertical structures of the last sweeps, where nothing measures the motion.

use std::collections::VecDeque;

use portolan_geometry::{Point3f, Rigid3, Time, to_f32};

use super::{PoleMap, PolePoint};
use crate::deskew::PiecewiseLinearTrajectory;
use crate::segment::{MotionSource, TrajectorySegment};
use crate::settings::PoleSettings;
use crate::sweep::Sweep;

/// Points of vertical structures in the last sweeps.
pub(crate) struct RecentPoles {
    settings: PoleSettings,
    sweeps: VecDeque<PolesOfSweep>,
}

struct PolesOfSweep {
    end: Time,
    local_from_tracking: Rigid3,
    /// As seen from the end of the sweep.
    points: Vec<Point3f>,
}

/// Vertical structures of a sweep, and those of the sweeps before, in the frame of the planes.
pub(crate) struct PolesToRegister {
    pub map: PoleMap,
    pub points: Vec<PolePoint>,
}

impl PolesToRegister {
    pub fn deskewed(&self, to_end: &PiecewiseLinearTrajectory) -> Vec<Point3f> {
        self.points.iter().map(|p| to_end.moved(&p.point.position, p.point.time)).collect()
    }
}

impl RecentPoles {
    pub fn new(settings: &PoleSettings) -> Self {
        Self { settings: settings.clone(), sweeps: VecDeque::new() }
    }

    /// What to register if nothing measures translation or rotation of a sweep. With odometry it would help among trees,
    /// too, but in a bare tunnel, where some points of the walls pass for poles, it contradicts the odometry.
    pub fn to_register(
        &self,
        sweep: &Sweep,
        segment: &TrajectorySegment,
        map_from_local: &Rigid3,
    ) -> Option<PolesToRegister> {
        if segment.source != MotionSource::ConstantVelocity || segment.rotation_is_measured {
            return None;
        }
        let to_end = segment.deskewing(&Default::default());
        let points = sweep.points.iter().map(|p| p.timed());
        let points = PolePoint::of_sweep(points, &to_end, &segment.end().rotation, &self.settings);
        let in_map = self.sweeps.iter().rev().flat_map(|sweep| {
            let there = to_f32(&(map_from_local * sweep.local_from_tracking));
            sweep.points.iter().map(move |p| there * p)
        });
        Some(PolesToRegister { map: PoleMap::new(in_map, &self.settings), points })
    }

    /// Keeps those of a sweep that was registered, as seen from its end.
    pub fn add(&mut self, end: Time, local_from_tracking: Rigid3, points: Vec<Point3f>) {
        self.sweeps.push_back(PolesOfSweep { end, local_from_tracking, points });
        let is_old = |first: &PolesOfSweep| end.seconds_since(first.end) > self.settings.memory;
        while self.sweeps.front().is_some_and(is_old) {
            self.sweeps.pop_front();
        }
    }
}
