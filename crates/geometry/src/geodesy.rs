//! Positions on the Earth (WGS 84): degrees, Earth-centred coordinates (ECEF), local frames.

use nalgebra::{Matrix3, Vector3};

use crate::{Quaternion, Rigid3, rotation_from_roll_pitch_yaw};

/// Standard gravity, m/s²: the unit g.
pub const STANDARD_GRAVITY: f64 = 9.806_65;

/// Equatorial radius of the ellipsoid, metres.
const EQUATOR: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// The trigonometric functions to compute with: those of the standard library differ in the last bit between
/// systems.
#[derive(Clone, Copy, Debug)]
pub struct Trigonometry {
    /// Sine and cosine of radians.
    pub sin_cos: fn(f64) -> (f64, f64),
    /// Angle of (x, y), given y and x, radians.
    pub atan2: fn(f64, f64) -> f64,
}

impl Trigonometry {
    /// Those of the standard library.
    pub const STANDARD: Self = Self { sin_cos: f64::sin_cos, atan2: f64::atan2 };
}

/// A position on the Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeodeticPosition {
    /// Degrees, north positive.
    pub latitude_degrees: f64,
    /// Degrees, east positive.
    pub longitude_degrees: f64,
    /// Metres above the ellipsoid.
    pub altitude: f64,
}

/// A frame with x to the east, y to the north and z up, at a position on the Earth.
#[derive(Clone, Copy, Debug)]
pub struct EastNorthUp {
    /// ECEF, metres.
    origin: Vector3<f64>,
    ecef_from_local: Matrix3<f64>,
    functions: Trigonometry,
}

/// Square of polar by equatorial radius: one less the first eccentricity squared.
fn axis_ratio() -> f64 {
    let polar = EQUATOR * (1.0 - FLATTENING);
    polar * polar / (EQUATOR * EQUATOR)
}

/// Radius of curvature across the meridian, metres.
fn prime_vertical_radius(sin_latitude: f64) -> f64 {
    EQUATOR / (1.0 - (1.0 - axis_ratio()) * sin_latitude * sin_latitude).sqrt()
}

impl GeodeticPosition {
    /// Earth-centred, Earth-fixed coordinates, metres.
    pub fn to_ecef(&self) -> Vector3<f64> {
        self.to_ecef_with(&Trigonometry::STANDARD)
    }

    /// [`GeodeticPosition::to_ecef`] with given functions.
    pub fn to_ecef_with(&self, functions: &Trigonometry) -> Vector3<f64> {
        let (sin_lat, cos_lat) = (functions.sin_cos)(self.latitude_degrees.to_radians());
        let (sin_lon, cos_lon) = (functions.sin_cos)(self.longitude_degrees.to_radians());
        let n = prime_vertical_radius(sin_lat);
        let horizontal = (n + self.altitude) * cos_lat;
        Vector3::new(horizontal * cos_lon, horizontal * sin_lon, (axis_ratio() * n + self.altitude) * sin_lat)
    }

    /// The position for ECEF coordinates, metres. Latitude and altitude are found by fixed-point iteration,
    /// which converges by a factor of 300 per step near the ground.
    pub fn from_ecef_with(ecef: &Vector3<f64>, functions: &Trigonometry) -> Self {
        let across = (ecef.x * ecef.x + ecef.y * ecef.y).sqrt();
        let e2 = 1.0 - axis_ratio();
        let mut latitude = (functions.atan2)(ecef.z, across * (1.0 - e2));
        let mut altitude = 0.0;
        for _ in 0..8 {
            let (sine, cosine) = (functions.sin_cos)(latitude);
            let n = prime_vertical_radius(sine);
            altitude = across * cosine + ecef.z * sine - EQUATOR * EQUATOR / n;
            latitude = (functions.atan2)(ecef.z, across * (1.0 - e2 * n / (n + altitude)));
        }
        let longitude = (functions.atan2)(ecef.y, ecef.x);
        Self { latitude_degrees: latitude.to_degrees(), longitude_degrees: longitude.to_degrees(), altitude }
    }

    /// Whether this is a position on the Earth or above it.
    pub fn is_valid(&self) -> bool {
        self.latitude_degrees.abs() <= 90.0
            && self.longitude_degrees.abs() <= 360.0
            && self.altitude.is_finite()
    }

    /// The local frame of a first fix: `local_from_ecef`, such that its own position at altitude h becomes
    /// (0, 0, h), with z up, x south and y east.
    pub fn local_from_ecef(&self) -> Rigid3 {
        let pitch = (self.latitude_degrees - 90.0).to_radians();
        let rotation: Quaternion = rotation_from_roll_pitch_yaw(0.0, pitch, 0.0)
            * rotation_from_roll_pitch_yaw(0.0, 0.0, -self.longitude_degrees.to_radians());
        let on_ellipsoid = Self { altitude: 0.0, ..*self };
        Rigid3::from_parts((rotation * -on_ellipsoid.to_ecef()).into(), rotation)
    }
}

