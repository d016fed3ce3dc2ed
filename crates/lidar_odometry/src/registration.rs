//! Registers scans and sweeps to the planar voxel map: robust point-to-plane least squares (Chen and
//! Medioni 1992) over the corrections of a trajectory segment, with a motion prior, and with detection of
//! degenerate directions.

use std::ops::Range;

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid3};
use portolan_motion::DegenerateDirections;
use portolan_sensor::TimedPoint;

use crate::deskew::PiecewiseLinearTrajectory;
use crate::plane_map::{PlaneMap, Unreliable};
use crate::poles::{PoleMap, PolePoint, PoleResiduals};
use crate::segment::{SegmentCorrection, TrajectorySegment};
use crate::settings::constants::registration::{
    ARM_SAMPLE_POINTS, HOPELESS_FRACTION, MAX_ITERATIONS, MIN_PAIRS, PARTS_PER_SWEEP,
};
use crate::settings::{PlaneFitSettings, RegistrationSettings};
use attenuation::Attenuation;
use degeneracy::degenerate_directions;
use normal_equations::{Accumulator, Matched, NormalEquations};
use pairs::{AT_ONCE, Pairs, Ray};
use solve::solve;

mod attenuation;
mod degeneracy;
pub(crate) mod normal_equations;
mod pairs;
mod solve;
#[cfg(test)]
mod tests;

/// A scan without duration has no growing correction.
const RIGID: Sigmas = Sigmas { translation: 1e-6, rotation: 1e-6 };

/// Standard deviations of a correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmas {
    /// Along each axis, metres.
    pub translation: f64,
    /// About each axis, radians.
    pub rotation: f64,
}

/// Prior of the pose of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePrior {
    /// Frame of the scan in that of the planes.
    pub pose: Rigid3,
    /// Its standard deviations.
    pub sigmas: Sigmas,
}

/// Standard deviations of a predicted trajectory segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionPrior {
    /// At its start.
    pub start: Sigmas,
    /// Of the growth until its end.
    pub growth: Sigmas,
    /// Whether it is precise enough to be weighed against attenuation by errors of normals.
    pub compensates_attenuation: bool,
}

/// A scan or a sweep, registered.
#[derive(Clone, Debug, PartialEq)]
pub struct RegistrationResult {
    /// Frame of the scan in that of the planes; of a sweep, at its end.
    pub pose: Rigid3,
    /// Estimated error of the prediction.
    pub correction: SegmentCorrection,
    /// Fraction of the points that are on a plane.
    pub matched_fraction: f64,
    /// Fraction of the points that are on planes that are not [unreliable](crate::Unreliable): a plane
    /// made of single beams moves with the scanner, and fits any motion.
    pub reliable_fraction: f64,
    /// Root mean square distance of the points on planes from them, metres.
    pub rms: f64,
    /// `JᵀWJ` of the points alone, by a translation and a rotation vector about the scanner, in the frame
    /// of the planes: 1/m², 1/(m rad), 1/rad².
    pub information: na::Matrix6<f64>,
    /// Degenerate directions, in which the prior decided instead of the points.
    pub degenerate: DegenerateDirections,
    /// Covariance of the position error by attenuation, m², in the frame of the planes.
    pub attenuation: na::Matrix3<f64>,
}

impl RegistrationResult {
    /// Covariance of the position from the points alone, with attenuation, for any rotation: m² in the
    /// frame of the planes. Degenerate directions are known to a metre.
    pub(crate) fn place_covariance(&self) -> Option<na::Matrix3<f64>> {
        let block = |row, column| self.information.fixed_view::<3, 3>(row, column).into_owned();
        let through_rotation = block(0, 3) * block(3, 3).try_inverse()? * block(3, 0);
        let of_place = block(0, 0) - through_rotation + na::Matrix3::identity();
        let open = self.degenerate.translations.iter().map(|open| open * open.transpose());
        Some(of_place.try_inverse()? + self.attenuation + open.sum::<na::Matrix3<f64>>())
    }

