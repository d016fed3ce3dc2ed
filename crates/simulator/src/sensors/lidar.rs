//! A spinning planar lidar: every beam is fired from the moving robot at its own time.

use std::sync::Arc;

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, Time, Vector2};
use portolan_recording::{Header, LaserScan};

use crate::motion::Walk;
use portolan_worlds::Random;
use portolan_worlds::two_d::{Hit, NearbyPeople, Ray, World};

/// Mounting of a lidar.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LidarMount {
    /// Metres ahead of `base_link`.
    pub x: f64,
    /// Metres to the left of `base_link`.
    pub y: f64,
    /// Metres above `base_link`; it has no effect on the beams, which stay in their plane.
    pub z: f64,
    /// Radians to the left.
    pub yaw: f64,
    /// Whether it hangs upside down (rolled by half a turn), so that it spins in the opposite direction.
    pub upside_down: bool,
}

/// Value in a scan for a beam without a return.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NoReturn {
    /// +∞, and −∞ for a surface that is too near (REP 117).
    #[default]
    Infinity,
    /// `range_max` + 1 m.
    BeyondMaximum,
    /// 0, as many small lidars do.
    Zero,
    /// NaN.
    NotANumber,
}

/// A planar lidar.
#[derive(Clone, Debug, PartialEq)]
pub struct LidarOptions {
    /// Topic of its `sensor_msgs/LaserScan`. Default `/scan`.
    pub topic: String,
    /// Its frame. Default `laser`.
    pub frame: String,
    /// Its mounting on the robot. Default 0.12 m ahead, 0.2 m up, looking ahead.
    pub mount: LidarMount,
    /// Scans per second. Default 10.
    pub rate: f64,
    /// Beams per scan. Default 360.
    pub beams: usize,
    /// Angle between first and last beam, radians; 2π for a full circle, where the last beam comes one
    /// step before the first. Default 2π.
    pub field_of_view: f64,
    /// Whether the head spins clockwise (negative `angle_increment`). Default no.
    pub clockwise: bool,
    /// Minimum range that is measured, metres. Default 0.1.
    pub range_min: f64,
    /// Maximum range that is measured, metres. Default 12.
    pub range_max: f64,
    /// Standard deviation of ranges, metres. Default 0.01.
    pub range_noise: f64,
    /// Further standard deviation as a fraction of the range. Default 0.002.
    pub range_noise_relative: f64,
    /// Resolution of ranges, metres; 0 for none. Default 0.001.
    pub range_resolution: f64,
    /// Probability that a beam has no return although it hits a surface. Default 0.005.
    pub drop_out: f64,
    /// Width of the beam, radians: where its two sides hit different surfaces there may be mixed pixels.
    /// Default 0.004.
    pub beam_divergence: f64,
    /// Probability of a range between the two surfaces where the beam hits an edge. Default 0.3.
    pub mixed_pixels: f64,
    /// Whether panes give a return or are passed at random; otherwise they are always passed. Default yes.
    pub glass_returns: bool,
    /// How a missing return is written.
    pub no_return: NoReturn,
    /// Whether every beam is fired at its own time, `time_increment` after the one before; otherwise
    /// all are fired at the stamp and `time_increment` is 0. Default yes.
    pub motion_distortion: bool,
    /// Whether scans carry intensities. Default yes.
    pub intensities: bool,
}

impl Default for LidarOptions {
    fn default() -> Self {
        Self {
            topic: "/scan".to_owned(),
            frame: "laser".to_owned(),
            mount: LidarMount { x: 0.12, y: 0.0, z: 0.2, yaw: 0.0, upside_down: false },
            rate: 10.0,
            beams: 360,
            field_of_view: std::f64::consts::TAU,
            clockwise: false,
            range_min: 0.1,
            range_max: 12.0,
            range_noise: 0.01,
            range_noise_relative: 0.002,
            range_resolution: 0.001,
            drop_out: 0.005,
            beam_divergence: 0.004,
            mixed_pixels: 0.3,
            glass_returns: true,
            no_return: NoReturn::default(),
            motion_distortion: true,
            intensities: true,
        }
    }
}

impl LidarOptions {
    /// The same lidar without any error: exact ranges, no drop-outs, no mixed pixels, no returns from
    /// panes.
    pub fn without_noise(self) -> Self {
        Self {
            range_noise: 0.0,
            range_noise_relative: 0.0,
            range_resolution: 0.0,
            drop_out: 0.0,
            mixed_pixels: 0.0,
            glass_returns: false,
            ..self
        }
    }