impl EastNorthUp {
    /// The frame at `origin`.
    pub fn at(origin: &GeodeticPosition) -> Self {
        Self::at_with(origin, Trigonometry::STANDARD)
    }

    /// The frame at `origin`, with given functions.
    pub fn at_with(origin: &GeodeticPosition, functions: Trigonometry) -> Self {
        let (sin_lat, cos_lat) = (functions.sin_cos)(origin.latitude_degrees.to_radians());
        let (sin_lon, cos_lon) = (functions.sin_cos)(origin.longitude_degrees.to_radians());
        let east = Vector3::new(-sin_lon, cos_lon, 0.0);
        let north = Vector3::new(-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat);
        let up = Vector3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat);
        let ecef_from_local = Matrix3::from_columns(&[east, north, up]);
        Self { origin: origin.to_ecef_with(&functions), ecef_from_local, functions }
    }

    /// The geodetic position of a local position, metres.
    pub fn to_geodetic(&self, local: &Vector3<f64>) -> GeodeticPosition {
        GeodeticPosition::from_ecef_with(&(self.origin + self.ecef_from_local * local), &self.functions)
    }

    /// The local position, metres, of a geodetic position.
    pub fn from_geodetic(&self, place: &GeodeticPosition) -> Vector3<f64> {
        self.ecef_from_local.transpose() * (place.to_ecef_with(&self.functions) - self.origin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(latitude_degrees: f64, longitude_degrees: f64, altitude: f64) -> GeodeticPosition {
        GeodeticPosition { latitude_degrees, longitude_degrees, altitude }
    }

    #[test]
    fn known_places() {
        assert!((at(0.0, 0.0, 0.0).to_ecef() - Vector3::new(6_378_137.0, 0.0, 0.0)).norm() < 1e-9);
        assert!((at(0.0, 0.0, 10.0).to_ecef().x - 6_378_147.0).abs() < 1e-6);
        for longitude in [0.0, 60.0, -170.0] {
            assert!(
                (at(90.0, longitude, 0.0).to_ecef() - Vector3::new(0.0, 0.0, 6_356_752.314_2)).norm() < 1e-4
            );
        }
        assert!((at(-90.0, 60.0, 20.0).to_ecef().z + 6_356_772.314_2).abs() < 1e-4);
        let munich = at(48.137_214_9, 11.574_802_4, 517.1).to_ecef();
        for (value, expected) in munich.iter().zip([4_177_983.0, 855_702.0, 4_727_457.0]) {
            assert!((value / expected - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn the_local_frame_points_up() {
        let mut random = portolan_numeric::Lcg64::new(1);
        let mut random = |scale: f64| (random.uniform() * 2.0 - 1.0) * scale;
        for _ in 0..1000 {
            let place = at(random(90.0), random(180.0), random(519.0));
            let local = place.local_from_ecef() * nalgebra::Point3::from(place.to_ecef());
            assert!(
                (local.coords - Vector3::new(0.0, 0.0, place.altitude)).norm() < 1e-6 * 519.0,
                "{place:?}"
            );
        }
    }

    #[test]
    fn conversions_are_inverse() {
        for (latitude, longitude, altitude) in
            [(48.1, 11.6, 520.0), (-33.9, 151.2, 10.0), (0.0, 0.0, 0.0), (89.9, -45.0, 3.0)]
        {
            let frame = EastNorthUp::at(&at(latitude, longitude, altitude));
            for local in [Vector3::zeros(), Vector3::new(1234.5, -987.6, 12.3)] {
                let back = frame.from_geodetic(&frame.to_geodetic(&local));
                assert!((back - local).norm() < 1e-6, "{latitude}: {back} {local}");
            }
        }
    }

    #[test]
    fn a_hundredth_of_a_degree_of_latitude_is_1111_metres() {
        let frame = EastNorthUp::at(&at(45.0, 7.0, 0.0));
        // The radius of the meridian at 45° is 6,367,381.8 m; over a whole degree the tangent plane would
        // leave the ellipsoid by a kilometre.
        let north = frame.to_geodetic(&Vector3::new(0.0, 1111.318, 0.0));
        assert!(
            (north.latitude_degrees - 45.01).abs() < 1e-6 && (north.longitude_degrees - 7.0).abs() < 1e-9,
            "{north:?}"
        );
    }
}
