//! Residuals of vertical structures: horizontal distances to the nearest ones; of walls, perpendicular to
//! them.

use nalgebra as na;

use super::{PoleMap, PolePoint};
use crate::deskew::PiecewiseLinearTrajectory;
use crate::registration::normal_equations::Accumulator;
use crate::registration::{Part, parts_of};
use crate::segment::TrajectorySegment;

/// A paired point: its position when it was paired, and the nearest point.
#[derive(Clone, Copy)]
struct Pair {
    looked_up_at: na::Vector3<f32>,
    nearest: Option<na::Vector3<f32>>,
}

/// Points of vertical structures in a sweep, and the map that they are paired with.
pub(crate) struct PoleResiduals<'a> {
    map: &'a PoleMap,
    points: &'a [PolePoint],
    parts: Vec<Part>,
    pairs: Vec<Pair>,
    points_per_independent_one: f64,
}

impl<'a> PoleResiduals<'a> {
    /// Points in order of time, none of them paired yet.
    pub fn new(
        map: &'a PoleMap,
        points: &'a [PolePoint],
        segment: &TrajectorySegment,
        points_per_independent_one: f64,
    ) -> Self {
        let nowhere = Pair { looked_up_at: na::Vector3::repeat(f32::INFINITY), nearest: None };
        let parts = parts_of(points, |p| p.point.time, segment);
        Self { map, points, parts, pairs: vec![nowhere; points.len()], points_per_independent_one }
    }

    /// Adds their residuals on a trajectory. Gives their information about translation and rotation:
    /// `JᵀWJ` of both.
    pub fn add_to(
        &mut self,
        all: &mut Accumulator,
        trajectory: &PiecewiseLinearTrajectory,
        scale: f64,
    ) -> [na::Matrix3<f64>; 2] {
        let settings = self.map.settings();
        let mut information = [na::Matrix3::<f32>::zeros(); 2];
        let squared_scale = scale.max(settings.final_scale).powi(2) as f32;
        // Points that moved farther are paired again.
        let noise = settings.noise();
        let slack = noise / 5.0;
        for part in &self.parts {
            for i in part.points.clone() {
                let (PolePoint { point, wall_direction }, pair) = (&self.points[i], &mut self.pairs[i]);
                let (turned, from) = trajectory.ray(&point.position, point.time);
                let place = turned + from;
                if (place - pair.looked_up_at).norm_squared() > slack * slack {
                    *pair = Pair { looked_up_at: place, nearest: self.map.nearest(&place) };
                }
                let Some(nearest) = pair.nearest else { continue };
                let off = place - nearest;
                let robust = squared_scale / (squared_scale + off.xy().norm_squared());
                let weight = robust * robust / (noise * noise);
                let wall = wall_direction
                    .map(|wall| trajectory.ray(&(point.position + wall), point.time).0 - turned);
                for direction in constrained_by(wall).into_iter().flatten() {
                    let lever = turned.cross(&direction);
                    for (sum, v) in information.iter_mut().zip([direction, lever]) {
                        *sum += v * v.transpose() * weight;
                    }
                    let [n, l] = [direction, lever].map(|v| [v.x, v.y, v.z]);
                    all.add([n[0], n[1], n[2], l[0], l[1], l[2], direction.dot(&off), 0.0], weight, 0.0);
                }
            }
            all.end_part(part.growth_fractions);
        }
        information.map(|sum| sum.cast() / self.points_per_independent_one)
    }
}

/// The horizontal directions in which a point is constrained: perpendicular to its wall if it has one.
fn constrained_by(wall_direction: Option<na::Vector3<f32>>) -> [Option<na::Vector3<f32>>; 2] {
    match wall_direction {
        Some(wall) => [na::Vector3::new(-wall.y, wall.x, 0.0).try_normalize(1e-3), None],
        None => [Some(na::Vector3::x()), Some(na::Vector3::y())],
    }
}
