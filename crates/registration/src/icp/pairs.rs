//! Finds corresponding points.

use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use rayon::prelude::*;

use super::{IcpError, IcpOptions};
use crate::ScanCloud;
use crate::model::{Model, ModelPoint};

/// Number of points processed by one thread at a time; part of the definition of the sums.
pub(super) const CHUNK: usize = 1024;
/// Factor for the distance to other points in the test whether a previous partner is kept: single precision
/// is not exact.
const SURE: f32 = 0.999;
/// Number of points from which the distance of two scans is determined.
const SAMPLE: usize = 2000;

/// A pair of points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    pub model: ModelPoint,
    pub data: u32,
    pub distance: f32,
}

/// Result of the last search for a point.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Position of the point then, metres, frame of the model.
    place: [f32; 3],
    partner: ModelPoint,
    /// Lower bound of the distance of all other points of the model from there, metres.
    others: f32,
}

/// Finds pairs repeatedly while a scan moves. A point keeps its partner without a search if it has moved by
/// less than the partner is nearer than all others (triangle inequality), so that the last iterations cost
/// little.
pub(super) struct Pairing<'a, M> {
    pub model: &'a M,
    pub data: &'a ScanCloud,
    options: &'a IcpOptions,
    seen: Vec<Option<Seen>>,
}

impl<'a, M: Model> Pairing<'a, M> {
    pub fn new(model: &'a M, data: &'a ScanCloud, options: &'a IcpOptions) -> Self {
        Self { model, data, options, seen: vec![None; data.points().len()] }
    }

    /// Strides of the points that are used: a larger one first, finally that of the options.
    pub fn strides(&self) -> Vec<usize> {
        let last = self.options.every.max(1);
        let points = self.data.points().len() / last;
        match self.options.first_points {
            0 => vec![last],
            first if points < 2 * first => vec![last],
            // A prime, so that the chosen points do not all come from the same ring of a scanner.
            first => vec![last * next_prime(points / first), last],
        }
    }

    /// Pairs of every `stride`-th point at a pose of the data scan.
    pub fn find(&mut self, pose: &Rigid3, stride: usize) -> Vec<Match> {
        let back = pose.inverse();
        let (model, data, options) = (self.model, self.data, self.options);
        // Chunks begin at multiples of the stride.
        let chunk = CHUNK * stride;
        let parts: Vec<Vec<Match>> = self
            .seen
            .par_chunks_mut(chunk)
            .enumerate()
            .map(|(number, seen)| {
                let mut matches = Vec::with_capacity(CHUNK);
                for (i, seen) in seen.iter_mut().enumerate().step_by(stride) {
                    let index = number * chunk + i;
                    let x = moved(pose, data.points()[index]);
                    let query = [x.x as f32, x.y as f32, x.z as f32];
                    let Some((at, distance)) = partner(model, query, options.max_distance as f32, seen)
                    else {
                        continue;
                    };
                    if is_accepted(model, data, pose, &back, (at, index), options) {
                        matches.push(Match { model: at, data: index as u32, distance });
                    }
                }
                matches
            })
            .collect();
        let mut matches = parts.concat();
        if options.keep > 0.0 && options.keep < 1.0 {
            let count = (matches.len() as f64 * options.keep).ceil() as usize;
            matches.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.data.cmp(&b.data)));
            matches.truncate(count);
        }
        matches
    }

    /// The error if there are too few pairs.
    pub fn too_few(&self, pose: &Rigid3, found: usize, stride: usize) -> IcpError {
        let points = self.data.points();
        let step = points.len().div_ceil(SAMPLE).max(1);
        let distance = |p: &[f32; 3]| {
            let x = moved(pose, *p);
            self.model
                .hit([x.x as f32, x.y as f32, x.z as f32], f32::INFINITY)
                .map(|hit| f64::from(hit.distance))
        };
        let nearest = points.iter().step_by(step).filter_map(distance).min_by(f64::total_cmp);
        IcpError::TooFewPairs {
            found,
            points: points.len().div_ceil(stride),
            max_distance: self.options.max_distance,
            nearest,
        }
    }
}

/// The smallest prime that is not below a number.
fn next_prime(number: usize) -> usize {
    let is_prime = |n: &usize| (2..).take_while(|d| d * d <= *n).all(|d| !n.is_multiple_of(d));
    (number.max(2)..).find(is_prime).unwrap_or(number)
}

/// The nearest point of the model and its distance; the result of the last search replaces a new one where
/// possible.
fn partner<M: Model>(
    model: &M,
    query: [f32; 3],
    max_distance: f32,
    seen: &mut Option<Seen>,
) -> Option<(ModelPoint, f32)> {
    if let Some(before) = seen {
        let place = model.place(before.partner);
        let distance = norm(std::array::from_fn(|k| place[k] as f32 - query[k]));
        let moved = norm(std::array::from_fn(|k| query[k] - before.place[k]));
        if distance < SURE * (before.others - moved) && distance <= max_distance {
            return Some((before.partner, distance));
        }
    }
    match model.hit(query, max_distance) {
        Some(hit) => {
            *seen = Some(Seen { place: query, partner: hit.at, others: hit.others });
            Some((hit.at, hit.distance))
        }
        None => {
            *seen = None;
            None
        }
    }
}

fn norm(v: [f32; 3]) -> f32 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

pub(super) fn moved(pose: &Rigid3, p: [f32; 3]) -> Vector3 {
    (pose * na::Point3::from(p.map(f64::from))).coords
}

fn is_accepted<M: Model>(
    model: &M,
    data: &ScanCloud,
    pose: &Rigid3,
    back: &Rigid3,
    (m, d): (ModelPoint, usize),
    options: &IcpOptions,
) -> bool {
    if options.least_cosine > -1.0
        && let (Some(a), Some(b)) = (model.normal(m), data.surface(d))
        && a.dot(&(pose.rotation * Vector3::from(b.normal.map(f64::from)))).abs() < options.least_cosine
    {
        return false;
    }
    if !options.reciprocal {
        return true;
    }
    let x = back * na::Point3::from(model.place(m));
    let query = [x.x as f32, x.y as f32, x.z as f32];
    data.nearest(query, options.max_distance as f32).is_some_and(|hit| hit.index as usize == d)
}