    /// Pose of the lidar on the robot.
    pub fn base_from_lidar(&self) -> Rigid3 {
        let LidarMount { x, y, z, yaw, upside_down } = self.mount;
        let (sine, cosine) = libm::sincos(0.5 * yaw);
        // Rz(yaw) Rx(π) = (cos, 0, 0, sin) ⊗ (0, 1, 0, 0) = (0, cos, sin, 0).
        let q = if upside_down {
            na::Quaternion::new(0.0, cosine, sine, 0.0)
        } else {
            na::Quaternion::new(cosine, 0.0, 0.0, sine)
        };
        Rigid3::from_parts(na::Translation3::new(x, y, z), Quaternion::new_unchecked(q))
    }
}

/// A lidar ready to measure.
#[derive(Clone, Debug)]
pub(crate) struct Lidar {
    pub options: LidarOptions,
    pub topic: Arc<str>,
    frame: Arc<str>,
    seed: u64,
    origin_in_base: Vector2,
    /// Unit vectors in `base_link`.
    directions_in_base: Vec<Vector2>,
    angle_min: f32,
    angle_increment: f32,
    time_increment: f32,
    /// (cos, sin) of half the divergence.
    half_divergence: Vector2,
}

/// Difference of the ranges of the two sides of a beam above which it is on an edge, metres.
const EDGE: f64 = 0.08;

impl Lidar {
    pub fn new(options: LidarOptions, seed: u64) -> Self {
        let tau = std::f64::consts::TAU;
        let full_circle = options.field_of_view > tau - 1e-6;
        let gaps = if full_circle { options.beams } else { options.beams.saturating_sub(1).max(1) };
        let sign = if options.clockwise { -1.0 } else { 1.0 };
        let angle_increment = (sign * options.field_of_view.min(tau) / gaps as f64) as f32;
        let angle_min = (-0.5 * sign * options.field_of_view.min(tau)) as f32;
        let time_increment = match options.motion_distortion {
            true => (f64::from(angle_increment.abs()) / tau / options.rate) as f32,
            false => 0.0,
        };
        let base_from_lidar = options.base_from_lidar();
        let directions_in_base = (0..options.beams)
            .map(|i| {
                let (sine, cosine) =
                    libm::sincos(f64::from(angle_min) + i as f64 * f64::from(angle_increment));
                (base_from_lidar.rotation * na::Vector3::new(cosine, sine, 0.0)).xy()
            })
            .collect();
        let (sine, cosine) = libm::sincos(0.5 * options.beam_divergence);
        Self {
            topic: options.topic.as_str().into(),
            frame: options.frame.as_str().into(),
            seed,
            origin_in_base: base_from_lidar.translation.vector.xy(),
            directions_in_base,
            angle_min,
            angle_increment,
            time_increment,
            half_divergence: Vector2::new(cosine, sine),
            options,
        }
    }

    /// Seconds from the first to the last beam.
    pub fn sweep_time(&self) -> f64 {
        f64::from(self.time_increment) * self.options.beams.saturating_sub(1) as f64
    }

    /// Scan number `index`, whose first beam is fired at `time` seconds of the walk.
    pub fn scan(&self, world: &World, walk: &Walk, index: u64, time: f64, stamp: Time) -> LaserScan {
        let mut random = Random::new(self.seed, &self.topic, index);
        let half_sweep = 0.5 * self.sweep_time();
        let middle = walk.state_2d(time + half_sweep);
        let people = NearbyPeople::around(
            world.people(),
            time + half_sweep,
            half_sweep,
            &middle.position,
            self.options.range_max + 2.0,
        );
        let mut ranges = Vec::with_capacity(self.options.beams);
        let mut intensities =
            Vec::with_capacity(if self.options.intensities { self.options.beams } else { 0 });
        for (i, direction) in self.directions_in_base.iter().enumerate() {
            let beam_time = time + i as f64 * f64::from(self.time_increment);
            let state = walk.state_2d(beam_time);
            let (robot, d) = (state.position, state.direction);
            let to_map = |v: &Vector2| Vector2::new(d.x * v.x - d.y * v.y, d.y * v.x + d.x * v.y);
            let ray = Ray { origin: robot + to_map(&self.origin_in_base), direction: to_map(direction) };
            let scene = BeamScene { world, people: &people, time: beam_time, robot };
            let hit = self.measure(&scene, &ray, &mut random);
            ranges.push(self.range_value(hit.as_ref()));
            if self.options.intensities {
                intensities.push(hit.map_or(0.0, |h| intensity(&h, &mut random)));
            }
        }
        self.message(stamp, ranges, intensities)
    }

