//! Makes sections of a trajectory, and pairs their points.

use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use portolan_registration::{Link, ScanCloud, links_by_overlap};
use rayon::prelude::*;

use super::SemiRigidOptions;
use crate::continuous::Session;
use portolan_spatial::reduce_indices;

/// Number of neighbours that determine the normal of a point.
const NORMAL_NEIGHBOURS: usize = 10;
/// Maximum distance of these neighbours, in edges of a voxel.
const NORMAL_REACH: f64 = 5.0;
/// Minimum planarity of the neighbourhood of a paired point.
const LEAST_PLANARITY: f32 = 0.3;
/// Minimum cosine between the normals of a pair: both sides of a wall are different surfaces.
const LEAST_COSINE: f64 = 0.9;

/// Points around one element of the trajectory, joined.
pub(super) struct Section {
    /// Time of the middle, seconds.
    pub middle: f64,
    /// In the frame of the trajectory at the middle.
    pub cloud: ScanCloud,
    /// The same raw points: time, and position in the tracking frame.
    pub measured: Vec<(f64, [f32; 3])>,
}

/// Indices of two corresponding points of two sections.
pub(super) type PointPair = [u32; 2];

/// A pair in the world: both points, and the normal of the surface.
pub(super) struct PlacedPair {
    pub a: Vector3,
    pub b: Vector3,
    pub normal: Vector3,
}

/// The sections of a trajectory, and which of them overlap.
pub(super) struct Sections {
    pub sections: Vec<Section>,
    pub links: Vec<Link>,
}

impl Sections {
    /// Joins the points around every `interval`-th element with the current trajectory, one in each voxel.
    pub fn of(session: &Session, options: &SemiRigidOptions) -> Self {
        let interval = options.interval as f64 * options.element;
        let count = (session.trajectory.duration() / interval).floor() as usize + 1;
        let section = |i: usize| Section::of(session, i as f64 * interval, options);
        let sections: Vec<Section> = (0..count).into_par_iter().map(section).collect();
        let mut all = Self { sections, links: Vec::new() };
        let clouds: Vec<&ScanCloud> = all.sections.iter().map(|s| &s.cloud).collect();
        all.links = links_by_overlap(&clouds, &all.poses(session), options.min_pairs, options.max_distance);
        all
    }

    /// Current poses of the sections as rigid bodies.
    pub fn poses(&self, session: &Session) -> Vec<Rigid3> {
        self.sections.iter().map(|s| session.trajectory.pose(s.middle)).collect()
    }

    /// At most `count` points of the later section of a link, spread over it.
    pub fn queries(&self, link: Link, count: usize) -> Vec<u32> {
        let all = self.sections[link.to].measured.len();
        let stride = all.div_ceil(count.max(1)).max(1);
        // Links begin at different points, so that together they use all.
        let first = (link.from * 7 + link.to * 13) % stride;
        (first..all).step_by(stride).map(|i| i as u32).collect()
    }

    /// For points of the later section of a link, the nearest point of the earlier one that was recorded long
    /// enough before or after, if both are on the same side of a surface.
    pub fn pairs(
        &self,
        link: Link,
        poses: &[Rigid3],
        queries: &[u32],
        options: &SemiRigidOptions,
    ) -> Vec<PointPair> {
        let (from, to) = (&self.sections[link.from], &self.sections[link.to]);
        let a_from_b = poses[link.from].inverse() * poses[link.to];
        let apart = options.time_window as f64 * options.element;
        let reach = 2.0 * options.half_width as f64 * options.element;
        // Sections far apart in time have no points that are close in time.
        let is_free = (to.middle - from.middle).abs() > apart + reach;
        let max_distance = options.max_distance as f32;
        let facing = |section: &Section, i: u32| {
            let surface = section.cloud.surface(i as usize).filter(|s| s.planarity > LEAST_PLANARITY)?;
            Some(Vector3::from(surface.normal.map(f64::from)))
        };
        let partner = |b: u32| -> Option<PointPair> {
            let normal = a_from_b.rotation * facing(to, b)?;
            let x = a_from_b * na::Point3::from(to.cloud.points()[b as usize].map(f64::from));
            let query = [x.x as f32, x.y as f32, x.z as f32];
            let seconds = to.measured[b as usize].0;
            let is_apart = |a: u32| is_free || (from.measured[a as usize].0 - seconds).abs() >= apart;
            let a = from.cloud.nearest_where(query, max_distance, is_apart)?.index;
            (facing(from, a)?.dot(&normal) > LEAST_COSINE).then_some([a, b])
        };
        queries.iter().filter_map(|b| partner(*b)).collect()
    }

    /// A pair with its sections moved as rigid bodies.
    pub fn place(&self, link: Link, poses: &[Rigid3], [a, b]: PointPair) -> PlacedPair {
        let point = |section: usize, i: u32| {
            let local = self.sections[section].cloud.points()[i as usize].map(f64::from);
            (poses[section] * na::Point3::from(local)).coords
        };
        let normal = self.normal(link, poses, [a, b]);
        PlacedPair { a: point(link.from, a), b: point(link.to, b), normal }
    }

    /// The mean of both normals of a pair.
    pub fn normal(&self, link: Link, poses: &[Rigid3], [a, b]: PointPair) -> Vector3 {
        let normal = |section: usize, i: u32| {
            let surface = self.sections[section].cloud.surface(i as usize);
            surface.map_or_else(Vector3::zeros, |s| {
                poses[section].rotation * Vector3::from(s.normal.map(f64::from))
            })
        };
        (normal(link.from, a) + normal(link.to, b)).normalize()
    }
}

impl Section {
    fn of(session: &Session, middle: f64, options: &SemiRigidOptions) -> Self {
        let half = options.half_width as f64 * options.element;
        let section_from_world = session.trajectory.pose(middle).inverse();
        let (mut joined, mut measured) = (Vec::new(), Vec::new());
        session.for_each_point([middle - half, middle + half], |seconds, in_tracking, in_world| {
            let p = section_from_world * na::Point3::from(in_world);
            joined.push([p.x as f32, p.y as f32, p.z as f32]);
            measured.push((seconds, in_tracking));
        });
        let kept = reduce_indices(&joined, options.voxel as f32, 1);
        let points = kept.iter().map(|i| joined[*i as usize]).collect();
        let reach = (NORMAL_REACH * options.voxel) as f32;
        Self {
            middle,
            cloud: ScanCloud::with_surfaces(points, NORMAL_NEIGHBOURS, reach).with_normals_towards([0.0; 3]),
            measured: kept.iter().map(|i| measured[*i as usize]).collect(),
        }
    }
}
