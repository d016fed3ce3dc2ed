//! Fits the plane through the hits in one voxel: incremental moments, fit, and reasons for an unreliable
//! plane.
//!
//! Moments are updated hit by hit (Welford 1962). The normal is the eigenvector of the smallest eigenvalue
//! of the covariance (Yuan et al., "Efficient and Probabilistic Adaptive Voxel Mapping for Accurate Online
//! LiDAR Odometry", 2022, equations 5 and 8).

use nalgebra as na;
use portolan_geometry::Point3f;

use crate::plane_map::{Plane, Unreliable};
use crate::settings::PlaneFitSettings;
use crate::settings::constants::plane_map::{MAX_HITS, MIN_HITS};

/// Moments of the hits in a voxel and the normal of their plane: all that most hits need, in one cache
/// line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct PlaneCell {
    pub mean: na::Vector3<f32>,
    /// Sum of outer products of differences from the mean: xx, xy, xz, yy, yz, zz.
    scatter: [f32; 6],
    /// Sum of unit vectors from the hits to the origins of their beams.
    toward: na::Vector3<f32>,
    /// On the side from which the hits were seen, if that is known.
    pub normal: na::Vector3<f32>,
    pub count: u16,
    pub is_plane: bool,
    /// Whether the hits were seen from one side of the plane only.
    pub is_one_sided: bool,
}

const _: () = assert!(size_of::<PlaneCell>() == 64);

/// Quality of the plane of a cell.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PlaneFit {
    /// Mean square distance of the hits from the plane.
    pub variance: f32,
    /// Variance of the normal by the noise of the hits, rad².
    pub normal_variance: f32,
    /// Reason why the plane may be an artefact of the scan pattern.
    pub unreliable: Option<Unreliable>,
}

/// Whether the plane is fitted at this number of hits: each time there are a third more than last time.
const IS_FITTED: [bool; MAX_HITS as usize + 1] = {
    let mut is_fitted = [false; MAX_HITS as usize + 1];
    let mut count = MIN_HITS as usize;
    while count < is_fitted.len() {
        is_fitted[count] = true;
        count += count / 3;
    }
    is_fitted
};

impl PlaneCell {
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

    /// A plane to which no hits are added.
    pub fn settled(mean: na::Vector3<f32>, normal: na::Vector3<f32>, count: u16, is_one_sided: bool) -> Self {
        Self { mean, normal, count, is_one_sided, is_plane: true, ..Self::new() }
    }

    /// The plane, if [`Self::is_plane`].
    #[inline]
    pub fn plane(&self, fit: &PlaneFit) -> Plane {
        Plane {
            point: self.mean,
            normal: self.normal,
            variance: fit.variance,
            normal_variance: fit.normal_variance,
            unreliable: fit.unreliable,
        }
    }

    /// Whether no further hit changes it.
    #[inline]
    pub fn is_full(&self) -> bool {
        self.count >= MAX_HITS
    }

    /// Whether it is certain to be a plane, so that smaller voxels are not needed.
    #[inline]
    pub fn is_settled(&self, settings: &PlaneFitSettings) -> bool {
        self.count > settings.settled_hits && self.is_plane
    }

    /// Whether a hit seen from the direction `toward` (unit length) shows the other side of the plane.
    #[inline]
    pub fn shows_other_side(&self, toward: &na::Vector3<f32>, settings: &PlaneFitSettings) -> bool {
        self.is_one_sided && self.normal.dot(toward) < -least_side(settings)
    }

    /// Adds a hit (Welford's update) seen from the direction `toward` (unit length, or zero if unknown),
    /// and fits the plane again, into `fit`, each time the number of hits has grown by a third.
    #[inline]
    pub fn add(
        &mut self,
        point: &Point3f,
        toward: &na::Vector3<f32>,
        edge: f32,
        settings: &PlaneFitSettings,
        fit: &mut PlaneFit,
    ) {
        if self.is_full() {
            return;
        }
        self.count += 1;
        self.toward += toward;
        let before = point.coords - self.mean;
        self.mean += before * (1.0 / f32::from(self.count));
        let after = point.coords - self.mean;
        // Written out, because a loop over pairs of axes is not always unrolled.
        let [xx, xy, xz, yy, yz, zz] = &mut self.scatter;
        *xx += before.x * after.x;
        *xy += before.x * after.y;
        *xz += before.x * after.z;
        *yy += before.y * after.y;
        *yz += before.y * after.z;
        *zz += before.z * after.z;
        if IS_FITTED[usize::from(self.count)] {
            *fit = self.fitted(edge, settings);
        }
    }

