//! Estimates the initial velocity, and without an IMU the vertical, from the first two sweeps.
//!
//! The first sweep is a reference; the second is correlated with it, then registered to its planes. The
//! resulting velocity de-skews both, and this is repeated a few times.

use portolan_geometry::{
    Point3f, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
    rotation_between, to_f32,
};
use portolan_sensor::voxel_filter_points;

use crate::correlation::{CorrelationReference, Peak, Window, upright};
use crate::deskew::PiecewiseLinearTrajectory;
use crate::plane_map::PlaneMap;
use crate::registration::{PosePrior, Registration};
use crate::segment::{SegmentCorrection, TrajectorySegment};
use crate::settings::OdometrySettings;
use crate::settings::constants::initialise::{
    COARSE, ITERATIONS, LEVEL_TILT, PROMISING_FRACTION, UNPREDICTED_FACTOR,
};
use crate::sweep::Sweep;
use crate::travel_correlation::is_horizontal;
use crate::vertical::vertical_from_planes;

/// The rotation at a time, from the tracking frame to a gravity-aligned one.
pub(crate) type RotationAt<'a> = dyn Fn(Time) -> Quaternion + 'a;

/// Motion and vertical at the end of the first sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    /// Rotation of the tracking frame in the local map.
    rotation: Quaternion,
    /// In the local map, m/s.
    velocity: Vector3,
    /// In the tracking frame, rad/s; zero where a gyroscope measures.
    turn_rate: Vector3,
    /// Whether planes do not constrain a horizontal translation, so that the velocity along it is
    /// uncertain.
    is_open: bool,
}

impl Start {
    /// m/s in the tracking frame.
    pub fn velocity_in_tracking(&self) -> Vector3 {
        self.rotation.inverse() * self.velocity
    }

    /// m/s in the local map.
    pub fn velocity(&self) -> Vector3 {
        self.velocity
    }

    /// The start with this added to its velocity, m/s in the local map.
    pub fn faster_by(self, velocity: &Vector3) -> Self {
        Self { velocity: self.velocity + velocity, ..self }
    }

    /// Whether planes do not constrain a horizontal translation, so that the velocity along it is
    /// uncertain.
    pub fn is_open(&self) -> bool {
        self.is_open
    }

    /// In the tracking frame, rad/s; zero where a gyroscope measures.
    pub fn turn_rate(&self) -> Vector3 {
        self.turn_rate
    }
}

/// The first sweep, and the assumed motion at that time.
#[derive(Clone)]
pub(crate) struct FirstSweeps<'a> {
    first: &'a Sweep,
    /// Rotation by a gyroscope (tracking in local), if there is one.
    rotation_at: Option<&'a RotationAt<'a>>,
    settings: &'a OdometrySettings,
    start: Start,
}

/// A sweep registered to another one.
struct Relative {
    /// The second pose in the first.
    motion: Rigid3,
    /// Fit of the points that constrain the motion.
    fit: f64,
    /// Whether planes do not constrain a horizontal translation.
    is_open: bool,
}

/// The motion between the first two sweeps.
enum FirstMotion {
    /// One of these registrations, which differ and fit well enough to be tracked.
    Registered(Vec<Relative>),
    /// The sweeps do not show the same structures: later sweeps have to decide between these motions.
    Undecided(Vec<Rigid3>),
}

impl<'a> FirstSweeps<'a> {
    /// First sweeps under this hypothesis of the motion.
    pub fn new(
        first: &'a Sweep,
        rotation_at: Option<&'a RotationAt<'a>>,
        settings: &'a OdometrySettings,
        start: Start,
    ) -> Self {
        Self { first, rotation_at, settings, start }
    }

    /// Hypotheses of the initial motion, the most likely first. At speed a street may look alike after one
    /// step and after two: each pose in the first sweep at which the second one fits about as well is a
    /// hypothesis.
    pub fn hypotheses(
        first: &'a Sweep,
        second: Option<&Sweep>,
        rotation_at: Option<&'a RotationAt<'a>>,
        settings: &'a OdometrySettings,
    ) -> Vec<Start> {
        let rotation = rotation_at.map_or_else(Quaternion::identity, |rotation| rotation(first.end));
        let start =
            Start { rotation, velocity: Vector3::zeros(), turn_rate: Vector3::zeros(), is_open: true };
        let as_mounted = Self::new(first, rotation_at, settings, start);
        let reference = as_mounted.deskewed(first);
        let planes = planes_of(&reference, settings);
        let level = as_mounted.leveled(&planes);
        let still =
            if is_not_level(&level.rotation) { Self { start: level, ..as_mounted } } else { as_mounted };
        let Some(second) = second.filter(|s| s.end > first.end) else {
            return vec![still.leveled(&planes)];
        };
        let mut starts = match still.first_motion((&reference, &planes), second) {
            FirstMotion::Registered(found) => still.all_followed(found, second),
            FirstMotion::Undecided(motions) => {
                let seconds = second.end.seconds_since(first.end);
                motions
                    .iter()
                    .map(|motion| still.clone().moving_by(motion, seconds).leveled(&planes))
                    .collect()
            }
        };
        if starts.is_empty() {
            starts.push(still.leveled(&planes));
        }
        starts.truncate(settings.correlation.max_peaks);
        starts
    }

