//! Matching scans and sweeps to surfaces: robust point-to-plane least squares.

use std::ops::Range;

use nalgebra as na;
use portolan_geometry::{Point3f, Rigid3, Vector3};

use crate::map::{Doubt, SurfaceMap};
use crate::posts::{PostMap, PostPoint, Posts};
use crate::way::{StraightPieces, Way, WayCorrection};
use step::{Held, solve};
use sums::{Accumulator, Pairs, Sums};

mod step;
pub(crate) mod sums;

/// How scans are matched to surfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceMatcherOptions {
    /// Noise of ranges, metres (standard deviation).
    pub range_noise: f64,
    /// Points farther than about this from their plane count little in the end, metres.
    pub final_scale: f64,
    /// Iterations at most.
    pub max_iterations: u32,
    /// A match that puts a smaller share of the points on surfaces is of no use; it may be given up early then.
    pub min_matched_share: f64,
    /// How far normals of planes are off at least, radians (standard deviation): surfaces are not flat. The noise
    /// of the hits comes on top. Where scans tell no more than such errors feign, they tell nothing.
    pub normal_noise: f64,
    /// How much planes count that were seen edge-on. They may be made of the beams themselves, and hold the scanner
    /// where it was then: where they counted a tenth, four of twelve walks through parks without wheels were lost and
    /// five without an IMU; with nothing, two and one.
    pub edge_on_share: f32,
}

impl Default for SurfaceMatcherOptions {
    fn default() -> Self {
        Self {
            range_noise: 0.02,
            final_scale: 0.1,
            max_iterations: 20,
            min_matched_share: 0.0,
            normal_noise: 0.03,
            edge_on_share: 0.0,
        }
    }
}

/// Where a scan is believed to be before matching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePrior {
    /// Frame of the scan in that of the surfaces.
    pub pose: Rigid3,
    /// How far it may be off.
    pub sigmas: Sigmas,
}

/// Standard deviations of a correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmas {
    /// Of a shift along each axis, metres.
    pub shift: f64,
    /// Of a turn about each axis, radians.
    pub turn: f64,
}

/// How far a predicted way may be off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WayPrior {
    /// Where it starts.
    pub start: Sigmas,
    /// What it is off at its end, seen from its start.
    pub bend: Sigmas,
    /// Whether it is known well enough to be weighed against planes that hold the scanner.
    pub is_felt: bool,
}

/// A point of a sweep as it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SweptPoint {
    /// Seconds before the end of the sweep, not positive.
    pub offset: f32,
    /// Metres, in the frame of the scanner at its own time.
    pub position: Point3f,
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
    /// Frame of the scan in that of the surfaces; of a sweep, at its end.
    pub pose: Rigid3,
    /// What the prediction was off by.
    pub correction: WayCorrection,
    /// Share of points that lie on a plane.
    pub matched_share: f64,
    /// Root of the mean square distance from the planes of those, metres.
    pub rms: f64,
    /// `JᵀWJ` of the points alone, by a shift and a rotation vector about the scanner, in the frame of the
    /// surfaces: 1/m², 1/(m rad), 1/rad².
    pub information: na::Matrix6<f64>,
    /// Where the prior decided instead of the scan.
    pub weak: WeakDirections,
    /// Covariance of what errors of normals may hold the place off by, m², in the frame of the surfaces. Zero unless
    /// the prior says [`WayPrior::is_felt`].
    pub held: na::Matrix3<f64>,
}

