//! The hits in one voxel: how many, their mean and spread, and the plane through them.

use nalgebra as na;
use portolan_geometry::Point3f;

use crate::map::{Doubt, Plane};

/// Fewer hits make no plane.
const MIN_COUNT: u16 = 6;
/// More hits change nothing: what a place looks like is known by then.
const MAX_COUNT: u16 = 400;
/// A plane is at most this share of the edge of its voxel thick (standard deviation), and this much more.
const MAX_THICKNESS_SHARE: f32 = 0.04;
const MAX_THICKNESS: f32 = 0.02;
/// Hits spread along both directions of a plane at least this many times more than across it, and over
/// this share of the edge of the voxel.
const MIN_SPREAD_RATIO: f32 = 3.0;
const MIN_SPREAD_SHARE: f32 = 0.06;

/// Hits of one sweep share their errors, so that so many count as one.
const HITS_PER_INDEPENDENT_ONE: f32 = 6.0;

/// Cosine of the angle at which hits of one beam lie in the cone on which that beam turns, whatever it meets: a
/// carrier tilts by so much, radians.
const EDGE_ON: f32 = 0.03;

/// A plane with a steeper normal than this (its sine; 30° from the vertical) is ground. Walls, cars and crowns of trees
/// may look down a bit, and so do planes of treads of stairs that are gone down: where these were doubted (0.7), one of
/// three walks over stairs lost 0.2 m of height.
const LEVEL: f32 = 0.87;

/// Cosine of the angle at which a plane is seen edge-on: its side is not known then.
const MIN_SIDE: f32 = 0.1;

/// Statistics of the hits in a voxel and the normal of their plane, all that most hits need, in one line of the cache.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct SurfaceCell {
    pub mean: na::Vector3<f32>,
    /// Sum of outer products of differences from the mean: xx, xy, xz, yy, yz, zz.
    scatter: [f32; 6],
    /// Sum of unit vectors from the hits to where they were seen from.
    toward: na::Vector3<f32>,
    /// To the side from which the hits were seen, if that is one.
    pub normal: na::Vector3<f32>,
    pub count: u16,
    pub is_plane: bool,
    /// Whether the hits were seen from one side of the plane.
    pub is_one_sided: bool,
}

const _: () = assert!(size_of::<SurfaceCell>() == 64);

/// How well the plane of a cell is known.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fit {
    /// Mean square distance of the hits from the plane.
    pub variance: f32,
    /// Square of how far the normal may be off for the noise of the hits, rad².
    pub normal_variance: f32,
    pub doubt: Option<Doubt>,
}

/// Whether so many hits are fitted: a third more than last time.
const IS_FITTED: [bool; MAX_COUNT as usize + 1] = {
    let mut is_fitted = [false; MAX_COUNT as usize + 1];
    let mut count = MIN_COUNT as usize;
    while count < is_fitted.len() {
        is_fitted[count] = true;
        count += count / 3;
    }
    is_fitted
};

impl SurfaceCell {
    pub fn new() -> Self {
        Self {
            mean: na::Vector3::zeros(),
            scatter: [0.0; 6],
            toward: na::Vector3::zeros(),
            normal: na::Vector3::zeros(),
            count: 0,
            is_plane: false,
            is_one_sided: false,
        }
    }

    /// The plane, if [`Self::is_plane`].
    #[inline]
    pub fn plane(&self, fit: &Fit) -> Plane {
        Plane {
            point: self.mean,
            normal: self.normal,
            variance: fit.variance,
            normal_variance: fit.normal_variance,
            doubt: fit.doubt,
        }
    }

    /// Whether a hit seen from the direction `toward` (unit length) shows the other side of the plane.
    #[inline]
    pub fn shows_other_side(&self, toward: &na::Vector3<f32>) -> bool {
        self.is_one_sided && self.normal.dot(toward) < -MIN_SIDE
    }

    /// Counts a hit (Welford's update) seen from the direction `toward` (unit length, or zero if that is not
    /// known), and fits the plane anew, into `fit`, each time the hits are a third more.
    #[inline]
    pub fn add(&mut self, point: &Point3f, toward: &na::Vector3<f32>, edge: f32, fit: &mut Fit) {
        if self.count >= MAX_COUNT {
            return;
        }
        self.count += 1;
        self.toward += toward;
        let before = point.coords - self.mean;
        self.mean += before * (1.0 / f32::from(self.count));
        let after = point.coords - self.mean;
        let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        for (sum, (i, j)) in self.scatter.iter_mut().zip(pairs) {
            *sum += before[i] * after[j];
        }
        if IS_FITTED[usize::from(self.count)] {
            *fit = self.fitted(edge);
        }
    }

