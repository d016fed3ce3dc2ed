//! The first two sweeps: how fast everything was already moving, and which way is up without an IMU.
//!
//! The first sweep is a reference; the second is aligned to it coarsely, then registered to its planes. The velocity that
//! this gives de-skews both, and so on, a few times.

use portolan_geometry::{
    Point3f, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
    rotation_between,
};
use portolan_sensor::voxel_filter_points;

use crate::coarse_alignment::coarse_alignment;
use crate::deskew::PiecewiseLinearTrajectory;
use crate::plane_map::PlaneMap;
use crate::registration::{PosePrior, Registration, Sigmas};
use crate::segment::{SegmentCorrection, TrajectorySegment};
use crate::settings::{OdometrySettings, RegistrationSettings};
use crate::sweep::Sweep;
use crate::vertical::vertical_from_planes;

/// The first sweeps, and what is known of the motion then.
pub(crate) struct FirstSweeps<'a> {
    first: &'a Sweep,
    second: Option<&'a Sweep>,
    /// What a gyroscope says of the rotation (tracking in local), if there is one.
    rotation_at: Option<&'a dyn Fn(Time) -> Quaternion>,
    settings: &'a OdometrySettings,
    /// Tracking in local at the end of the first sweep.
    rotation: Quaternion,
    /// In the local map, m/s.
    velocity: Vector3,
    /// In the tracking frame, rad/s; zero where a gyroscope measures.
    turn_rate: Vector3,
}

/// A sweep as a place to be in.
pub(crate) struct Reference {
    planes: PlaneMap,
    /// Points that are not on the ground.
    pub upright: Vec<Point3f>,
}

impl<'a> FirstSweeps<'a> {
    /// Finds out how it all started.
    pub fn new(
        first: &'a Sweep,
        second: Option<&'a Sweep>,
        rotation_at: Option<&'a dyn Fn(Time) -> Quaternion>,
        settings: &'a OdometrySettings,
    ) -> Self {
        let mut sweeps = Self {
            first,
            second: second.filter(|s| s.end > first.end),
            rotation_at,
            settings,
            rotation: rotation_at.map_or_else(Quaternion::identity, |rotation| rotation(first.end)),
            velocity: Vector3::zeros(),
            turn_rate: Vector3::zeros(),
        };
        let mut reference = sweeps.reference();
        for iteration in 0..settings.initialisation.iterations {
            let Some(motion) = sweeps.second.and_then(|s| sweeps.motion(&reference, s, iteration == 0))
            else {
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
            let up = vertical_from_planes(&reference.planes, &Vector3::z(), &settings.vertical);
            sweeps.rotation = rotation_between(&up.unwrap_or_else(Vector3::z), &Vector3::z());
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

    /// Motion compensation of a sweep.
    pub fn deskewing(&self, sweep: &Sweep) -> PiecewiseLinearTrajectory {
        let segment = TrajectorySegment::new(sweep.begin(), sweep.end, |t| self.pose_at(t));
        segment.deskewing(&SegmentCorrection::default())
    }

    /// A sweep as seen from its end.
    fn deskewed(&self, sweep: &Sweep) -> Vec<Point3f> {
        let to_end = self.deskewing(sweep);
        sweep.points.iter().map(|p| to_end.moved(&p.position, p.time)).collect()
    }

    fn reference(&self) -> Reference {
        Reference::new(&self.deskewed(self.first), self.settings)
    }

    /// The second pose in the first.
    fn motion(&self, reference: &Reference, second: &Sweep, is_first_iteration: bool) -> Option<Rigid3> {
        let all = self.deskewed(second);
        let believed = self.pose_at(self.first.end).inverse() * self.pose_at(second.end);
        let points = voxel_filter_points(&all, self.settings.initialisation.spacing);
        let coarse = is_first_iteration.then(|| {
            let own = Reference::new(&all, self.settings);
            let settings = &self.settings.coarse_alignment;
            coarse_alignment(&reference.upright, &own.upright, &believed, settings)
        });
        let mut initial = [coarse.flatten(), Some(believed)].into_iter().flatten();
        initial.find_map(|initial| self.register(reference, &points, &initial))
    }

    /// The second pose in the first near another one, if the points constrain it.
    fn register(&self, reference: &Reference, points: &[Point3f], initial: &Rigid3) -> Option<Rigid3> {
        let settings = &self.settings.initialisation;
        let sigmas = Sigmas { translation: settings.translation_sigma, rotation: settings.rotation_sigma };
        let prior = PosePrior { pose: *initial, sigmas };
        let registration = Registration::new(RegistrationSettings {
            final_scale: self.settings.sweep.final_scale_per_edge * self.settings.local_map.voxel_size,
            ..self.settings.registration.clone()
        });
        let found = registration.register_scan(&reference.planes, points, initial, &prior, settings.scale)?;
        // A single sparse sweep among trees shows few planes, but they constrain translation if not rotation, too.
        let constrains_translation = self.rotation_at.is_some() && found.degenerate.translations.is_empty();
        let is_enough = found.matched_fraction >= settings.min_matched_fraction || constrains_translation;
        is_enough.then_some(found.pose)
    }
}

impl Reference {
    /// Of points in a level frame.
    pub fn new(points: &[Point3f], settings: &OdometrySettings) -> Self {
        let mut planes =
            PlaneMap::with_settings(settings.local_map.voxel_size as f32, settings.plane_fit.clone());
        points.iter().for_each(|p| planes.insert(p));
        let ground_normal = settings.initialisation.ground_normal;
        let is_ground =
            |p: &Point3f| planes.plane_near(p).is_some_and(|plane| plane.normal.z.abs() > ground_normal);
        let upright = voxel_filter_points(points, settings.initialisation.spacing)
            .into_iter()
            .filter(|p| !is_ground(p))
            .collect();
        Self { planes, upright }
    }
}
