//! Coordinates far from the origin, as in UTM and Gauss–Krüger, reckoned with near the data.
//!
//! Single precision has steps of half a metre at 5,000 km. What works in it works in a frame near the data, with the axes of the
//! map, and its results are carried back.

use crate::{Rigid3, Vector3};

/// Within this of the origin, metres, the frame of the map itself will do: single precision has steps of a quarter of a millimetre
/// there.
const NEAR: f64 = 4096.0;
/// Origins of other frames are multiples of this, metres: a power of two, so that what is carried there and back keeps the bits
/// that it has far from the origin.
const STEP: f64 = 1024.0;

/// No coordinate on the Earth is larger, metres, whether counted from its centre, or in zones with their number in front (61 zones
/// of a million metres). Double precision has steps of 15 nm there.
pub const FARTHEST_COORDINATE: f64 = 1e8;

/// Whether a position is one on the Earth, as far as its coordinates tell: finite, and none beyond [`FARTHEST_COORDINATE`].
pub fn is_on_earth(position: &Vector3) -> bool {
    position.iter().all(|v| v.abs() <= FARTHEST_COORDINATE)
}

/// A frame near the data of a map, with the axes of the map; the frame of the map itself where that is near.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearFrame {
    /// In the map, metres.
    origin: Vector3,
}

impl Default for NearFrame {
    fn default() -> Self {
        Self { origin: Vector3::zeros() }
    }
}

impl NearFrame {
    /// About the median of positions along each axis, so that a few that lie elsewhere do not count.
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

    /// Whether it is the frame of the map itself.
    pub fn is_map(&self) -> bool {
        self.origin == Vector3::zeros()
    }

    /// Its origin in the map, metres.
    pub fn origin(&self) -> Vector3 {
        self.origin
    }

    /// A pose in the map as one in this frame.
    pub fn near(&self, in_map: &Rigid3) -> Rigid3 {
        moved(in_map, &-self.origin)
    }

    /// A pose in this frame as one in the map.
    pub fn in_map(&self, near: &Rigid3) -> Rigid3 {
        moved(near, &self.origin)
    }
}

/// A pose moved along the axes of its frame, metres: bit by bit as it was but for the axes along which it is moved.
pub fn moved(pose: &Rigid3, by: &Vector3) -> Rigid3 {
    // Zero added to minus zero is zero.
    let place = pose.translation.vector.zip_map(by, |v, by| if by == 0.0 { v } else { v + by });
    Rigid3::from_parts(place.into(), pose.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{rotation_from_roll_pitch_yaw, to_f32};

    fn way(origin: Vector3) -> impl Iterator<Item = Vector3> {
        (0..300).map(move |i| origin + Vector3::new(0.7, 0.3, 0.01) * f64::from(i))
    }

    #[test]
    fn near_the_origin_it_is_the_frame_of_the_map() {
        assert_eq!(NearFrame::around(way(Vector3::new(-3000.0, 900.0, 300.0))), NearFrame::default());
        assert_eq!(NearFrame::around([]), NearFrame::default());
        let pose = Rigid3::translation(0.1, -0.0, 1e-17);
        let bits = |pose: &Rigid3| pose.translation.vector.map(f64::to_bits);
        assert_eq!(bits(&NearFrame::default().near(&pose)), bits(&pose));
        assert_eq!(bits(&NearFrame::default().in_map(&pose)), bits(&pose));
    }

    #[test]
    fn what_is_far_is_near_in_it_and_keeps_its_bits() {
        let utm = Vector3::new(512_345.678_9, 5_412_345.678_9, 312.345_6);
        let frame = NearFrame::around(way(utm));
        assert_eq!(frame.origin().map(|v| v % STEP), Vector3::zeros());
        assert_eq!(frame.origin().z, 0.0, "300 m are near");
        for place in way(utm) {
            let pose = Rigid3::from_parts(place.into(), rotation_from_roll_pitch_yaw(0.1, -0.2, 2.9));
            let near = frame.near(&pose);
            let single = to_f32(&near).translation.vector.cast::<f64>();
            assert!((single - near.translation.vector).norm() < 1e-4, "{near}");
            assert_eq!(frame.in_map(&near), pose);
        }
    }

    #[test]
    fn a_few_places_elsewhere_and_numbers_that_are_none_do_not_count() {
        let utm = Vector3::new(4.5e6, 5.4e6, 100.0);
        let elsewhere = [Vector3::zeros(), Vector3::new(f64::NAN, 0.0, 0.0), Vector3::repeat(1e15)];
        assert_eq!(NearFrame::around(way(utm).chain(elsewhere)), NearFrame::around(way(utm)));
        assert!(is_on_earth(&utm) && !is_on_earth(&elsewhere[1]) && !is_on_earth(&elsewhere[2]));
    }
}
