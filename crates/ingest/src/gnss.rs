//! Satellite fixes as poses in a local frame (`spec/slam2d.md` §1.1).

use portolan_geometry::{Quaternion, Rigid3, Vector3, rotation_from_roll_pitch_yaw};

/// WGS 84: equatorial radius in metres, and flattening.
const EQUATOR: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;

/// A place on the Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeodeticPosition {
    /// Degrees, north positive.
    pub latitude_degrees: f64,
    /// Degrees, east positive.
    pub longitude_degrees: f64,
    /// Metres above the ellipsoid.
    pub altitude: f64,
}

impl GeodeticPosition {
    /// Earth-centred, Earth-fixed coordinates, metres.
    pub fn to_ecef(&self) -> Vector3 {
        let (sin_lat, cos_lat) = self.latitude_degrees.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude_degrees.to_radians().sin_cos();
        let polar = EQUATOR * (1.0 - FLATTENING);
        let ratio = polar * polar / (EQUATOR * EQUATOR);
        let n = EQUATOR / (1.0 - (1.0 - ratio) * sin_lat * sin_lat).sqrt();
        let horizontal = (n + self.altitude) * cos_lat;
        Vector3::new(horizontal * cos_lon, horizontal * sin_lon, (ratio * n + self.altitude) * sin_lat)
    }

    /// Whether it is a place on the Earth.
    pub fn is_valid(&self) -> bool {
        self.latitude_degrees.abs() <= 90.0
            && self.longitude_degrees.abs() <= 360.0
            && self.altitude.is_finite()
    }

    /// The local frame of a first fix: `local_from_ecef`, such that its own place at altitude h becomes
    /// (0, 0, h), z up, x south, y east.
    pub fn local_from_ecef(&self) -> Rigid3 {
        let pitch = (self.latitude_degrees - 90.0).to_radians();
        let rotation: Quaternion = rotation_from_roll_pitch_yaw(0.0, pitch, 0.0)
            * rotation_from_roll_pitch_yaw(0.0, 0.0, -self.longitude_degrees.to_radians());
        let on_ellipsoid = Self { altitude: 0.0, ..*self };
        Rigid3::from_parts((rotation * -on_ellipsoid.to_ecef()).into(), rotation)
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
        let mut state = 1u64;
        let mut random = |scale: f64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) as f64 / f64::from(1u32 << 31) * 2.0 - 1.0) * scale
        };
        for _ in 0..1000 {
            let place = at(random(90.0), random(180.0), random(519.0));
            let local = place.local_from_ecef() * portolan_geometry::nalgebra::Point3::from(place.to_ecef());
            assert!(
                (local.coords - Vector3::new(0.0, 0.0, place.altitude)).norm() < 1e-6 * 519.0,
                "{place:?}"
            );
        }
    }
}
