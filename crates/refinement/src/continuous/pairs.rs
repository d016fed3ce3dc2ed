//! Pairs surfels of different windows that are probably the same surface.

use portolan_geometry::{Vector3, nalgebra as na};
use rayon::prelude::*;

use super::correction::Corrections;
use super::dense_trajectory::DenseTrajectory;
use super::surfels::SurfelMap;
use portolan_spatial::KdTree;

/// Maximum number of windows that each window is compared with, besides its neighbours in time.
const MAX_PARTNERS: usize = 20;
/// Number of windows before and after that count as neighbours in time.
const NEIGHBOURS: usize = 2;
/// Maximum number of surfels of a window for which a partner in each other window is searched.
const MAX_QUERIES: usize = 500;
/// Maximum distance of a partner along the surface, metres (more if drift may be larger).
const REACH: f32 = 1.0;
/// Minimum cosine between the normals of a pair.
const LEAST_COSINE: f64 = 0.94;

/// A surfel in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedSurfel {
    /// Time at which it was measured.
    pub seconds: f64,
    pub mean: Vector3,
    pub normal: Vector3,
    /// Position of the tracking frame at that time.
    pub seen_from: Vector3,
}

/// Two surfels that should be in one plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    pub a: u32,
    pub b: u32,
    /// Mean of both normals.
    pub normal: Vector3,
    /// `normal · (a − b)`, metres.
    pub distance: f64,
    /// Distance of both along the surface, metres.
    pub aside: f64,
}

/// Places all surfels with the current trajectory.
pub(crate) fn place(
    map: &SurfelMap,
    corrections: &Corrections,
    trajectory: &DenseTrajectory,
) -> Vec<PlacedSurfel> {
    map.surfels
        .par_iter()
        .map(|surfel| {
            let sensor = usize::from(surfel.sensor);
            let correction = corrections.of(sensor);
            let seconds = surfel.seconds + correction.delay;
            let pose = trajectory.pose(seconds);
            let mean = correction.tracking_from_assumed * na::Point3::from(surfel.mean_in_tracking);
            PlacedSurfel {
                seconds,
                mean: (pose * mean).coords,
                normal: pose.rotation * corrections.turn(sensor, &surfel.normal_in_tracking),
                seen_from: pose.translation.vector,
            }
        })
        .collect()
}

/// For each surfel (of a spread selection) the nearest partner in each of the windows that may contain the
/// same surfaces (those at most `horizon` numbers away, if given): with a similar normal, and at most `gate`
/// metres away across the surface.
pub(crate) fn find_pairs(
    map: &SurfelMap,
    placed: &[PlacedSurfel],
    gate: f64,
    horizon: Option<usize>,
) -> Vec<Pair> {
    let origin = placed.first().map_or_else(Vector3::zeros, |s| s.mean);
    let near = |p: &Vector3| -> [f32; 3] { std::array::from_fn(|k| (p[k] - origin[k]) as f32) };
    let trees: Vec<KdTree> = map
        .windows
        .par_iter()
        .map(|w| KdTree::new(&placed[w.surfels.clone()].iter().map(|s| near(&s.mean)).collect::<Vec<_>>()))
        .collect();
    let spheres: Vec<Option<Sphere>> =
        map.windows.iter().map(|w| Sphere::around(&placed[w.surfels.clone()])).collect();
    let reach = REACH.max(gate as f32);
    let found: Vec<Vec<Pair>> = (0..map.windows.len())
        .into_par_iter()
        .map(|window| {
            let range = map.windows[window].surfels.clone();
            let stride = range.len().div_ceil(MAX_QUERIES).max(1);
            let mut pairs = Vec::new();
            for partner in partners(map, &spheres, window, gate, horizon) {
                let others = map.windows[partner].surfels.clone();
                for a in range.clone().step_by(stride) {
                    let query = &placed[a];
                    let is_alike = |b: u32| {
                        let other = &placed[others.start + b as usize];
                        other.normal.dot(&query.normal) > LEAST_COSINE
                            && (other.normal + query.normal).dot(&(query.mean - other.mean)).abs()
                                < 2.0 * gate
                    };
                    let Some(hit) = trees[partner].nearest_where(near(&query.mean), reach, is_alike) else {
                        continue;
                    };
                    let b = others.start + hit.index as usize;
                    let normal = (placed[b].normal + query.normal).normalize();
                    let apart = query.mean - placed[b].mean;
                    let distance = normal.dot(&apart);
                    let aside = (apart - normal * distance).norm();
                    pairs.push(Pair { a: a as u32, b: b as u32, normal, distance, aside });
                }
            }
            pairs
        })
        .collect();
    found.concat()
}

/// Sphere around the surfaces of a window.
#[derive(Clone, Copy, Debug)]
struct Sphere {
    centre: Vector3,
    radius: f64,
    place: Vector3,
}

impl Sphere {
    fn around(surfels: &[PlacedSurfel]) -> Option<Self> {
        let count = surfels.len() as f64;
        let place = surfels.get(surfels.len() / 2)?.seen_from;
        let centre = surfels.iter().map(|s| s.mean).sum::<Vector3>() / count;
        let mut distances: Vec<f64> = surfels.iter().map(|s| (s.mean - centre).norm()).collect();
        // Contains most of them: single far patches must not make all windows partners.
        distances.sort_by(f64::total_cmp);
        Some(Self { centre, radius: distances[distances.len() * 4 / 5], place })
    }
}

/// Windows to compare with: the neighbours in time, and those seen from nearby positions, spread over time.
fn partners(
    map: &SurfelMap,
    spheres: &[Option<Sphere>],
    window: usize,
    gate: f64,
    horizon: Option<usize>,
) -> Vec<usize> {
    let Some(own) = spheres[window] else { return Vec::new() };
    let mut near: Vec<(f64, usize)> = Vec::new();
    let mut partners: Vec<usize> = Vec::new();
    let number = |window: usize| map.windows[window].number;
    let is_other = |other: &usize| number(*other) != number(window);
    for (other, sphere) in spheres.iter().enumerate().filter(|(other, _)| is_other(other)) {
        let Some(sphere) = sphere else { continue };
        if number(other).abs_diff(number(window)) <= horizon.unwrap_or(NEIGHBOURS) {
            partners.push(other);
        } else if horizon.is_none() && (sphere.centre - own.centre).norm() < sphere.radius + own.radius + gate
        {
            near.push(((sphere.place - own.place).norm(), other));
        }
    }
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    partners.extend(near.into_iter().take(MAX_PARTNERS).map(|(_, other)| other));
    partners.sort_unstable();
    partners
}
