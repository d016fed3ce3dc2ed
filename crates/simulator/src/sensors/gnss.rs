//! Satellite fixes: the position of the antenna, if it sees enough of the sky.

use std::sync::Arc;

use portolan_geometry::{EastNorthUp, GeodeticPosition, Rigid3, Trigonometry, Vector3};
use portolan_recording::{Header, Message, NavSatFix, RecordedMessage};

use super::stream::{Clock, MessageStream, Schedule, Ticks};
use crate::motion::Motion;
use portolan_worlds::Random;
use portolan_worlds::three_d::{Moment, Ray3, SolidWorld};

/// Functions that are the same on every system.
const FUNCTIONS: Trigonometry = Trigonometry { sin_cos: libm::sincos, atan2: libm::atan2 };
/// Minimum number of free directions for a fix, of nine into the sky.
const FREE_DIRECTIONS: usize = 6;
/// Maximum distance at which surfaces hide satellites, metres.
const HORIZON: f64 = 60.0;
/// Time constant of the slow error, seconds.
const WANDER_TIME: f64 = 60.0;

/// A satellite receiver. The map's x axis points east and its y axis north.
#[derive(Clone, Debug, PartialEq)]
pub struct GnssOptions {
    /// Topic of its `sensor_msgs/NavSatFix`. Default `/fix`.
    pub topic: String,
    /// Frame of its antenna. Default `gnss`.
    pub frame: String,
    /// Position of the antenna on the platform; it has no orientation. Default 0.7 m above `base_link`.
    pub base_from_antenna: Rigid3,
    /// Fixes per second. Default 5.
    pub rate: f64,
    /// Latitude and longitude of the map's origin, degrees. Default 49.78, 9.97.
    pub origin_degrees: [f64; 2],
    /// Height of the map's origin above the ellipsoid, metres. Default 250.
    pub origin_altitude: f64,
    /// Standard deviation of each fix, east and north, metres; twice as much up. Default 0.05.
    pub noise: f64,
    /// Standard deviation of a slow error (a minute), metres. Default 0.15.
    pub wander: f64,
    /// Start and end of intervals without fixes, seconds since the start. Default none.
    pub outages: Vec<[f64; 2]>,
    /// Whether there is no fix under roofs and close to walls. Default yes.
    pub needs_sky: bool,
}

impl Default for GnssOptions {
    fn default() -> Self {
        Self {
            topic: "/fix".to_owned(),
            frame: "gnss".to_owned(),
            base_from_antenna: Rigid3::translation(0.0, 0.0, 0.7),
            rate: 5.0,
            origin_degrees: [49.78, 9.97],
            origin_altitude: 250.0,
            noise: 0.05,
            wander: 0.15,
            outages: Vec::new(),
            needs_sky: true,
        }
    }
}

impl GnssOptions {
    /// The same receiver without errors; roofs still hide satellites.
    pub fn without_noise(self) -> Self {
        Self { noise: 0.0, wander: 0.0, ..self }
    }

    /// Latitude and longitude in degrees and height in metres of a point of the map (metres).
    pub fn geodetic(&self, point_in_map: &Vector3) -> [f64; 3] {
        let [latitude_degrees, longitude_degrees] = self.origin_degrees;
        let origin = GeodeticPosition { latitude_degrees, longitude_degrees, altitude: self.origin_altitude };
        let place = EastNorthUp::at_with(&origin, FUNCTIONS).to_geodetic(point_in_map);
        [place.latitude_degrees, place.longitude_degrees, place.altitude]
    }
}

/// The messages of the receiver.
pub(crate) struct GnssStream<M> {
    pub options: GnssOptions,
    pub world: Arc<SolidWorld>,
    pub motion: Arc<M>,
    ticks: Ticks,
    pub seed: u64,
    wander: Vector3,
}

impl<M: Motion> GnssStream<M> {
    pub fn new(
        options: GnssOptions,
        (world, motion): (Arc<SolidWorld>, Arc<M>),
        (clock, schedule): (Clock, Schedule),
        seed: u64,
    ) -> Self {
        let wander = position_error(&mut Random::new(seed, "gnss wander", 0)) * options.wander;
        Self { options, world, motion, ticks: Ticks::new(clock, schedule), seed, wander }
    }

    fn sees_sky(&self, antenna: &Vector3) -> bool {
        let mut free = 0;
        for i in 0..9 {
            // Eight directions at 35° above the horizon, and up.
            let (sine, cosine) = libm::sincos(std::f64::consts::FRAC_PI_4 * f64::from(i));
            let direction = if i == 8 {
                Vector3::z()
            } else {
                Vector3::new(0.819 * cosine, 0.819 * sine, 0.574).normalize()
            };
            let ray = Ray3 { origin: *antenna, direction };
            free += usize::from(self.world.echo(&ray, HORIZON, (&Moment::default(), 0.0), None).is_none());
        }
        free >= FREE_DIRECTIONS
    }
}

/// Random error with standard deviation 1 east and north; that of heights is twice as large.
fn position_error(random: &mut Random) -> Vector3 {
    random.gaussian_vector().component_mul(&Vector3::new(1.0, 1.0, 2.0))
}

impl<M: Motion> MessageStream for GnssStream<M> {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        let (index, seconds, stamp) = self.ticks.next()?;
        let o = &self.options;
        let mut random = Random::new(self.seed, "gnss", index);
        let antenna = self.motion.state(seconds).map_from_base * o.base_from_antenna;
        let antenna = antenna.translation.vector;
        let is_out = o.outages.iter().any(|[from, to]| (*from..*to).contains(&seconds));
        let has_fix = !is_out && (!o.needs_sky || self.sees_sky(&antenna));
        let measured = antenna + self.wander + position_error(&mut random) * o.noise;
        let keep = libm::exp(-1.0 / (o.rate * WANDER_TIME));
        let fresh = position_error(&mut random) * (o.wander * (1.0 - keep * keep).sqrt());
        let [latitude_degrees, longitude_degrees, altitude] =
            if has_fix { o.geodetic(&measured) } else { [f64::NAN; 3] };
        let variance = o.noise * o.noise + o.wander * o.wander;
        let fix = NavSatFix {
            header: Header { stamp, frame_id: o.frame.as_str().into() },
            status: if has_fix { 0 } else { -1 },
            service: 1,
            latitude_degrees,
            longitude_degrees,
            altitude,
            position_covariance: [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 4.0 * variance],
            position_covariance_type: 2,
        };
        let topic = o.topic.as_str().into();
        self.wander = self.wander * keep + fresh;
        Some(RecordedMessage { topic, log_time: stamp, message: Message::NavSatFix(fix) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_on_earth_are_exact() {
        let options = GnssOptions::default();
        let [latitude, longitude, altitude] = options.geodetic(&Vector3::zeros());
        assert!((latitude - 49.78).abs() < 1e-12 && (longitude - 9.97).abs() < 1e-12);
        assert!((altitude - 250.0).abs() < 1e-6);
        let ecef = |point: [f64; 3]| {
            let [latitude_degrees, longitude_degrees, altitude] = options.geodetic(&Vector3::from(point));
            GeodeticPosition { latitude_degrees, longitude_degrees, altitude }.to_ecef()
        };
        let distance = (ecef([300.0, -400.0, 12.0]) - ecef([0.0, 0.0, 12.0])).norm();
        assert!((distance - 500.0).abs() < 1e-6, "{distance}");
    }
}
