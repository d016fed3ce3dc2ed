//! Matching a scan to surfaces: robust point-to-plane least squares.

use nalgebra as na;
use portolan_geometry::{Point3f, Quaternion, Rigid3, Vector3, quaternion_from_angle_axis, to_f32};

use super::map::SurfaceMap;
use sums::{Accumulator, Pairs, Sums};

mod sums;

/// How scans are matched to surfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceMatcherOptions {
    /// Noise of ranges, metres (standard deviation).
    pub range_noise: f64,
    /// Points farther than about this from their plane count little in the end, metres.
    pub final_scale: f64,
    /// Iterations at most.
    pub max_iterations: u32,
    /// How far normals of planes are off at least, radians (standard deviation): surfaces are not flat. The noise
    /// of the hits comes on top. Where scans tell no more than such errors feign, they tell nothing.
    pub normal_noise: f64,
}

impl Default for SurfaceMatcherOptions {
    fn default() -> Self {
        Self { range_noise: 0.02, final_scale: 0.1, max_iterations: 20, normal_noise: 0.03 }
    }
}

/// Where the scan is believed to be before matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePrior {
    /// Frame of the scan in that of the surfaces.
    pub pose: Rigid3,
    /// Standard deviation of the translation along each axis, metres.
    pub translation_sigma: f64,
    /// Standard deviation of the rotation about each axis, radians.
    pub rotation_sigma: f64,
}

/// Unit vectors of the directions in which a scan does not hold, in the frame of the surfaces.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WeakDirections {
    /// Shifts along these are not told by the scan.
    pub translations: Vec<Vector3>,
    /// Turns about these are not told by the scan.
    pub rotations: Vec<Vector3>,
}

impl WeakDirections {
    /// Whether the scan holds in all directions.
    pub fn is_empty(&self) -> bool {
        self.translations.is_empty() && self.rotations.is_empty()
    }
}

/// A scan matched to surfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceMatch {
    /// Frame of the scan in that of the surfaces.
    pub pose: Rigid3,
    /// Share of points that lie on a plane.
    pub matched_share: f64,
    /// Root of the mean square distance from the planes of those, metres.
    pub rms: f64,
    /// `JᵀWJ` of the points alone, by a translation and a rotation vector about the origin of the scan, in
    /// the frame of the surfaces: 1/m², 1/(m rad), 1/rad².
    pub information: na::Matrix6<f64>,
    /// Where the prior decided instead of the scan.
    pub weak: WeakDirections,
}

/// The prior holds this many times more than the points in a direction in which they do not.
const PRIOR_IN_WEAK_DIRECTIONS: f64 = 30.0;
/// A shift is told when there is so many times more information than errors of normals feign: those of uneven
/// surfaces, which are off alike over metres, and those for the noise of hits, which differ from plane to plane, so
/// that their sum is known better. In a map of a few sweeps noise is most of what there is: counted four times,
/// walks that begin in a hall lost half a metre; counted once, a field without wheels passed for told half of the time.
const TIMES_UNEVEN: f32 = 4.0;
const TIMES_NOISE: f32 = 2.0;
/// Every so many points tell where the points are.
const ARM_SAMPLE: usize = 4;
/// The scale of the loss shrinks by this with every iteration.
const SCALE_DECAY: f64 = 0.6;

/// Matches scans to surfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceMatcher {
    options: SurfaceMatcherOptions,
}

impl SurfaceMatcher {
    /// With these options.
    pub fn new(options: SurfaceMatcherOptions) -> Self {
        Self { options }
    }

    /// The pose near `initial` that puts the points (metres) on the surfaces. `scale` is how far off points
    /// may be at the beginning, metres. None if hardly any point lies near a surface.
    pub fn match_scan(
        &self,
        surfaces: &SurfaceMap,
        points: &[Point3f],
        initial: &Rigid3,
        prior: &PosePrior,
        scale: f64,
    ) -> Option<SurfaceMatch> {
        let mut pose = *initial;
        let mut scale = scale.max(self.options.final_scale);
        let mut weak = WeakDirections::default();
        let mut pairs = Pairs::new(points.len(), surfaces.edge());
        for _ in 0..self.options.max_iterations {
            let sums = self.sums(surfaces, points, &mut pairs, &pose, scale);
            if sums.matched < 20 {
                return None;
            }
            weak = Self::weak_directions(&sums);
            let step = solve(&sums, &pose, prior, &weak)?;
            pose = moved(&pose, &step);
            let is_small = step.fixed_rows::<3>(0).norm() < 2e-4 && step.fixed_rows::<3>(3).norm() < 2e-5;
            if is_small && scale <= self.options.final_scale {
                break;
            }
            scale = (scale * SCALE_DECAY).max(self.options.final_scale);
        }
        let sums = self.sums(surfaces, points, &mut pairs, &pose, self.options.final_scale);
        pose.translation.vector.iter().all(|v| v.is_finite()).then(|| SurfaceMatch {
            pose,
            matched_share: sums.matched as f64 / points.len().max(1) as f64,
            rms: (sums.squares / sums.matched.max(1) as f64).sqrt(),
            information: sums.hessian,
            weak,
        })
    }