    fn message(&self, stamp: Time, ranges: Vec<f32>, intensities: Vec<f32>) -> LaserScan {
        let last = self.options.beams.saturating_sub(1) as f32;
        LaserScan {
            header: Header { stamp, frame_id: Arc::clone(&self.frame) },
            angle_min: self.angle_min,
            angle_max: self.angle_min + last * self.angle_increment,
            angle_increment: self.angle_increment,
            time_increment: self.time_increment,
            scan_time: (1.0 / self.options.rate) as f32,
            range_min: self.options.range_min as f32,
            range_max: self.options.range_max as f32,
            ranges,
            intensities,
        }
    }

    /// One beam with its errors, or no return.
    fn measure(&self, scene: &BeamScene<'_>, ray: &Ray, random: &mut Random) -> Option<Hit> {
        let options = &self.options;
        let mut hit = self.shoot(scene, ray, random)?;
        if options.mixed_pixels > 0.0 && random.chance(options.mixed_pixels) {
            self.mix_edges(scene, ray, &mut hit, random);
        }
        if options.drop_out > 0.0 && random.chance(options.drop_out) {
            return None;
        }
        let deviation = options.range_noise + options.range_noise_relative * hit.range;
        if deviation > 0.0 {
            hit.range += deviation * random.gaussian();
        }
        if options.range_resolution > 0.0 {
            hit.range = (hit.range / options.range_resolution).round() * options.range_resolution;
        }
        Some(hit)
    }

    /// One side of the beam may hit a surface at another range: the measured range is then between the two.
    fn mix_edges(&self, scene: &BeamScene<'_>, ray: &Ray, hit: &mut Hit, random: &mut Random) {
        let (c, s) = (self.half_divergence.x, self.half_divergence.y);
        let s = if random.chance(0.5) { s } else { -s };
        let d = ray.direction;
        let side = Ray { direction: Vector2::new(c * d.x - s * d.y, s * d.x + c * d.y), ..*ray };
        if let Some(other) = self.shoot(scene, &side, random)
            && (other.range - hit.range).abs() > EDGE
        {
            hit.range += random.uniform() * (other.range - hit.range);
        }
    }

    /// The first surface that gives a return.
    fn shoot(&self, scene: &BeamScene<'_>, ray: &Ray, random: &mut Random) -> Option<Hit> {
        let mut crossings = scene.world.fixed().cast(ray, self.options.range_max + 1.0);
        if let Some(leg) = scene.people.cast(ray, scene.time, &scene.robot)
            && crossings.solid.is_none_or(|solid| leg.range < solid.range)
        {
            crossings.solid = Some(leg);
        }
        if self.options.glass_returns {
            for pane in crossings.panes() {
                if random.chance(pane_visibility(pane.cos_incidence)) {
                    return Some(pane);
                }
            }
        }
        crossings.solid
    }

    fn range_value(&self, hit: Option<&Hit>) -> f32 {
        let options = &self.options;
        match hit {
            Some(hit) if hit.range > options.range_max => self.no_return(),
            Some(hit) if hit.range < options.range_min => match options.no_return {
                NoReturn::Infinity => f32::NEG_INFINITY,
                _ => 0.0,
            },
            Some(hit) => (hit.range as f32).clamp(options.range_min as f32, options.range_max as f32),
            None => self.no_return(),
        }
    }

    fn no_return(&self) -> f32 {
        match self.options.no_return {
            NoReturn::Infinity => f32::INFINITY,
            NoReturn::BeyondMaximum => self.options.range_max as f32 + 1.0,
            NoReturn::Zero => 0.0,
            NoReturn::NotANumber => f32::NAN,
        }
    }
}

/// Surroundings of a beam.
struct BeamScene<'a> {
    world: &'a World,
    people: &'a NearbyPeople<'a>,
    /// Time of the walk at which it is fired, seconds.
    time: f64,
    /// Position of `base_link`, metres in the map.
    robot: Vector2,
}

/// Probability that a pane gives a return: near normal incidence it reflects the beam back; towards grazing
/// incidence its reflectance rises (Schlick's approximation of Fresnel's equations); otherwise only dirt
/// gives a return.
fn pane_visibility(cos_incidence: f64) -> f64 {
    let head_on = if cos_incidence > 0.995 { 0.8 } else { 0.0 };
    let away = 1.0 - cos_incidence;
    let square = away * away;
    (0.05 + head_on + 0.95 * square * square * away).min(1.0)
}

/// Intensity of a return, in arbitrary units up to about 1000, with 3 % noise.
fn intensity(hit: &Hit, random: &mut Random) -> f32 {
    let falloff = 1.0 + 0.01 * hit.range * hit.range;
    let light = 1000.0 * hit.material.albedo() * (0.2 + 0.8 * hit.cos_incidence) / falloff;
    (light * (1.0 + 0.03 * random.gaussian())).max(0.0) as f32
}
