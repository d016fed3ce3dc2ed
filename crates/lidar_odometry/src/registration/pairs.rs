//! Pairs the points of a scan with planes.

use std::ops::Range;

use nalgebra as na;
use portolan_geometry::Point3f;
use portolan_sensor::TimedPoint;

use crate::deskew::PiecewiseLinearTrajectory;
use crate::plane_map::{BATCH, Plane, PlaneMap};

/// Number of points whose planes are looked up together.
pub(super) const AT_ONCE: usize = BATCH;

/// The plane that a point was paired with, and the position of the point at that time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pair {
    looked_up_at: na::Vector3<f32>,
    pub plane: Option<Plane>,
}

/// The pairs of all points, kept from one iteration to the next.
pub(super) struct Pairs {
    pub pairs: Vec<Pair>,
    /// Squared displacement above which a point is paired again, m².
    squared_slack: f32,
}

/// Ray of a point on a trajectory, in the frame of the planes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ray {
    /// From the scanner to the point.
    pub turned: na::Vector3<f32>,
    /// The point.
    pub place: na::Vector3<f32>,
}

impl Pairs {
    /// Initially nothing is paired; points that move by more than `slack` metres are paired again.
    pub fn new(num_points: usize, slack: f32) -> Self {
        let nowhere = Pair { looked_up_at: na::Vector3::repeat(f32::INFINITY), plane: None };
        Self { pairs: vec![nowhere; num_points], squared_slack: slack.powi(2) }
    }

    /// Computes the rays of at most [`AT_ONCE`] of the points on a trajectory, into `rays`, and pairs
    /// those that moved with planes.
    pub fn renew(
        &mut self,
        range: Range<usize>,
        points: &[TimedPoint],
        planes: &PlaneMap,
        trajectory: &PiecewiseLinearTrajectory,
        rays: &mut [Ray; AT_ONCE],
    ) {
        let (points, pairs) = (&points[range.clone()], &mut self.pairs[range]);
        let (mut moved, mut num_moved) = ([0; AT_ONCE], 0);
        let mut places = [(Point3f::origin(), na::Vector3::zeros()); AT_ONCE];
        for (i, ((ray, point), pair)) in rays.iter_mut().zip(points).zip(&*pairs).enumerate() {
            let (turned, from) = trajectory.ray(&point.position, point.time);
            *ray = Ray { turned, place: turned + from };
            if (ray.place - pair.looked_up_at).norm_squared() > self.squared_slack {
                let toward = turned.try_normalize(1e-6).map_or_else(na::Vector3::zeros, |v| -v);
                (moved[num_moved], places[num_moved]) = (i, (ray.place.into(), toward));
                num_moved += 1;
            }
        }
        if num_moved == 0 {
            return;
        }
        let planes = planes.planes_seen(&places[..num_moved]);
        for ((i, (place, _)), plane) in moved[..num_moved].iter().zip(&places).zip(planes) {
            pairs[*i] = Pair { looked_up_at: place.coords, plane };
        }
    }
}