    /// Fit of the result: the fraction of points on planes, halved where their root mean square distance
    /// equals the final scale of the loss.
    pub(crate) fn fit(&self, final_scale: f64) -> f64 {
        self.matched_fraction / (1.0 + (self.rms / final_scale).powi(2))
    }

    /// Fit of the points that constrain the motion: as [`Self::fit`], of points on reliable planes alone.
    pub(crate) fn evidence(&self, final_scale: f64) -> f64 {
        self.reliable_fraction / (1.0 + (self.rms / final_scale).powi(2))
    }
}

/// Registers scans and sweeps.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    settings: RegistrationSettings,
}

/// Result of an iteration.
struct Iteration {
    equations: NormalEquations,
    degenerate: DegenerateDirections,
    attenuation: Attenuation,
    /// Information about translation and rotation by poles alone.
    by_poles: Option<[na::Matrix3<f64>; 2]>,
    /// The squared length of the step in standard deviations of the result.
    squared_decrement: f64,
}

/// The points to register, and the map to register them to.
struct Scene<'a> {
    planes: &'a PlaneMap,
    poles: Option<PoleResiduals<'a>>,
    points: &'a [TimedPoint],
    parts: Vec<Part>,
    pairs: Pairs,
}

impl Registration {
    /// Its settings.
    pub fn settings(&self) -> &RegistrationSettings {
        &self.settings
    }

    /// Registration with these settings.
    pub fn new(settings: RegistrationSettings) -> Self {
        Self { settings }
    }

    /// The pose near `initial` that puts the points (metres) on the planes. `scale` is the initial scale
    /// of the loss, metres. None if hardly any point is near a plane.
    pub fn register_scan(
        &self,
        planes: &PlaneMap,
        points: &[Point3f],
        initial: &Rigid3,
        prior: &PosePrior,
        scale: f64,
    ) -> Option<RegistrationResult> {
        let points: Vec<TimedPoint> = points.iter().map(|p| TimedPoint { position: *p, time: 0.0 }).collect();
        let motion_prior = MotionPrior { start: prior.sigmas, growth: RIGID, compensates_attenuation: false };
        let segment = TrajectorySegment::instantaneous(prior.pose);
        let first =
            SegmentCorrection { start: segment.correction_to(initial).end(), ..SegmentCorrection::default() };
        let scene = Scene::new(planes, None, &points, &segment);
        self.minimise(scene, &segment, first, &motion_prior, scale)
    }

    /// The segment near a predicted one (in the frame of the planes) on which a sweep was measured, and
    /// its end: its points, in order of time, are then on the planes. `scale` is the initial scale of the
    /// loss, metres. None if hardly any point is near a plane.
    ///
    /// The start of the segment is corrected together with its growth (as the elastic trajectories of
    /// Dellenbach et al., "CT-ICP", 2022, but held by a prior instead of a penalty): with a fixed start,
    /// an error of the previous sweep would come back with the opposite sign. The corrected start is used
    /// for this sweep only.
    ///
    /// `poles`: nearby poles (in the frame of the planes), and points of the sweep on them, in order of
    /// time. They help where there are hardly any planes.
    pub fn register_sweep(
        &self,
        planes: &PlaneMap,
        points: &[TimedPoint],
        segment: &TrajectorySegment,
        prior: &MotionPrior,
        scale: f64,
        poles: Option<(&PoleMap, &[PolePoint])>,
    ) -> Option<RegistrationResult> {
        let poles = poles.map(|(map, points)| {
            PoleResiduals::new(map, points, segment, self.settings.points_per_independent_one)
        });
        let scene = Scene::new(planes, poles, points, segment);
        self.minimise(scene, segment, SegmentCorrection::default(), prior, scale)
    }

    /// Distance from their plane, metres, beyond which points have little weight in the final iterations.
    fn final_scale(&self, planes: &PlaneMap) -> f64 {
        self.settings.final_scale_per_edge * f64::from(planes.edge())
    }

