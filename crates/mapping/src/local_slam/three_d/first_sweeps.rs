//! The first two sweeps: how fast everything was already moving, and which way is up without an IMU.

use portolan_geometry::{
    Duration, Point3f, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion,
    quaternion_from_angle_axis, rotation_between,
};
use portolan_lidar_odometry::{
    PosePrior, Sigmas, StraightPieces, SurfaceMap, SurfaceMatcher, SurfaceMatcherOptions, Way, WayCorrection,
    align_coarsely, up_direction,
};
use portolan_sensor::voxel_filter_points;

use super::super::SweepPoint;

/// Velocity and the sweeps that it unwarps are found in turns.
const TURNS: u32 = 4;
/// A match of fewer points is no match, unless a gyroscope tells the turn and they tell every shift.
const MIN_MATCHED_SHARE: f64 = 0.3;
/// Points may be off by this much once velocities have been found coarsely, metres.
const SCALE: f64 = 0.5;
/// Spacing of the points that are matched, metres.
const SPACING: f32 = 0.4;
/// A surface that faces up this much (cosine) is ground.
const GROUND: f32 = 0.8;

/// A sweep with the time of its end.
pub(super) struct TimedSweep {
    pub end: Time,
    pub points: Vec<SweepPoint>,
}

/// The first sweeps, and what is known of the motion then.
pub(super) struct FirstSweeps<'a> {
    first: &'a TimedSweep,
    second: Option<&'a TimedSweep>,
    /// What a gyroscope says of the rotation (tracking in local), if there is one.
    rotation_at: Option<&'a dyn Fn(Time) -> Quaternion>,
    voxel_size: f64,
    /// Tracking in local at the end of the first sweep.
    rotation: Quaternion,
    /// In the local map, m/s.
    velocity: Vector3,
    /// In the tracking frame, rad/s; zero where a gyroscope tells.
    turn_rate: Vector3,
}

/// A sweep as a place to be in.
struct Reference {
    surfaces: SurfaceMap,
    /// Without the ground.
    upright: Vec<Point3f>,
}

impl<'a> FirstSweeps<'a> {
    /// Finds out how it all started.
    pub fn new(
        first: &'a TimedSweep,
        second: Option<&'a TimedSweep>,
        rotation_at: Option<&'a dyn Fn(Time) -> Quaternion>,
        voxel_size: f64,
    ) -> Self {
        let mut sweeps = Self {
            first,
            second: second.filter(|s| s.end > first.end),
            rotation_at,
            voxel_size,
            rotation: rotation_at.map_or_else(Quaternion::identity, |rotation| rotation(first.end)),
            velocity: Vector3::zeros(),
            turn_rate: Vector3::zeros(),
        };
        let mut reference = sweeps.reference();
        for turn in 0..TURNS {
            let Some(motion) = sweeps.second.and_then(|s| sweeps.motion(&reference, s, turn == 0)) else {
                break;
            };
            let interval = sweeps.second.map_or(1.0, |s| s.end.seconds_since(first.end));
            sweeps.velocity = sweeps.rotation * motion.translation.vector / interval;
            if rotation_at.is_none() {
                sweeps.turn_rate = angle_axis_from_quaternion(&motion.rotation) / interval;
            }
            reference = sweeps.reference();
        }
        if rotation_at.is_none() {
            let up = up_direction(&reference.surfaces, &Vector3::z()).unwrap_or_else(Vector3::z);
            sweeps.rotation = rotation_between(&up, &Vector3::z());
            sweeps.velocity = sweeps.rotation * sweeps.velocity;
        }
        sweeps
    }

    /// The pose at a time; the first sweep ended at the origin of the local map.
    pub fn pose_at(&self, time: Time) -> Rigid3 {
        let seconds = time.seconds_since(self.first.end);
        let rotation = match self.rotation_at {
            Some(rotation) => rotation(time),
            None => self.rotation * quaternion_from_angle_axis(&(self.turn_rate * seconds)),
        };
        Rigid3::from_parts((self.velocity * seconds).into(), rotation)
    }

    /// The way on which a sweep was measured.
    pub fn pieces(&self, sweep: &TimedSweep) -> StraightPieces {
        let longest = sweep.points.iter().map(|p| -p.offset).fold(0.0, f32::max);
        let begin = sweep.end - Duration::from_seconds(f64::from(longest));
        let way = Way::new(begin, sweep.end, |t| self.pose_at(t));
        way.bent_to_end(&WayCorrection::default())
    }

    /// A sweep as seen from its end.
    fn seen(&self, sweep: &TimedSweep) -> Vec<Point3f> {
        let pieces = self.pieces(sweep);
        sweep.points.iter().map(|p| pieces.moved(&p.position, p.offset)).collect()
    }

    fn reference(&self) -> Reference {
        surfaces_of(&self.seen(self.first), self.voxel_size)
    }

    /// The second pose in the first.
    fn motion(&self, reference: &Reference, second: &TimedSweep, is_first_turn: bool) -> Option<Rigid3> {
        let all = self.seen(second);
        let believed = self.pose_at(self.first.end).inverse() * self.pose_at(second.end);
        let points = voxel_filter_points(&all, SPACING);
        let coarse = is_first_turn.then(|| {
            let own = surfaces_of(&all, self.voxel_size);
            align_coarsely(&reference.upright, &own.upright, &believed)
        });
        let mut initial = [coarse.flatten(), Some(believed)].into_iter().flatten();
        initial.find_map(|initial| self.match_near(reference, &points, &initial))
    }

    /// The second pose in the first as the points tell it, if they do.
    fn match_near(&self, reference: &Reference, points: &[Point3f], initial: &Rigid3) -> Option<Rigid3> {
        let prior = PosePrior { pose: *initial, sigmas: Sigmas { shift: 1.0, turn: 0.1 } };
        let options =
            SurfaceMatcherOptions { final_scale: 0.1 * self.voxel_size, ..SurfaceMatcherOptions::default() };
        let found =
            SurfaceMatcher::new(options).match_scan(&reference.surfaces, points, initial, &prior, SCALE)?;
        // A single sparse sweep among trees shows few surfaces, but they tell how fast it goes if not how it turns, too.
        let tells_shift = self.rotation_at.is_some() && found.weak.translations.is_empty();
        (found.matched_share >= MIN_MATCHED_SHARE || tells_shift).then_some(found.pose)
    }
}

fn surfaces_of(points: &[Point3f], voxel_size: f64) -> Reference {
    let mut surfaces = SurfaceMap::new(voxel_size as f32);
    points.iter().for_each(|p| surfaces.insert(p));
    let is_ground = |p: &Point3f| surfaces.plane_near(p).is_some_and(|plane| plane.normal.z.abs() > GROUND);
    let upright = voxel_filter_points(points, SPACING).into_iter().filter(|p| !is_ground(p)).collect();
    Reference { surfaces, upright }
}