    /// Pairs points with planes where they moved, and sums up what all of them say at a pose.
    fn sums(
        &self,
        surfaces: &SurfaceMap,
        points: &[Point3f],
        pairs: &mut Pairs,
        pose: &Rigid3,
        scale: f64,
    ) -> Sums {
        let single = to_f32(pose);
        let rotation = single.rotation.to_rotation_matrix();
        let noise = (self.options.range_noise * self.options.range_noise) as f32;
        let squared_scale = (scale * scale) as f32;
        let least_variance = (self.options.normal_noise * self.options.normal_noise) as f32;
        let mut all = Accumulator::default();
        for (i, (point, pair)) in points.iter().zip(&mut pairs.pairs).enumerate() {
            let turned = rotation * point.coords;
            let place = turned + single.translation.vector;
            if (place - pair.looked_up_at).norm_squared() > pairs.squared_slack {
                pair.looked_up_at = place;
                let toward = turned.try_normalize(1e-6).map_or_else(na::Vector3::zeros, |v| -v);
                pair.plane = surfaces.plane_seen(&place.into(), &toward);
            }
            let Some(plane) = &pair.plane else { continue };
            let residual = plane.normal.dot(&(place - plane.point));
            let squared = residual * residual;
            if squared > 9.0 * squared_scale {
                continue;
            }
            // Geman and McClure's weight.
            let robust = squared_scale / (squared_scale + squared);
            let weight = robust * robust / (noise + plane.variance);
            let lever = turned.cross(&plane.normal);
            let n = &plane.normal;
            let normal_variance = least_variance + plane.normal_variance;
            // A sample tells where points are.
            if i.is_multiple_of(ARM_SAMPLE) {
                all.add_arm(&turned, weight * normal_variance * ARM_SAMPLE as f32);
            }
            if plane.is_edge_on {
                all.add_edge_on(n, &lever, weight);
            }
            let shift_variance = TIMES_UNEVEN * least_variance + TIMES_NOISE * plane.normal_variance;
            all.add([n.x, n.y, n.z, lever.x, lever.y, lever.z, residual, 0.0], weight, shift_variance);
        }
        all.finish()
    }

    /// The eigenvectors of both halves of the information that errors of normals alone could explain (Zhang,
    /// Kaess and Singh, "On degeneracy of optimization-based state estimation problems", 2016). In a
    /// direction in which no surface faces, n·d is the error of the normal; about an axis about which
    /// nothing can turn, (p × n)·d is that error times the distance of p from the axis. Planes seen edge-on tell nothing here.
    fn weak_directions(sums: &Sums) -> WeakDirections {
        let weak = |at: usize, feigned: &na::Matrix3<f64>| -> Vec<Vector3> {
            let half = sums.hessian.fixed_view::<3, 3>(at, at) - sums.edge_on[at / 3];
            let eigen = na::SymmetricEigen::new(half);
            let directions =
                (0..3).map(|i| (eigen.eigenvalues[i], eigen.eigenvectors.column(i).into_owned()));
            let is_weak = |(told, d): &(f64, Vector3)| *told < d.dot(&(feigned * d));
            directions.filter(is_weak).map(|(_, direction)| direction).collect()
        };
        let feigned_shift = na::Matrix3::from_diagonal_element(sums.feigned_shift);
        WeakDirections { translations: weak(0, &feigned_shift), rotations: weak(3, &sums.feigned_turn) }
    }
}

/// One Gauss-Newton step of points and prior together.
fn solve(sums: &Sums, pose: &Rigid3, prior: &PosePrior, weak: &WeakDirections) -> Option<na::Vector6<f64>> {
    let offset = pose.translation.vector - prior.pose.translation.vector;
    let turn =
        portolan_geometry::angle_axis_from_quaternion(&(pose.rotation * prior.pose.rotation.inverse()));
    let stiffness = |directions: &[Vector3], sigma: f64, at: usize| {
        let mut stiffness = na::Matrix3::from_diagonal_element(1.0 / (sigma * sigma));
        for direction in directions {
            let held = direction.dot(&(sums.hessian.fixed_view::<3, 3>(at, at) * direction)).abs();
            stiffness += direction * direction.transpose() * (PRIOR_IN_WEAK_DIRECTIONS * held);
        }
        stiffness
    };
    let by_translation = stiffness(&weak.translations, prior.translation_sigma, 0);
    let by_rotation = stiffness(&weak.rotations, prior.rotation_sigma, 3);
    let (mut hessian, mut gradient) = (sums.hessian, sums.gradient);
    let mut add = |at: usize, stiffness: &na::Matrix3<f64>, difference: &Vector3| {
        let mut block = hessian.fixed_view_mut::<3, 3>(at, at);
        block += stiffness;
        let mut part = gradient.fixed_rows_mut::<3>(at);
        part += stiffness * difference;
    };
    add(0, &by_translation, &offset);
    add(3, &by_rotation, &turn);
    let step = hessian.cholesky()?.solve(&-gradient);
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// The pose moved by a translation and turned about its own origin by a rotation vector.
fn moved(pose: &Rigid3, step: &na::Vector6<f64>) -> Rigid3 {
    let translation: Vector3 = step.fixed_rows::<3>(0).into();
    let turn = quaternion_from_angle_axis(&step.fixed_rows::<3>(3).into_owned());
    let rotation = Quaternion::new_normalize((turn * pose.rotation).into_inner());
    Rigid3::from_parts((pose.translation.vector + translation).into(), rotation)
}

#[cfg(test)]
mod tests;
