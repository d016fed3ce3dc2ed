//! Matching sweeps to surfaces: the way on which a sweep was measured and its end are found together.

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::{Point3f, Rigid3, Time};
use portolan_lidar_odometry::{
    Going, Sigmas, StraightPieces, SurfaceMap, SurfaceMatch, SurfaceMatcher, SurfaceMatcherOptions,
    SweptPoint, Way, WayCorrection, WayPrior,
};
use portolan_sensor::{PointCloud, RangeData, voxel_filter_indices};

use super::super::SweepPoint;
use super::posts::PostsToMatch;
use super::unwarp::Gathered;

/// So many points of a sweep are matched, spread evenly over what it sees.
const WANTED_POINTS: f32 = 1500.0;
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
/// How far off the end of the sweep before may be, metres and radians (standard deviations); turns that a gyroscope
/// told may be as far off there as at the end of this sweep. A start held faster than its way is a trap: errors of one
/// sweep come back in the next with the opposite sign. Corridor_imu without its IMU is lost with 0.002, and 0.031 m off
/// with anything from 0.005 to 0.05; a gyroscope with swapped axes or a bias turns maps with a half of this.
const LAST_END: Sigmas = Sigmas { shift: 0.01, turn: 0.01 };
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
    pub fn contradicts_turn(&self, way: &Way) -> bool {
        let error = way.end().rotation.angle_to(&self.local_from_tracking.rotation);
        self.found.is_some() && error > CONTRADICTION_SIGMAS * rotation_sigma(way)
    }

    /// How well it fits: the share of points on surfaces, less if they lie far off.
    pub fn fit(&self) -> f64 {
        self.found.as_ref().map_or(0.0, |f| f.matched_share / (1.0 + (f.rms / POOR_RMS).powi(2)))
    }
}

/// How far off the turn of a predicted way may be, radians (standard deviation).
fn rotation_sigma(way: &Way) -> f64 {
    let seconds = way.seconds();
    match way.turn_is_measured {
        true => 0.002 + GYROSCOPE_ERROR * seconds,
        false => 0.005 + 0.5 * TURN_ACCELERATION * seconds * seconds,
    }
}

/// What a sweep is matched to.
pub(super) struct Target<'a> {
    pub local_from_submap: &'a Rigid3,
    /// In the frame of the submap.
    pub surfaces: &'a SurfaceMap,
    pub posts: Option<&'a PostsToMatch>,
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
        let mut sweep = Vec::with_capacity(gathered.iter().map(Gathered::len).sum());
        sweep.extend(usable.map(|p| SweepPoint {
            offset: p.time.seconds_since(end).min(0.0) as f32,
            position: p.position,
            intensity: p.intensity,
        }));
        sweep
    }

    /// A selection that covers everything seen, in the order of time.
    pub fn selection(&mut self, sweep: &[SweepPoint]) -> Vec<SweptPoint> {
        let kept = voxel_filter_indices(sweep, |p| p.position, self.spacing);
        if !kept.is_empty() {
            let correction = (kept.len() as f32 / WANTED_POINTS).sqrt().clamp(0.7, 1.4);
            self.spacing = (self.spacing * correction).clamp(0.02, 5.0);
        }
        let swept = |p: &SweepPoint| SweptPoint { offset: p.offset, position: p.position };
        let mut selection: Vec<SweptPoint> =
            kept.into_iter().filter_map(|i| sweep.get(i as usize).map(swept)).collect();
        selection.sort_by(|a, b| a.offset.total_cmp(&b.offset));
        selection
    }

    /// Finds the way of a sweep on the surfaces of a submap.
    pub fn match_sweep(&self, selection: &[SweptPoint], way: &Way, target: &Target) -> MatchedSweep {
        let &Target { local_from_submap, surfaces, posts } = target;
        let seconds = way.seconds();
        let bend = Sigmas {
            shift: match way.going {
                Going::Measured => 0.01 + ODOMETRY_ERROR * seconds,
                Going::Felt(velocity_error) => 0.005 + velocity_error * seconds,
                Going::AsBefore => 0.01 + 0.5 * ACCELERATION * seconds * seconds,
            },
            turn: rotation_sigma(way),
        };
        let start = match way.turn_is_measured {
            true => Sigmas { turn: bend.turn, ..LAST_END },
            false => LAST_END,
        };
        let prior = WayPrior { start, bend, is_felt: matches!(way.going, Going::Felt(_)) };
        let scale = START_SCALE.max(SCALE_OF_SIGMA * bend.shift).min(2.0);
        let in_submap = way.seen_from(&local_from_submap.inverse());
        let posts = posts.map(|posts| (&posts.map, &posts.points[..]));
        let found = self.matcher.match_sweep(surfaces, selection, &in_submap, &prior, scale, posts);
        let found = found.filter(|found| found.matched_share >= MIN_MATCHED_SHARE);
        let correction = found.as_ref().map_or_else(WayCorrection::default, |found| found.correction);
        MatchedSweep {
            local_from_tracking: local_from_submap * in_submap.corrected_end(&correction),
            pieces: in_submap.bent_to_end(&correction),
            found,
        }
    }
}

/// The sweep as seen from its end.
pub(super) fn in_tracking(sweep: &[SweepPoint], pieces: &StraightPieces, use_intensities: bool) -> RangeData {
    let points: Vec<Point3f> = sweep.iter().map(|p| pieces.moved(&p.position, p.offset)).collect();
    let intensities = match use_intensities {
        true => sweep.iter().map(|p| p.intensity).collect(),
        false => Vec::new(),
    };
    let returns = PointCloud { points, intensities };
    RangeData { origin: Point3f::origin(), returns, misses: PointCloud::default() }
}