/// A shift is told when there is so many times more information than errors of normals feign: those of uneven
/// surfaces, which are off alike over metres, and those for the noise of hits, which differ from plane to plane, so
/// that their sum is known better. In a map of a few sweeps noise is most of what there is: counted four times,
/// walks that begin in a hall lost half a metre; counted once, a field without wheels passed for told half of the time.
const TIMES_UNEVEN: f32 = 4.0;
const TIMES_NOISE: f32 = 2.0;
/// Ground that looks down counts so much. With all of its weight a field seems to hold a lidar that is carried over it.
/// Twelve walks through parks do not tell a tenth from a fiftieth.
const SHARE_OF_GROUND_FROM_BELOW: f32 = 0.1;
/// Every so many points tell where the points are.
const ARM_SAMPLE: usize = 4;
/// The scale of the loss shrinks by this with every iteration.
const SCALE_DECAY: f64 = 0.45;
/// The end is found when it moves by less, metres and radians: a quarter of what it can be known to. (A tenth is no
/// nearer to the truth.)
const SMALL_SHIFT: f64 = 5e-4;
const SMALL_TURN: f64 = 5e-5;
/// Points of so many parts of a sweep are summed up apart.
const PARTS: f64 = 8.0;
/// With this part of the share that is wanted a match has no hope, once the loss has its final scale.
const HOPELESS_SHARE: f64 = 0.6;
/// A scan that took no time does not bend.
const STIFF: Sigmas = Sigmas { shift: 1e-6, turn: 1e-6 };

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
        let points: Vec<SweptPoint> =
            points.iter().map(|p| SweptPoint { offset: 0.0, position: *p }).collect();
        let way_prior = WayPrior { start: prior.sigmas, bend: STIFF, is_felt: false };
        let way = Way::standing(prior.pose);
        let first = WayCorrection { start: way.correction_to(initial).end(), ..WayCorrection::default() };
        self.run((surfaces, None), &points, &way, first, &way_prior, scale)
    }

    /// The way near a predicted one (in the frame of the surfaces) on which a sweep was measured, and its end: the
    /// points, in the order of their times, lie on the surfaces then. `scale` is how far off points may be at the
    /// beginning, metres. None if hardly any point lies near a surface.
    ///
    /// The start of the way is corrected together with its bend (as the elastic trajectories of Dellenbach et
    /// al., "CT-ICP", 2022, but held by a prior instead of a penalty): held fast, an error of the sweep before would
    /// come back with the opposite sign. The corrected start serves this sweep alone.
    ///
    /// What stands around (in the frame of the surfaces) and points of the sweep that show it, in the order of their
    /// times, help where hardly anything is flat.
    pub fn match_sweep(
        &self,
        surfaces: &SurfaceMap,
        points: &[SweptPoint],
        way: &Way,
        prior: &WayPrior,
        scale: f64,
        posts: Option<(&PostMap, &[PostPoint])>,
    ) -> Option<SurfaceMatch> {
        let mut posts = posts.map(|(map, points)| Posts::new(map, points, way));
        self.run((surfaces, posts.as_mut()), points, way, WayCorrection::default(), prior, scale)
    }

    fn run(
        &self,
        (surfaces, mut posts): (&SurfaceMap, Option<&mut Posts>),
        points: &[SweptPoint],
        way: &Way,
        mut correction: WayCorrection,
        prior: &WayPrior,
        scale: f64,
    ) -> Option<SurfaceMatch> {
        let parts = parts_of(points, |p| p.offset, way);
        let mut scale = scale.max(self.options.final_scale);
        let mut pairs = Pairs::new(points.len(), surfaces.edge());
        let mut last = None;
        for _ in 0..self.options.max_iterations {
            let is_coarse = scale > self.options.final_scale;
            let bent = way.bent(&correction);
            let mut all = Accumulator::default();
            let (matched, squares) =
                self.add_planes(&mut all, surfaces, (points, &parts), &mut pairs, &bent, scale);
            let by_posts = posts.as_deref_mut().map(|posts| posts.add_to(&mut all, &bent, scale));
            let sums = Sums { matched, squares, ..all.finish() };
            if sums.matched < 20 {
                return None;
            }
            let share = sums.matched as f64 / points.len() as f64;
            if !is_coarse && share < HOPELESS_SHARE * self.options.min_matched_share {
                return None;
            }
            let weak = Self::weak_directions(&sums);
            let held = prior.is_felt.then(|| Held::by(&sums));
            let step = solve(&sums, &correction, prior, &weak, held.as_ref())?;
            correction.start += step.start;
            correction.bend += step.bend;
            last = Some((sums, weak, held, by_posts));
            let moved = step.end();
            let is_small =
                moved.fixed_rows::<3>(0).norm() < SMALL_SHIFT && moved.fixed_rows::<3>(3).norm() < SMALL_TURN;
            if is_small && scale <= self.options.final_scale {
                break;
            }
            scale = (scale * SCALE_DECAY).max(self.options.final_scale);
        }
        let (mut sums, mut weak, held, by_posts) = last?;
        if let Some(by_posts) = by_posts {
            // Some points of bare walls seem to stand alone, too: what is told is reported by planes.
            sums.doubtful.iter_mut().zip(by_posts).for_each(|(doubtful, told)| *doubtful += told);
            weak = Self::weak_directions(&sums);
        }
        let pose = way.corrected_end(&correction);
        pose.translation.vector.iter().all(|v| v.is_finite()).then(|| SurfaceMatch {
            pose,
            correction,
            matched_share: sums.matched as f64 / points.len().max(1) as f64,
            rms: (sums.squares / sums.matched.max(1) as f64).sqrt(),
            information: sums.hessian,
            weak,
            held: held.map_or_else(na::Matrix3::zeros, |held| held.covariance()),
        })
    }

    /// Pairs points with planes where they moved, and adds what all of them say on a way. How many did, and the sum of
    /// their squared distances.
    fn add_planes(
        &self,
        all: &mut Accumulator,
        surfaces: &SurfaceMap,
        (points, parts): (&[SweptPoint], &[Part]),
        pairs: &mut Pairs,
        way: &StraightPieces,
        scale: f64,
    ) -> (usize, f64) {
        let noise = (self.options.range_noise * self.options.range_noise) as f32;
        let squared_scale = (scale * scale) as f32;
        let least_variance = (self.options.normal_noise * self.options.normal_noise) as f32;
        for part in parts {
            for i in part.points.clone() {
                let (point, pair) = (&points[i], &mut pairs.pairs[i]);
                let (turned, from) = way.seen(&point.position, point.offset);
                let place = turned + from;
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
                // Geman and McClure's weight. Away from its middle a plane is known as well as its normal.
                let robust = squared_scale / (squared_scale + squared);
                let tilt = plane.normal_variance * (place - plane.point).norm_squared();
                let weight = robust * robust / (noise + plane.variance + tilt);
                let normal_variance = least_variance + plane.normal_variance;
                // A sample tells where points are.
                if i.is_multiple_of(ARM_SAMPLE) {
                    all.add_arm(&turned, weight * normal_variance * ARM_SAMPLE as f32);
                }
                let shift_variance = TIMES_UNEVEN * least_variance + TIMES_NOISE * plane.normal_variance;
                let (n, lever) = (&plane.normal, turned.cross(&plane.normal));
                let share = match plane.doubt {
                    None => 1.0,
                    Some(Doubt::EdgeOn) => self.options.edge_on_share,
                    Some(Doubt::LooksDown) => SHARE_OF_GROUND_FROM_BELOW,
                };
                let told = share * weight;
                if let Some(doubt) = plane.doubt {
                    // Ground that looks down feigns no tilt: all of its weight counts there for what is told.
                    let of_turn = if doubt == Doubt::LooksDown { told - weight } else { told };
                    all.add_doubtful(n, &lever, [told, of_turn]);
                }
                let row = [n.x, n.y, n.z, lever.x, lever.y, lever.z, residual, 0.0];
                all.add(row, told, weight * shift_variance);
            }
            all.end_part(part.bows);
        }
        all.matched()
    }

    /// The eigenvectors of both halves of the information that errors of normals alone could explain (Zhang,
    /// Kaess and Singh, "On degeneracy of optimization-based state estimation problems", 2016). In a
    /// direction in which no surface faces, n·d is the error of the normal; about an axis about which
    /// nothing can turn, (p × n)·d is that error times the distance of p from the axis. Doubtful planes tell nothing here.
    fn weak_directions(sums: &Sums) -> WeakDirections {
        let weak = |at: usize, feigned: &na::Matrix3<f64>| -> Vec<Vector3> {
            let half = sums.hessian.fixed_view::<3, 3>(at, at) - sums.doubtful[at / 3];
            let eigen = na::SymmetricEigen::new(half);
            let directions =
                (0..3).map(|i| (eigen.eigenvalues[i], eigen.eigenvectors.column(i).into_owned()));
            let is_weak = |(told, d): &(f64, Vector3)| *told <= d.dot(&(feigned * d));
            directions.filter(is_weak).map(|(_, direction)| direction).collect()
        };
        let feigned_shift = na::Matrix3::from_diagonal_element(sums.feigned_shift);
        WeakDirections { translations: weak(0, &feigned_shift), rotations: weak(3, &sums.feigned_turn) }
    }
}

/// Points of a sweep that were measured at about the same time, and how much the bend of the way shifts and turns
/// them.
pub(super) struct Part {
    pub points: Range<usize>,
    pub bows: [f64; 2],
}

pub(super) fn parts_of<T>(points: &[T], offset: impl Fn(&T) -> f32, way: &Way) -> Vec<Part> {
    let share = |p: &T| way.share_at(offset(p));
    let mut parts: Vec<Part> = Vec::with_capacity(PARTS as usize);
    let mut begin = 0;
    for chunk in points.chunk_by(|a, b| (share(a) * PARTS).floor() == (share(b) * PARTS).floor()) {
        let middle = chunk.iter().map(share).sum::<f64>() / chunk.len() as f64;
        parts.push(Part { points: begin..begin + chunk.len(), bows: way.bows(middle) });
        begin += chunk.len();
    }
    parts
}

#[cfg(test)]
mod tests;