    /// Refines all first registrations, the best first.
    fn all_followed(&self, looks: Vec<Relative>, second: &Sweep) -> Vec<Start> {
        let least = self.settings.loss.poor_fit_ratio;
        let same_velocity =
            f64::from(self.settings.correlation.cell) / second.end.seconds_since(self.first.end);
        let mut found: Vec<(Start, f64)> = Vec::new();
        for relative in looks {
            let (start, fit) = self.clone().followed(relative, second);
            let is_known =
                |(other, _): &(Start, f64)| (other.velocity - start.velocity).norm() < same_velocity;
            if !found.iter().any(is_known) {
                found.push((start, fit));
            }
        }
        let best = found.iter().map(|(_, fit)| *fit).fold(0.0, f64::max);
        found.retain(|(_, fit)| *fit >= least * best);
        found.sort_by(|a, b| b.1.total_cmp(&a.1));
        found.into_iter().map(|(start, _)| start).collect()
    }

    /// Registers the second sweep to the first from all coarse matches, both without correction of
    /// de-skewing.
    fn first_motion(&self, (reference, planes): (&[Point3f], &PlaneMap), second: &Sweep) -> FirstMotion {
        let deskewed = self.deskewed(second);
        let peaks = self.coarse_motions(reference, &deskewed, second);
        let assumed = self.assumed_motion(second);
        let share = peaks.first().map(|(_, share)| *share);
        let places: Vec<Rigid3> = peaks.into_iter().map(|(motion, _)| motion).collect();
        match share {
            None => FirstMotion::Registered(self.registered(planes, &deskewed, &[assumed])),
            Some(share) if share < self.settings.correlation.min_share => {
                FirstMotion::Undecided(std::iter::once(assumed).chain(places).collect())
            }
            Some(_) => {
                let mut found = self.registered(planes, &deskewed, &places);
                if found.is_empty() {
                    // Single sparse sweeps may have no planes.
                    found.extend(places.first().map(|motion| Relative {
                        motion: *motion,
                        fit: 0.0,
                        is_open: true,
                    }));
                }
                FirstMotion::Registered(found)
            }
        }
    }

    /// The second sweep (de-skewed) registered to the first from each of these poses: results that differ,
    /// and fit well enough to be tracked.
    fn registered(&self, planes: &PlaneMap, deskewed: &[Point3f], places: &[Rigid3]) -> Vec<Relative> {
        let points = voxel_filter_points(deskewed, self.settings.first_spacing());
        let same_motion = f64::from(self.settings.correlation.cell);
        let mut found: Vec<Relative> = Vec::new();
        for initial in places {
            let Some(relative) = self.register(planes, &points, initial) else { continue };
            let place = relative.motion.translation.vector;
            if found.iter().all(|other| (other.motion.translation.vector - place).norm() >= same_motion) {
                found.push(relative);
            }
        }
        let best = found.iter().map(|relative| relative.fit).fold(0.0, f64::max);
        found
            .retain(|relative| relative.fit >= PROMISING_FRACTION * self.settings.loss.poor_fit_ratio * best);
        found
    }

    /// Coarse poses of the second sweep in the first, the likeliest first, each with the fraction of
    /// upright structures that is met again; none where there are too few of them.
    fn coarse_motions(
        &self,
        reference: &[Point3f],
        deskewed: &[Point3f],
        second: &Sweep,
    ) -> Vec<(Rigid3, f64)> {
        let settings = &self.settings.correlation;
        let seconds = second.end.seconds_since(self.first.end);
        let window = Window::after(seconds, self.rotation_at.is_some(), settings);
        // Both relative to the scanner, and level if it is mounted at an angle.
        let is_tilted = is_not_level(&self.pose_at(self.first.end).rotation);
        let [local_from_first, local_from_second] = [self.first.end, second.end].map(|end| {
            let rotation = if is_tilted { self.pose_at(end).rotation } else { Quaternion::identity() };
            Rigid3::from_parts(Default::default(), rotation)
        });
        let level = |points: &[Point3f], rotation: &Rigid3| -> Vec<Point3f> {
            let rotation = to_f32(rotation);
            points.iter().map(|p| rotation * p).collect()
        };
        let reference =
            CorrelationReference::new(&upright(&level(reference, &local_from_first), settings), settings);
        let initial = local_from_first * self.assumed_motion(second) * local_from_second.inverse();
        let peaks = reference.peaks(&level(deskewed, &local_from_second), &initial, window);
        let first_from_second = |peak: Peak| local_from_first.inverse() * peak.pose * local_from_second;
        peaks.into_iter().map(|peak| (first_from_second(peak), peak.share)).collect()
    }

