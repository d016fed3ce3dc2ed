//! Positions on the Earth (WGS 84) and in a local frame of east, north and up.

use nalgebra::{Matrix3, Vector3};

/// Semi-major axis of the ellipsoid, metres.
const A: f64 = 6_378_137.0;
/// Flattening.
const F: f64 = 1.0 / 298.257_223_563;
/// First eccentricity squared.
const E2: f64 = F * (2.0 - F);

/// A position on the Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Degrees north.
    pub latitude: f64,
    /// Degrees east.
    pub longitude: f64,
    /// Metres above the ellipsoid.
    pub altitude: f64,
}

/// A frame with x to the east, y to the north and z up, at a place on the Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    origin: Vector3<f64>,
    earth_from_local: Matrix3<f64>,
}

impl Geodetic {
    /// Whether the numbers are a place on the Earth.
    pub fn is_valid(&self) -> bool {
        self.latitude.abs() <= 90.0 && self.longitude.abs() <= 360.0 && self.altitude.abs() < 1e6
    }

    /// Coordinates from the middle of the Earth, metres.
    fn to_earth(self) -> Vector3<f64> {
        let (sin_lat, cos_lat) = self.latitude.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.longitude.to_radians().sin_cos();
        let n = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
        let across = (n + self.altitude) * cos_lat;
        Vector3::new(across * cos_lon, across * sin_lon, (n * (1.0 - E2) + self.altitude) * sin_lat)
    }

    /// By fixed-point iteration, which is good to nanometres after a few steps near the surface.
    fn from_earth(p: &Vector3<f64>) -> Self {
        let across = p.x.hypot(p.y);
        let mut latitude = p.z.atan2(across * (1.0 - E2));
        let mut altitude = 0.0;
        for _ in 0..10 {
            let (sin, cos) = latitude.sin_cos();
            let n = A / (1.0 - E2 * sin * sin).sqrt();
            altitude = if cos.abs() > 0.1 { across / cos - n } else { p.z / sin - n * (1.0 - E2) };
            latitude = p.z.atan2(across * (1.0 - E2 * n / (n + altitude)));
        }
        Self { latitude: latitude.to_degrees(), longitude: p.y.atan2(p.x).to_degrees(), altitude }
    }
}

impl LocalFrame {
    /// The frame at `origin`.
    pub fn at(origin: Geodetic) -> Self {
        let (sin_lat, cos_lat) = origin.latitude.to_radians().sin_cos();
        let (sin_lon, cos_lon) = origin.longitude.to_radians().sin_cos();
        let east = Vector3::new(-sin_lon, cos_lon, 0.0);
        let north = Vector3::new(-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat);
        let up = Vector3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat);
        Self { origin: origin.to_earth(), earth_from_local: Matrix3::from_columns(&[east, north, up]) }
    }

    /// Where a local position, metres, is on the Earth.
    pub fn to_geodetic(&self, local: &Vector3<f64>) -> Geodetic {
        Geodetic::from_earth(&(self.origin + self.earth_from_local * local))
    }

    /// The local position, metres, of a place on the Earth.
    pub fn from_geodetic(&self, place: Geodetic) -> Vector3<f64> {
        self.earth_from_local.transpose() * (place.to_earth() - self.origin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back() {
        for (latitude, longitude, altitude) in
            [(48.1, 11.6, 520.0), (-33.9, 151.2, 10.0), (0.0, 0.0, 0.0), (89.9, -45.0, 3.0)]
        {
            let frame = LocalFrame::at(Geodetic { latitude, longitude, altitude });
            for local in [Vector3::zeros(), Vector3::new(1234.5, -987.6, 12.3)] {
                let back = frame.from_geodetic(frame.to_geodetic(&local));
                assert!((back - local).norm() < 1e-6, "{latitude}: {back} {local}");
            }
        }
    }

    #[test]
    fn a_hundredth_of_a_degree_of_latitude_is_1111_metres() {
        let frame = LocalFrame::at(Geodetic { latitude: 45.0, longitude: 7.0, altitude: 0.0 });
        // The radius of the meridian at 45° is 6,367,381.8 m; over a whole degree the tangent plane would
        // leave the ellipsoid by a kilometre.
        let north = frame.to_geodetic(&Vector3::new(0.0, 1111.318, 0.0));
        assert!((north.latitude - 45.01).abs() < 1e-6 && (north.longitude - 7.0).abs() < 1e-9, "{north:?}");
    }
}