    /// Gauss-Newton with a robust loss whose scale shrinks (graduated non-convexity).
    fn minimise(
        &self,
        mut scene: Scene<'_>,
        segment: &TrajectorySegment,
        mut correction: SegmentCorrection,
        prior: &MotionPrior,
        scale: f64,
    ) -> Option<RegistrationResult> {
        let settings = &self.settings;
        let final_scale = self.final_scale(scene.planes);
        let mut scale = scale.max(final_scale);
        let mut last = None;
        for _ in 0..MAX_ITERATIONS {
            let is_coarse = scale > final_scale;
            let iteration = self.iterate(&mut scene, segment, &mut correction, prior, scale)?;
            let is_small = iteration.squared_decrement < settings.small_step.powi(2);
            last = Some(iteration);
            if is_small && !is_coarse {
                break;
            }
            scale = (scale * settings.scale_decay).max(final_scale);
        }
        let Iteration { mut equations, mut degenerate, attenuation, by_poles, .. } = last?;
        if let Some(by_poles) = by_poles {
            // Some points of bare walls pass for poles, so degenerate directions are determined from
            // planes alone.
            equations
                .unreliable
                .iter_mut()
                .zip(by_poles)
                .for_each(|(unreliable, poles)| *unreliable += poles);
            degenerate = degenerate_directions(&equations);
        }
        let Matched { points, reliable, squares } = equations.matched;
        let pose = segment.corrected_end(&correction);
        let matched_fraction = points as f64 / scene.points.len().max(1) as f64;
        let is_finite = pose.translation.vector.iter().all(|v| v.is_finite());
        (is_finite && matched_fraction >= settings.min_matched_fraction).then(|| RegistrationResult {
            pose,
            correction,
            matched_fraction,
            reliable_fraction: reliable as f64 / scene.points.len().max(1) as f64,
            rms: (squares / points.max(1) as f64).sqrt(),
            information: equations.hessian,
            degenerate,
            attenuation: attenuation.covariance(),
        })
    }

    /// One Gauss-Newton step. None if the scan does not fit.
    fn iterate(
        &self,
        scene: &mut Scene<'_>,
        segment: &TrajectorySegment,
        correction: &mut SegmentCorrection,
        prior: &MotionPrior,
        scale: f64,
    ) -> Option<Iteration> {
        let settings = &self.settings;
        // 1. Residuals: points to planes, and to poles where there are some.
        let trajectory = segment.corrected(correction);
        let mut all = Accumulator::new(settings.points_per_independent_one);
        let matched = self.add_planes(&mut all, scene, &trajectory, scale);
        let by_poles = scene.poles.as_mut().map(|poles| poles.add_to(&mut all, &trajectory, scale));
        let equations = NormalEquations { matched, ..all.finish() };
        // 2. Give up a hopeless fit.
        let fraction = matched.points as f64 / scene.points.len() as f64;
        let is_hopeless = fraction < HOPELESS_FRACTION * settings.min_matched_fraction;
        if matched.points < MIN_PAIRS || scale <= self.final_scale(scene.planes) && is_hopeless {
            return None;
        }
        // 3. Degenerate directions, and attenuation by errors of normals.
        let degenerate = degenerate_directions(&equations);
        let attenuation = Attenuation::of(&equations, scene.planes);
        // 4. The step of points and prior together.
        let step = solve(&equations, correction, prior, &degenerate, &attenuation)?;
        correction.start += step.correction.start;
        correction.growth += step.correction.growth;
        let squared_decrement = step.squared_decrement;
        Some(Iteration { equations, degenerate, attenuation, by_poles, squared_decrement })
    }

