//! Computes with coordinates far from the origin, as in UTM and Gauss–Krüger, in a frame near the data.
//!
//! At 5,000 km from the origin single precision has a resolution of half a metre. Single-precision
//! computations therefore use a frame near the data with the axes of the map, and their results are
//! transformed back.

use crate::{Rigid3, Vector3};

/// Distance from the origin within which the map frame itself is used, metres: single precision has a
/// resolution of a quarter of a millimetre there.
const NEAR: f64 = 4096.0;
/// Origins of other frames are multiples of this, metres. It is a power of two, so that a transformation
/// there and back keeps the bits that a coordinate has far from the origin.
const STEP: f64 = 1024.0;

/// Upper bound of all coordinates on the Earth, metres: Earth-centred ones, and those in zones with the zone
/// number as prefix (61 zones of a million metres). Double precision has a resolution of 15 nm there.
pub const FARTHEST_COORDINATE: f64 = 1e8;

/// Whether a position can be on the Earth: its coordinates are finite, and none exceeds
/// [`FARTHEST_COORDINATE`].
pub fn is_on_earth(position: &Vector3) -> bool {
    position.iter().all(|v| v.abs() <= FARTHEST_COORDINATE)
}

/// A frame near the data of a map, with the axes of the map; the map frame itself if that is near.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearFrame {
    /// Origin in the map, metres.
    origin: Vector3,
}

impl Default for NearFrame {
    fn default() -> Self {
        Self { origin: Vector3::zeros() }
    }
}

impl NearFrame {
    /// A frame at the median of positions along each axis, so that a few outliers have no effect.
    pub fn around(positions: impl IntoIterator<Item = Vector3>) -> Self {
        let mut positions: Vec<Vector3> = positions.into_iter().filter(is_on_earth).collect();
        let mut median = |axis: usize| -> f64 {
            let middle = positions.len() / 2;
            if positions.is_empty() {
                return 0.0;
            }
            positions.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis])).1[axis]
        };
        let middle = Vector3::new(median(0), median(1), median(2));
        let origin = middle.map(|v| if v.abs() < NEAR { 0.0 } else { (v / STEP).round() * STEP });
        Self { origin }
    }

    /// Whether this is the map frame itself.
    pub fn is_map(&self) -> bool {
        self.origin == Vector3::zeros()
    }

    /// Its origin in the map, metres.
    pub fn origin(&self) -> Vector3 {
        self.origin
    }

    /// Transforms a pose from the map to this frame.
    pub fn near(&self, in_map: &Rigid3) -> Rigid3 {
        moved(in_map, &-self.origin)
    }

    /// Transforms a pose from this frame to the map.
    pub fn in_map(&self, near: &Rigid3) -> Rigid3 {
        moved(near, &self.origin)
    }
}

/// A pose translated along the axes of its frame, metres. Coordinates along axes without translation keep all
/// bits.
pub fn moved(pose: &Rigid3, by: &Vector3) -> Rigid3 {
    // Adding zero to minus zero would give plus zero.
    let place = pose.translation.vector.zip_map(by, |v, by| if by == 0.0 { v } else { v + by });
    Rigid3::from_parts(place.into(), pose.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{rotation_from_roll_pitch_yaw, to_f32};

    fn path(origin: Vector3) -> impl Iterator<Item = Vector3> {
        (0..300).map(move |i| origin + Vector3::new(0.7, 0.3, 0.01) * f64::from(i))
    }

    #[test]
    fn near_the_origin_the_frame_equals_that_of_the_map() {
        assert_eq!(NearFrame::around(path(Vector3::new(-3000.0, 900.0, 300.0))), NearFrame::default());
        assert_eq!(NearFrame::around([]), NearFrame::default());
        let pose = Rigid3::translation(0.1, -0.0, 1e-17);
        let bits = |pose: &Rigid3| pose.translation.vector.map(f64::to_bits);
        assert_eq!(bits(&NearFrame::default().near(&pose)), bits(&pose));
        assert_eq!(bits(&NearFrame::default().in_map(&pose)), bits(&pose));
    }

    #[test]
    fn distant_poses_are_near_the_origin_and_keep_their_bits() {
        let utm = Vector3::new(512_345.678_9, 5_412_345.678_9, 312.345_6);
        let frame = NearFrame::around(path(utm));
        assert_eq!(frame.origin().map(|v| v % STEP), Vector3::zeros());
        assert_eq!(frame.origin().z, 0.0, "300 m are near");
        for place in path(utm) {
            let pose = Rigid3::from_parts(place.into(), rotation_from_roll_pitch_yaw(0.1, -0.2, 2.9));
            let near = frame.near(&pose);
            let single = to_f32(&near).translation.vector.cast::<f64>();
            assert!((single - near.translation.vector).norm() < 1e-4, "{near}");
            assert_eq!(frame.in_map(&near), pose);
        }
    }

    #[test]
    fn outlying_and_non_finite_places_are_ignored() {
        let utm = Vector3::new(4.5e6, 5.4e6, 100.0);
        let elsewhere = [Vector3::zeros(), Vector3::new(f64::NAN, 0.0, 0.0), Vector3::repeat(1e15)];
        assert_eq!(NearFrame::around(path(utm).chain(elsewhere)), NearFrame::around(path(utm)));
        assert!(is_on_earth(&utm) && !is_on_earth(&elsewhere[1]) && !is_on_earth(&elsewhere[2]));
    }
}
