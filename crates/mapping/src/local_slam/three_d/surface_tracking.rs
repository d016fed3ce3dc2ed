//! Matching sweeps to surfaces: the way on which a sweep was measured and its end are found together.

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::{Point3f, Rigid3, Time};
use portolan_matching::{PosePrior, SurfaceMap, SurfaceMatch, SurfaceMatcher, SurfaceMatcherOptions};
use portolan_sensor::{PointCloud, RangeData, voxel_filter, voxel_filter_indices};

use super::super::SweepPoint;
use super::sweep_path::{StraightPieces, SweepPath};
use super::unwarp::Gathered;

/// So many points of a sweep are matched, spread evenly over what it sees.
const WANTED_POINTS: f32 = 1500.0;
/// The way of a sweep and its end are found in turns, so many at most.
const TURNS: u32 = 3;
/// A turn that moves the end by less is the last, metres and radians.
const SMALL_SHIFT: f64 = 0.003;
const SMALL_TURN: f64 = 0.0005;
/// A match of fewer points is no match. Among trees not much is flat.
const MIN_MATCHED_SHARE: f64 = 0.15;
/// A match contradicts a measured turn if it is so many standard deviations off.
const CONTRADICTION_SIGMAS: f64 = 4.0;
/// Points that lie so far off, metres, halve what a match is worth.
const POOR_RMS: f64 = 0.1;
/// Points may be off by this at the beginning, metres, and by this many times the error that the
/// prediction may have.
const START_SCALE: f64 = 0.3;
const SCALE_OF_SIGMA: f64 = 3.0;
/// What a carrier may do unseen: m/s² and rad/s², and errors of measured ways and turns per second.
const ACCELERATION: f64 = 4.0;
const TURN_ACCELERATION: f64 = 10.0;
const ODOMETRY_ERROR: f64 = 0.2;
const GYROSCOPE_ERROR: f64 = 0.02;

/// A sweep matched to surfaces.
pub(super) struct MatchedSweep {
    /// At the end of the sweep.
    pub local_from_tracking: Rigid3,
    /// How it was seen on the way.
    pub pieces: StraightPieces,
    /// The match; none where the sweep fits nothing and the prediction is all there is.
    pub found: Option<SurfaceMatch>,
}

impl MatchedSweep {
    /// Whether the sweep fits only far from the turn that was measured.
    pub fn contradicts_turn(&self, path: &SweepPath) -> bool {
        let error = path.end().rotation.angle_to(&self.local_from_tracking.rotation);
        self.found.is_some() && error > CONTRADICTION_SIGMAS * rotation_sigma(path)
    }

    /// How well it fits: the share of points on surfaces, less if they lie far off.
    pub fn fit(&self) -> f64 {
        self.found.as_ref().map_or(0.0, |f| f.matched_share / (1.0 + (f.rms / POOR_RMS).powi(2)))
    }
}

/// How far off the turn of a predicted way may be, radians (standard deviation).
fn rotation_sigma(path: &SweepPath) -> f64 {
    let seconds = path.seconds();
    match path.turn_is_measured {
        true => 0.002 + GYROSCOPE_ERROR * seconds,
        false => 0.005 + 0.5 * TURN_ACCELERATION * seconds * seconds,
    }
}

/// Matches sweeps to surfaces.
pub(super) struct SurfaceTracker {
    matcher: SurfaceMatcher,
    /// Edge of the voxels of which one point each is matched, adapted from sweep to sweep.
    spacing: f32,
}

impl SurfaceTracker {
    pub fn new(voxel_size: f64) -> Self {
        let options =
            SurfaceMatcherOptions { final_scale: 0.1 * voxel_size, ..SurfaceMatcherOptions::default() };
        Self { matcher: SurfaceMatcher::new(options), spacing: 0.4 * voxel_size as f32 }
    }

    /// The points of a sweep that ends at `end` that are in range.
    pub fn sweep(gathered: &[Gathered], end: Time, options: &TrajectoryBuilder3dOptions) -> Vec<SweepPoint> {
        let in_range = options.min_range..=options.max_range;
        let points = gathered.iter().flat_map(|message| &message.points);
        let usable = points.filter(|p| in_range.contains(&(p.position - p.origin).norm()));
        usable
            .map(|p| SweepPoint {
                offset: p.time.seconds_since(end).min(0.0) as f32,
                position: p.position,
                intensity: p.intensity,
            })
            .collect()
    }

    /// A selection that covers everything seen.
    pub fn selection(&mut self, sweep: &[SweepPoint]) -> Vec<SweepPoint> {
        let kept = voxel_filter_indices(sweep, |p| p.position, self.spacing);
        if !kept.is_empty() {
            let correction = (kept.len() as f32 / WANTED_POINTS).sqrt().clamp(0.7, 1.4);
            self.spacing = (self.spacing * correction).clamp(0.02, 5.0);
        }
        kept.into_iter().filter_map(|i| sweep.get(i as usize).copied()).collect()
    }

    /// Finds the end of a sweep on surfaces given in the frame of a submap.
    pub fn match_sweep(
        &self,
        selection: &[SweepPoint],
        path: &SweepPath,
        (local_from_submap, surfaces): (&Rigid3, &SurfaceMap),
    ) -> MatchedSweep {
        let seconds = path.seconds();
        let prior = PosePrior {
            pose: local_from_submap.inverse() * path.end(),
            translation_sigma: match path.way_is_measured {
                true => 0.01 + ODOMETRY_ERROR * seconds,
                false => 0.01 + 0.5 * ACCELERATION * seconds * seconds,
            },
            rotation_sigma: rotation_sigma(path),
        };
        let first_scale = START_SCALE.max(SCALE_OF_SIGMA * prior.translation_sigma).min(2.0);
        let mut end = path.end();
        let mut pieces = path.bent_to(&end);
        let mut found: Option<SurfaceMatch> = None;
        let mut in_end: Vec<Point3f> = Vec::with_capacity(selection.len());
        for turn in 0..TURNS {
            in_end.clear();
            in_end.extend(selection.iter().map(|p| pieces.in_end(&p.position, p.offset)));
            let scale = if turn == 0 { first_scale } else { 0.0 };
            let initial = local_from_submap.inverse() * end;
            let Some(matched) = self.matcher.match_scan(surfaces, &in_end, &initial, &prior, scale) else {
                break;
            };
            if matched.matched_share < MIN_MATCHED_SHARE {
                break;
            }
            let new_end = local_from_submap * matched.pose;
            let change = end.inverse() * new_end;
            end = new_end;
            pieces = path.bent_to(&end);
            found = Some(matched);
            if change.translation.vector.norm() < SMALL_SHIFT && change.rotation.angle() < SMALL_TURN {
                break;
            }
        }
        MatchedSweep { local_from_tracking: end, pieces, found }
    }
}

/// The sweep as seen from its end: thinned for grids, and all of it for surfaces.
pub(super) fn in_tracking(
    sweep: &[SweepPoint],
    pieces: &StraightPieces,
    voxel_size: f32,
    use_intensities: bool,
) -> (RangeData, Vec<Point3f>) {
    let points: Vec<Point3f> = sweep.iter().map(|p| pieces.in_end(&p.position, p.offset)).collect();
    let intensities = match use_intensities {
        true => sweep.iter().map(|p| p.intensity).collect(),
        false => Vec::new(),
    };
    let all = PointCloud { points, intensities };
    let returns = voxel_filter(&all, voxel_size);
    (RangeData { origin: Point3f::origin(), returns, misses: PointCloud::default() }, all.points)
}