    /// Pairs the points with planes at their current positions, and adds their residuals on a trajectory.
    fn add_planes(
        &self,
        all: &mut Accumulator,
        scene: &mut Scene<'_>,
        trajectory: &PiecewiseLinearTrajectory,
        scale: f64,
    ) -> Matched {
        let settings = &self.settings;
        let PlaneFitSettings { range_noise, normal_noise, .. } = scene.planes.settings();
        let range_variance = (range_noise * range_noise) as f32;
        let squared_scale = (scale * scale) as f32;
        let squared_cutoff = settings.outlier_sigmas.powi(2) as f32 * squared_scale;
        let least_variance = (normal_noise * normal_noise) as f32;
        let uneven = settings.uneven_factor;
        let mut rays = [Ray::default(); AT_ONCE];
        for part in &scene.parts {
            let mut paired = 0..0;
            for i in part.points.clone() {
                if i >= paired.end {
                    paired = i..(i + AT_ONCE).min(part.points.end);
                    scene.pairs.renew(paired.clone(), scene.points, scene.planes, trajectory, &mut rays);
                }
                let (Ray { turned, place }, pair) = (rays[i - paired.start], &scene.pairs.pairs[i]);
                let Some(plane) = &pair.plane else { continue };
                let residual = plane.normal.dot(&(place - plane.point));
                let squared = residual * residual;
                if squared > squared_cutoff {
                    continue;
                }
                // Geman and McClure's weight. Away from its middle a plane is only as certain as its
                // normal.
                let robust = squared_scale / (squared_scale + squared);
                let tilt = plane.normal_variance * (place - plane.point).norm_squared();
                let weight = robust * robust / (range_variance + plane.variance + tilt);
                let normal_variance = least_variance + plane.normal_variance;
                // A sample of the points gives their positions.
                if i.is_multiple_of(ARM_SAMPLE_POINTS) {
                    all.add_arm(&turned, weight * normal_variance * ARM_SAMPLE_POINTS as f32);
                }
                let spurious_variance = uneven * least_variance + plane.normal_variance;
                let (n, lever) = (&plane.normal, turned.cross(&plane.normal));
                let fraction = match plane.unreliable {
                    None => 1.0,
                    Some(Unreliable::GrazingIncidence) => settings.grazing_weight,
                    Some(Unreliable::DownwardNormal) => settings.downward_weight,
                };
                let counted = fraction * weight;
                if let Some(reason) = plane.unreliable {
                    // Ground with a downward normal causes no spurious tilt: all of its weight is reliable
                    // there.
                    let is_downward = reason == Unreliable::DownwardNormal;
                    let of_rotation = if is_downward { counted - weight } else { counted };
                    all.add_unreliable(n, &lever, [counted, of_rotation]);
                }
                let row = [n.x, n.y, n.z, lever.x, lever.y, lever.z, residual, 0.0];
                all.add(row, counted, weight * spurious_variance);
            }
            all.end_part(part.growth_fractions);
        }
        all.matched()
    }
}

impl<'a> Scene<'a> {
    fn new(
        planes: &'a PlaneMap,
        poles: Option<PoleResiduals<'a>>,
        points: &'a [TimedPoint],
        segment: &TrajectorySegment,
    ) -> Self {
        let parts = parts_of(points, |p| p.time, segment);
        let pairs = Pairs::new(points.len(), planes.settings().range_noise as f32);
        Self { planes, poles, points, parts, pairs }
    }
}

/// Points of a sweep that were measured at about the same time, and the fractions of the growth that apply
/// to them.
pub(crate) struct Part {
    pub points: Range<usize>,
    pub growth_fractions: [f64; 2],
}

/// Splits points in order of time.
pub(crate) fn parts_of<T>(points: &[T], time: impl Fn(&T) -> f32, segment: &TrajectorySegment) -> Vec<Part> {
    let fraction = |p: &T| segment.fraction_at(time(p));
    let mut parts: Vec<Part> = Vec::with_capacity(PARTS_PER_SWEEP as usize);
    let mut begin = 0;
    for chunk in points
        .chunk_by(|a, b| (fraction(a) * PARTS_PER_SWEEP).floor() == (fraction(b) * PARTS_PER_SWEEP).floor())
    {
        let middle = chunk.iter().map(fraction).sum::<f64>() / chunk.len() as f64;
        let growth_fractions = segment.growth_fractions(middle);
        parts.push(Part { points: begin..begin + chunk.len(), growth_fractions });
        begin += chunk.len();
    }
    parts
}
