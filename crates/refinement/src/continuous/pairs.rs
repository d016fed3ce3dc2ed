//! Pairs of surfels of different windows that are probably the same surface.

use portolan_geometry::Vector3;
use rayon::prelude::*;

use super::dense_trajectory::DenseTrajectory;
use super::surfels::SurfelMap;
use crate::neighbours::KdTree;

/// Windows that each window is compared with at most, besides its neighbours in time.
const MAX_PARTNERS: usize = 20;
/// Surfels of a window that look for a partner in each other window.
const MAX_QUERIES: usize = 500;
/// Farther along the surface a partner is not looked for, metres.
const REACH: f32 = 1.5;
/// Least cosine between the normals of a pair.
const LEAST_COSINE: f64 = 0.85;

/// A surfel in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlacedSurfel {
    pub mean: Vector3,
    pub normal: Vector3,
    /// Position of the tracking frame when it was seen.
    pub seen_from: Vector3,
}

/// Two surfels that should lie in one plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pair {
    pub a: u32,
    pub b: u32,
    /// Mean of both normals.
    pub normal: Vector3,
    /// `normal · (a − b)`, metres.
    pub distance: f64,
}

/// All surfels with the current trajectory.
pub(crate) fn place(map: &SurfelMap, trajectory: &DenseTrajectory) -> Vec<PlacedSurfel> {
    map.surfels
        .par_iter()
        .map(|surfel| {
            let pose = trajectory.pose(surfel.seconds);
            PlacedSurfel {
                mean: pose.rotation * surfel.mean_in_tracking + pose.translation.vector,
                normal: pose.rotation * surfel.normal_in_tracking,
                seen_from: pose.translation.vector,
            }
        })
        .collect()
}

/// For each surfel (of a spread choice) its nearest partner in each of the windows that may have seen the same
/// surfaces: of like normal, and at most `gate` metres away across the surface.
pub(crate) fn find_pairs(map: &SurfelMap, placed: &[PlacedSurfel], gate: f64) -> Vec<Pair> {
    let origin = placed.first().map_or_else(Vector3::zeros, |s| s.mean);
    let near = |p: &Vector3| -> [f32; 3] { std::array::from_fn(|k| (p[k] - origin[k]) as f32) };
    let trees: Vec<KdTree> = map
        .windows
        .par_iter()
        .map(|range| KdTree::new(&placed[range.clone()].iter().map(|s| near(&s.mean)).collect::<Vec<_>>()))
        .collect();
    let spheres: Vec<Option<Sphere>> =
        map.windows.iter().map(|range| Sphere::around(&placed[range.clone()])).collect();
    let reach = REACH.max(gate as f32);
    let found: Vec<Vec<Pair>> = (0..map.windows.len())
        .into_par_iter()
        .map(|window| {
            let range = map.windows[window].clone();
            let stride = range.len().div_ceil(MAX_QUERIES).max(1);
            let mut pairs = Vec::new();
            for partner in partners(&spheres, window, gate) {
                let others = map.windows[partner].clone();
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
                    let distance = normal.dot(&(query.mean - placed[b].mean));
                    pairs.push(Pair { a: a as u32, b: b as u32, normal, distance });
                }
            }
            pairs
        })
        .collect();
    found.concat()
}

/// What a window saw lies within a sphere.
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
        // Most of it: single far patches shall not make everything a partner of everything.
        distances.sort_by(f64::total_cmp);
        Some(Self { centre, radius: distances[distances.len() * 4 / 5], place })
    }
}

/// Windows to compare with: the neighbours in time, and those seen from near places, spread over time.
fn partners(spheres: &[Option<Sphere>], window: usize, gate: f64) -> Vec<usize> {
    let Some(own) = spheres[window] else { return Vec::new() };
    let mut near: Vec<(f64, usize)> = Vec::new();
    let mut partners: Vec<usize> = Vec::new();
    for (other, sphere) in spheres.iter().enumerate().filter(|(other, _)| *other != window) {
        let Some(sphere) = sphere else { continue };
        if other.abs_diff(window) <= 2 {
            partners.push(other);
        } else if (sphere.centre - own.centre).norm() < sphere.radius + own.radius + gate {
            near.push(((sphere.place - own.place).norm(), other));
        }
    }
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    partners.extend(near.into_iter().take(MAX_PARTNERS).map(|(_, other)| other));
    partners.sort_unstable();
    partners
}