    fn fitted(&mut self, edge: f32) -> Fit {
        let count = f32::from(self.count);
        let [xx, xy, xz, yy, yz, zz] = self.scatter.map(|s| f64::from(s) / f64::from(self.count));
        let covariance = na::Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let (values, normal) = smallest_direction(&covariance);
        let thickness = MAX_THICKNESS + MAX_THICKNESS_SHARE * edge;
        let [across, along] = [values[0].max(0.0) as f32, values[1] as f32];
        self.is_plane = across <= thickness * thickness
            && along >= MIN_SPREAD_RATIO * MIN_SPREAD_RATIO * across
            && along >= (MIN_SPREAD_SHARE * edge) * (MIN_SPREAD_SHARE * edge);
        // Of the slope of a line fitted to that many hits, along the direction in which they spread less.
        let normal_variance = across / along.max(f32::MIN_POSITIVE) * HITS_PER_INDEPENDENT_ONE / count;
        let normal: na::Vector3<f32> = normal.cast();
        let side = normal.dot(&self.toward) / count;
        self.normal = if side < 0.0 { -normal } else { normal };
        self.is_one_sided = side.abs() > MIN_SIDE;
        let seen = self.toward.norm() / count;
        let is_edge_on = side.abs() < seen * (EDGE_ON + 2.0 * normal_variance.sqrt());
        let looks_down = self.toward.z > 0.0 && self.normal.z < -LEVEL;
        let doubt = match (looks_down, is_edge_on) {
            (true, _) => Some(Doubt::LooksDown),
            (false, true) => Some(Doubt::EdgeOn),
            (false, false) => None,
        };
        Fit { variance: across, normal_variance, doubt }
    }
}

/// Eigenvalues of a symmetric matrix in ascending order, and the eigenvector of the first (Smith,
/// "Eigenvalues of a symmetric 3 × 3 matrix", 1961).
pub(super) fn smallest_direction(m: &na::Matrix3<f64>) -> ([f64; 3], na::Vector3<f64>) {
    let third = m.trace() / 3.0;
    let centered = m - na::Matrix3::from_diagonal_element(third);
    let spread = (centered.norm_squared() / 6.0).sqrt();
    if spread <= f64::EPSILON * third.abs() || !spread.is_finite() {
        return ([third; 3], na::Vector3::z());
    }
    let angle = ((centered / spread).determinant() / 2.0).clamp(-1.0, 1.0).acos() / 3.0;
    let largest = third + 2.0 * spread * angle.cos();
    let smallest = third + 2.0 * spread * (angle + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    let values = [smallest, 3.0 * third - largest - smallest, largest];
    // Rows of m − λ are at right angles to the eigenvector: the longest of their products is the best.
    let shifted = m - na::Matrix3::from_diagonal_element(smallest);
    let rows = [0, 1, 2].map(|i| shifted.row(i).transpose());
    let candidates = [rows[0].cross(&rows[1]), rows[1].cross(&rows[2]), rows[2].cross(&rows[0])];
    let mut best = candidates[0];
    for candidate in &candidates[1..] {
        if candidate.norm_squared() > best.norm_squared() {
            best = *candidate;
        }
    }
    (values, best.try_normalize(0.0).unwrap_or_else(na::Vector3::z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_smallest_direction_is_an_eigenvector(entries in prop::array::uniform6(-2.0..2.0f64)) {
            let [a, b, c, d, e, f] = entries;
            let root = na::Matrix3::new(a, b, c, 0.0, d, e, 0.0, 0.0, f);
            let m = root.transpose() * root;
            let (values, vector) = smallest_direction(&m);
            prop_assert!(values[0] <= values[1] + 1e-9 && values[1] <= values[2] + 1e-9);
            prop_assert!((values.iter().sum::<f64>() - m.trace()).abs() < 1e-9);
            if values[1] - values[0] > 1e-2 {
                prop_assert!((m * vector - vector * values[0]).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn flat_hits_make_a_plane_and_others_do_not() {
        let mut flat = SurfaceCell::new();
        let mut line = SurfaceCell::new();
        let mut corner = SurfaceCell::new();
        let (mut flat_fit, mut fit) = (Fit::default(), Fit::default());
        let nowhere = na::Vector3::zeros();
        for i in 0..60 {
            let (u, v) = ((i % 8) as f32 * 0.1, (i / 8) as f32 * 0.1);
            let noise = [0.01, -0.01, 0.0][i % 3];
            flat.add(&Point3f::new(u, v, 0.3 + noise), &nowhere, 1.0, &mut flat_fit);
            line.add(&Point3f::new(0.1 * (i % 10) as f32, noise, 0.3), &nowhere, 1.0, &mut fit);
            let side = if i % 2 == 0 { Point3f::new(u, v, 0.0) } else { Point3f::new(0.0, v, u) };
            corner.add(&side, &nowhere, 1.0, &mut fit);
        }
        assert!(flat.is_plane && flat.normal.z.abs() > 0.999 && flat_fit.variance < 2e-4);
        assert!((flat.mean.z - 0.3).abs() < 1e-3);
        assert!(!line.is_plane && !corner.is_plane);
    }
}