    /// Refines a first registration: its velocity de-skews both sweeps, the second is registered to the
    /// first once more, and so on. Gives the start with its final fit.
    fn followed(mut self, mut relative: Relative, second: &Sweep) -> (Start, f64) {
        let seconds = second.end.seconds_since(self.first.end);
        self.move_by(&relative.motion, seconds);
        for _ in 1..ITERATIONS {
            let points = voxel_filter_points(&self.deskewed(second), self.settings.first_spacing());
            let Some(next) = self.register(&self.planes(), &points, &self.assumed_motion(second)) else {
                break;
            };
            relative = next;
            self.move_by(&relative.motion, seconds);
        }
        let mut start = if self.rotation_at.is_none() { self.leveled(&self.planes()) } else { self.start };
        start.is_open = relative.is_open;
        (start, relative.fit)
    }

    fn moving_by(mut self, motion: &Rigid3, seconds: f64) -> Self {
        self.move_by(motion, seconds);
        self
    }

    /// Sets the velocity from the motion between the sweeps.
    fn move_by(&mut self, motion: &Rigid3, seconds: f64) {
        self.start.velocity = self.start.rotation * motion.translation.vector / seconds;
        if self.rotation_at.is_none() {
            self.start.turn_rate = angle_axis_from_quaternion(&motion.rotation) / seconds;
        }
    }

    /// The start, with the vertical from planes where there is no IMU.
    fn leveled(&self, planes: &PlaneMap) -> Start {
        let mut start = self.start;
        if self.rotation_at.is_none() {
            let up = vertical_from_planes(planes, &Vector3::z(), &self.settings.vertical);
            start.rotation = rotation_between(&up.unwrap_or_else(Vector3::z), &Vector3::z());
            start.velocity = start.rotation * self.start.velocity_in_tracking();
        }
        start
    }

    /// The assumed pose at the end of the second sweep in that of the first.
    fn assumed_motion(&self, second: &Sweep) -> Rigid3 {
        self.pose_at(self.first.end).inverse() * self.pose_at(second.end)
    }

    /// The pose at a time; the first sweep ended at the origin of the local map.
    pub fn pose_at(&self, time: Time) -> Rigid3 {
        let seconds = time.seconds_since(self.first.end);
        let rotation = match self.rotation_at {
            Some(rotation) => rotation(time),
            None => self.start.rotation * quaternion_from_angle_axis(&(self.start.turn_rate * seconds)),
        };
        Rigid3::from_parts((self.start.velocity * seconds).into(), rotation)
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

    /// Planes of the first sweep.
    fn planes(&self) -> PlaneMap {
        planes_of(&self.deskewed(self.first), self.settings)
    }

    /// The second pose in the first near an initial one, if the points constrain it.
    fn register(&self, planes: &PlaneMap, points: &[Point3f], initial: &Rigid3) -> Option<Relative> {
        let prior = PosePrior { pose: *initial, sigmas: COARSE };
        let registration = Registration::new(self.settings.registration.clone());
        let scale = f64::from(self.settings.correlation.cell);
        let found = registration.register_scan(planes, points, initial, &prior, scale)?;
        // A single sparse sweep among trees has few planes, but they may constrain translation even if not
        // rotation.
        let constrains_translation = self.rotation_at.is_some() && found.degenerate.translations.is_empty();
        let least = UNPREDICTED_FACTOR * self.settings.registration.min_matched_fraction;
        let is_enough = found.matched_fraction >= least || constrains_translation;
        let fit = found.evidence(self.settings.final_scale());
        let open = &found.degenerate.translations;
        let is_open = open.iter().any(|open| is_horizontal(&(self.start.rotation * open)));
        is_enough.then_some(Relative { motion: found.pose, fit, is_open })
    }
}

/// Whether the tracking frame is tilted so much that upright structures have to be searched in a level
/// one.
fn is_not_level(local_from_tracking: &Quaternion) -> bool {
    (local_from_tracking * Vector3::z()).z < LEVEL_TILT.cos()
}

fn planes_of(points: &[Point3f], settings: &OdometrySettings) -> PlaneMap {
    let mut planes =
        PlaneMap::with_settings(settings.local_map.voxel_size as f32, settings.plane_fit.clone());
    planes.insert_all(points.iter().copied(), &Point3f::origin());
    planes
}