    fn fitted(&mut self, edge: f32, settings: &PlaneFitSettings) -> PlaneFit {
        let count = f32::from(self.count);
        let mean = |sum: f32| f64::from(sum) / f64::from(self.count);
        let [xx, xy, xz, yy, yz, zz] = self.scatter;
        let (xx, xy, xz, yy, yz, zz) = (mean(xx), mean(xy), mean(xz), mean(yy), mean(yz), mean(zz));
        let covariance = na::Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let thickness = settings.range_noise as f32 + settings.max_thickness_per_edge * edge;
        if is_thicker(&covariance, f64::from(thickness)) {
            self.is_plane = false;
            return PlaneFit::default();
        }
        let (values, normal) = smallest_direction(&covariance);
        let [across, along] = [values[0].max(0.0) as f32, values[1] as f32];
        let (ratio, spread) = (settings.min_spread_ratio, settings.min_spread_per_edge * edge);
        self.is_plane =
            across <= thickness * thickness && along >= ratio * ratio * across && along >= spread * spread;
        // Variance of the slope of a line fitted to this number of hits, along the direction of the
        // smaller spread.
        let normal_variance =
            across / along.max(f32::MIN_POSITIVE) * settings.hits_per_independent_one / count;
        let normal: na::Vector3<f32> = normal.cast();
        let side = normal.dot(&self.toward) / count;
        self.normal = if side < 0.0 { -normal } else { normal };
        self.is_one_sided = side.abs() > least_side(settings);
        let seen = self.toward.norm() / count;
        let is_grazed = side.abs() < seen * (settings.normal_noise as f32 + 2.0 * normal_variance.sqrt());
        let looks_down = self.toward.z > 0.0 && self.normal.z < -settings.level_normal;
        let unreliable = match (looks_down, is_grazed) {
            (true, _) => Some(Unreliable::DownwardNormal),
            (false, true) => Some(Unreliable::GrazingIncidence),
            (false, false) => None,
        };
        PlaneFit { variance: across, normal_variance, unreliable }
    }
}

/// Cosine of the angle of incidence above which the side of a plane is certain: three standard deviations
/// of its normal.
#[inline]
fn least_side(settings: &PlaneFitSettings) -> f32 {
    3.0 * settings.normal_noise as f32
}

/// Whether the smallest eigenvalue of a covariance (m²) is clearly larger than the square of a thickness,
/// metres: the covariance minus that square has positive principal minors (Sylvester's criterion). Faster
/// to compute than the eigenvalue.
fn is_thicker(covariance: &na::Matrix3<f64>, thickness: f64) -> bool {
    const CLEARLY: f64 = 1.0 + 1e-6;
    let least = CLEARLY * thickness * thickness;
    let (xx, yy, zz) = (covariance.m11 - least, covariance.m22 - least, covariance.m33 - least);
    let (xy, xz, yz) = (covariance.m12, covariance.m13, covariance.m23);
    let minor = xx * yy - xy * xy;
    let determinant = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
    // Bound of rounding errors.
    let smallest = 1e-9 * covariance.trace().powi(2);
    xx > 0.0 && minor > smallest && determinant > smallest * covariance.trace()
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
    // Rows of m − λ are perpendicular to the eigenvector: the longest of their cross products is the most
    // precise.
    let shifted = m - na::Matrix3::from_diagonal_element(smallest);
    let row = |i: usize| shifted.row(i).transpose();
    let (x, y, z) = (row(0), row(1), row(2));
    let candidates = [x.cross(&y), y.cross(&z), z.cross(&x)];
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
            for thickness in [0.01, 0.1, 0.5, 1.0] {
                let clearly = 1e-4 * m.trace();
                let is_thicker = is_thicker(&m, thickness);
                prop_assert!(!is_thicker || values[0] > thickness * thickness);
                prop_assert!(is_thicker || values[0] < thickness * thickness + clearly.max(1e-3));
            }
            if values[1] - values[0] > 1e-2 {
                prop_assert!((m * vector - vector * values[0]).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn only_flat_hits_make_a_plane() {
        let mut flat = PlaneCell::new();
        let mut line = PlaneCell::new();
        let mut corner = PlaneCell::new();
        let (mut flat_fit, mut fit) = (PlaneFit::default(), PlaneFit::default());
        let (nowhere, settings) = (na::Vector3::zeros(), PlaneFitSettings::default());
        for i in 0..60 {
            let (u, v) = ((i % 8) as f32 * 0.1, (i / 8) as f32 * 0.1);
            let noise = [0.01, -0.01, 0.0][i % 3];
            flat.add(&Point3f::new(u, v, 0.3 + noise), &nowhere, 1.0, &settings, &mut flat_fit);
            line.add(&Point3f::new(0.1 * (i % 10) as f32, noise, 0.3), &nowhere, 1.0, &settings, &mut fit);
            let side = if i % 2 == 0 { Point3f::new(u, v, 0.0) } else { Point3f::new(0.0, v, u) };
            corner.add(&side, &nowhere, 1.0, &settings, &mut fit);
        }
        assert!(flat.is_plane && flat.normal.z.abs() > 0.999 && flat_fit.variance < 2e-4);
        assert!((flat.mean.z - 0.3).abs() < 1e-3);
        assert!(!line.is_plane && !corner.is_plane);
    }
}
