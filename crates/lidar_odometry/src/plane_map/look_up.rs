//! Looks up the planes near many positions at once.

use nalgebra as na;
use portolan_geometry::Point3f;

use super::{BATCH, NO_VOXEL, Plane, PlaneMap, across_nearest_side};
use crate::voxel_tree::{LEVELS, Smallest};

impl PlaneMap {
    /// The planes near at most [`BATCH`] positions, as [`Self::plane_seen`] chooses them. All voxels of a
    /// size are read before the first one is tested, so that their reads overlap.
    pub(crate) fn planes_seen(&self, places: &[(Point3f, na::Vector3<f32>)]) -> [Option<Plane>; BATCH] {
        let mut numbers = [NO_VOXEL; BATCH];
        let mut scaled = [na::Vector3::zeros(); BATCH];
        for (scaled, (place, _)) in scaled.iter_mut().zip(places) {
            *scaled = self.scaled(place);
        }
        self.voxels_around(&scaled, places, &mut numbers);
        let mut across = [na::Vector3::repeat(f32::NAN); BATCH];
        for ((across, scaled), _) in
            across.iter_mut().zip(&scaled).zip(&numbers).filter(|(_, n)| **n == NO_VOXEL)
        {
            *across = across_nearest_side(scaled);
        }
        self.voxels_around(&across, places, &mut numbers);
        numbers.map(|number| Some(self.cells.get(number)?.plane(self.fits.get(number)?)))
    }

    /// The numbers of the largest planar voxels around positions, as [`Self::plane_around`] finds them,
    /// for those that have none yet.
    fn voxels_around(
        &self,
        scaled: &[na::Vector3<f32>; BATCH],
        places: &[(Point3f, na::Vector3<f32>)],
        found: &mut [usize; BATCH],
    ) {
        let mut smallest = [Smallest::default(); BATCH];
        let mut numbers = [NO_VOXEL; BATCH];
        for k in (0..places.len().min(BATCH)).filter(|k| found[*k] == NO_VOXEL) {
            let Some(around) = Smallest::around(&scaled[k]) else { continue };
            smallest[k] = around;
            numbers[k] = self.voxels.largest(around).unwrap_or(NO_VOXEL);
        }
        for level in 0..LEVELS {
            // A loop without branches, so that all these reads are in flight at once.
            let mut are_planes = [false; BATCH];
            for (is_plane, number) in are_planes.iter_mut().zip(&numbers) {
                *is_plane = self.cells.get(*number).is_some_and(|cell| cell.is_plane);
            }
            for (k, (_, toward)) in places.iter().enumerate() {
                let number = std::mem::replace(&mut numbers[k], NO_VOXEL);
                if number == NO_VOXEL {
                    continue;
                }
                if are_planes[k] && !self.cells[number].shows_other_side(toward, &self.settings) {
                    found[k] = number;
                } else if level + 1 < LEVELS && smallest[k].is_in_reach(level + 1) {
                    numbers[k] = self.voxels.child(number, smallest[k], level + 1).unwrap_or(NO_VOXEL);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    #[test]
    fn batch_look_ups_equal_single_look_ups() {
        let (mut lcg, mut map) = (Lcg::new(5), PlaneMap::new(1.0));
        for _ in 0..20_000 {
            let [u, v, noise] = [3.0, 3.0, 0.02].map(|range| lcg.symmetric(range));
            map.insert_seen_from(&Point3f::new(u, v, noise), &Point3f::new(0.0, 0.0, 1.0));
            map.insert_seen_from(&Point3f::new(u, 1.7 + noise, v), &Point3f::origin());
            map.insert_unseen(&[Point3f::new(u, v, 10.0 + 0.3 * u * v)]);
        }
        let mut found = [0, 0];
        for count in 0..=BATCH {
            let places: Vec<(Point3f, na::Vector3<f32>)> = (0..count)
                .map(|i| {
                    let place = Point3f::new(lcg.symmetric(3.5), lcg.symmetric(3.5), lcg.symmetric(0.4));
                    let place = if i % 3 == 0 { place + na::Vector3::z() * 10.0 } else { place };
                    (place, na::Vector3::new(0.0, 0.0, lcg.symmetric(1.0).signum()))
                })
                .collect();
            let planes = map.planes_seen(&places);
            for ((place, toward), plane) in places.iter().zip(&planes) {
                assert_eq!(*plane, map.plane_seen(place, toward), "{place}");
                found[usize::from(plane.is_some())] += 1;
            }
            assert!(planes[count..].iter().all(Option::is_none));
        }
        assert!(found.iter().all(|count| *count > 100), "{found:?}");
    }
}
