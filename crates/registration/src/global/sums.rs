//! Sums up the pairs of a link for every parametrisation.

use nalgebra::{Matrix3, SMatrix, SVector};
use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use rayon::prelude::*;

use super::GlobalOptions;
use crate::{Link, LinkStatistics, ScanCloud};
use portolan_spatial::PairMoments;

/// Minimum planarity of the neighbourhood of a point that is used as a plane.
const LEAST_PLANARITY: f32 = 0.3;
/// Number of points processed by one thread at a time; part of the definition of the sums.
const CHUNK: usize = 4096;
/// Minimum cosine between the normals of a pair.
const LEAST_COSINE: f64 = 0.9;

/// Sums over the pairs (p of the earlier, q of the later scan; world) of a link.
#[derive(Clone, Debug)]
pub(crate) struct LinkSums {
    pub statistics: LinkStatistics,
    /// Moments of the pairs, with p as model and q as data.
    pub pairs: PairMoments,
    /// Σ p pᵀ.
    pub model_model: Matrix3<f64>,
    /// Normal equations of translation, scale and rotation about the midpoints (section 2.4).
    pub matrix7: SMatrix<f64, 7, 7>,
    pub vector7: SVector<f64, 7>,
}

impl LinkSums {
    /// Pairs each point of the later scan (at most `max_queries` of them) with the nearest point of the
    /// earlier one. Parts are summed up on all threads and added in their order.
    pub fn of(scans: &[ScanCloud], poses: &[Rigid3], link: Link, options: &GlobalOptions) -> Self {
        let count = scans[link.to].points().len();
        let stride = count.div_ceil(options.max_queries.max(1)).max(1);
        // Links start at different points, so that together they use all.
        let first = (link.from * 7 + link.to * 13) % stride;
        let queries: Vec<usize> = (first..count).step_by(stride).collect();
        let part = |queries: &[usize]| Self::of_points(scans, poses, link, options, queries);
        if queries.len() <= CHUNK {
            return part(&queries);
        }
        let parts: Vec<Self> = queries.par_chunks(CHUNK).map(part).collect();
        let mut sums = Self::empty();
        parts.iter().for_each(|part| sums.merge(part));
        sums
    }

    /// Pairs of some points of the later scan.
    fn of_points(
        scans: &[ScanCloud],
        poses: &[Rigid3],
        link: Link,
        options: &GlobalOptions,
        queries: &[usize],
    ) -> Self {
        let mut sums = Self::empty();
        let (from, to) = (&scans[link.from], &scans[link.to]);
        let (world_from_a, world_from_b) = (&poses[link.from], &poses[link.to]);
        let a_from_b = world_from_a.inverse() * world_from_b;
        for index in queries.iter().copied() {
            let local = na::Point3::from(to.points()[index].map(f64::from));
            let x = a_from_b * local;
            let query = [x.x as f32, x.y as f32, x.z as f32];
            let Some(hit) = from.nearest(query, options.max_distance as f32) else { continue };
            let near = from.points()[hit.index as usize].map(f64::from);
            let (p, q) = ((world_from_a * na::Point3::from(near)).coords, (world_from_b * local).coords);
            if options.planes {
                let normal = |cloud: &ScanCloud, index: usize, pose: &Rigid3| {
                    let surface = cloud.surface(index).filter(|s| s.planarity > LEAST_PLANARITY)?;
                    Some(pose.rotation * Vector3::from(surface.normal.map(f64::from)))
                };
                let own = normal(to, index, world_from_b);
                let other = normal(from, hit.index as usize, world_from_a);
                if let (Some(a), Some(b)) = (other, own)
                    && a.dot(&b) > LEAST_COSINE
                {
                    let normal = (a + b).normalize();
                    let weight = options.kernel.weight(normal.dot(&(p - q)).abs());
                    sums.statistics.add_plane(&p, &q, &normal, weight);
                }
                continue;
            }
            sums.add(&p, &q, options.method == super::GlobalMethod::Quaternion);
        }
        sums
    }

    /// No pairs.
    pub fn empty() -> Self {
        Self {
            statistics: LinkStatistics::default(),
            pairs: PairMoments::default(),
            model_model: Matrix3::zeros(),
            matrix7: SMatrix::zeros(),
            vector7: SVector::zeros(),
        }
    }

    /// Adds the pairs of another part of the link.
    fn merge(&mut self, other: &Self) {
        self.statistics.merge(&other.statistics);
        self.pairs.merge(&other.pairs);
        self.model_model += other.model_model;
        self.matrix7 += other.matrix7;
        self.vector7 += other.vector7;
    }

    /// Adds a pair.
    pub fn add(&mut self, p: &Vector3, q: &Vector3, with_scale: bool) {
        self.statistics.add(p, q);
        self.pairs.add(p, q, 1.0);
        self.model_model += p * p.transpose();
        if with_scale {
            let (m, z) = ((p + q) * 0.5, p - q);
            let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
            jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
            jacobian.fixed_view_mut::<3, 1>(0, 3).copy_from(&m);
            jacobian.fixed_view_mut::<3, 3>(0, 4).copy_from(&m.cross_matrix());
            self.matrix7 += jacobian.transpose() * jacobian;
            self.vector7 += jacobian.transpose() * z;
        }
    }
}
