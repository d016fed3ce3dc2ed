//! Planes in the form in which files store them.

use nalgebra as na;

use super::{PlaneMap, Unreliable};
use crate::plane_fit::{PlaneCell, PlaneFit};
use crate::settings::constants::plane_map::VOXEL_OFFSET;
use crate::voxel_tree::{LEVELS, SMALLEST_IN_ALL, SMALLEST_IN_LARGEST, Smallest};

/// The plane of one voxel of a [`PlaneMap`] in the form in which files store it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneRecord {
    /// The first of the smallest voxels in it: indices from the corner of the whole map, below 8192.
    pub voxel: [u32; 3],
    /// 0 for the largest voxels, and one more for each halving: up to 2.
    pub level: u32,
    /// A point on it, metres.
    pub point: na::Vector3<f32>,
    /// Unit length; on the side from which the plane was seen, if that is known.
    pub normal: na::Vector3<f32>,
    /// Mean square distance of the hits from it, m².
    pub variance: f32,
    /// Variance of the normal by the noise of the hits, rad².
    pub normal_variance: f32,
    /// Number of hits that it was fitted to.
    pub hits: u16,
    /// Whether it was seen from one side only.
    pub is_one_sided: bool,
    /// Reason why it may be an artefact of the scan pattern.
    pub unreliable: Option<Unreliable>,
}

impl PlaneRecord {
    /// The corner of the voxel with the smallest coordinates, metres, if the largest voxels have this
    /// edge.
    pub fn corner(&self, edge: f32) -> na::Vector3<f64> {
        let corner_of_all = f64::from(VOXEL_OFFSET * SMALLEST_IN_LARGEST + 0.5 * SMALLEST_IN_ALL);
        let size = f64::from(edge / SMALLEST_IN_LARGEST);
        na::Vector3::from(self.voxel).map(|index| (f64::from(index) - corner_of_all) * size)
    }

    /// The cell of this plane, its size and position; none if a number is not finite or invalid, or the
    /// voxel is outside of all maps.
    fn parts(&self) -> Option<(PlaneCell, PlaneFit, u32, Smallest)> {
        let smallest =
            Smallest::of_indices(self.voxel).filter(|s| s.is_in_reach(self.level.min(LEVELS - 1)))?;
        let variances = [self.variance, self.normal_variance];
        let is_valid = self.level < LEVELS
            && self.point.iter().all(|v| v.is_finite())
            && (self.normal.norm_squared() - 1.0).abs() < 1e-3
            && variances.iter().all(|v| v.is_finite() && *v >= 0.0);
        is_valid.then(|| {
            let cell = PlaneCell::settled(self.point, self.normal, self.hits, self.is_one_sided);
            let fit = PlaneFit {
                variance: self.variance,
                normal_variance: self.normal_variance,
                unreliable: self.unreliable,
            };
            (cell, fit, self.level, smallest)
        })
    }
}

impl PlaneMap {
    /// The planes of a [compacted](Self::compacted) map; those in larger voxels come first.
    pub fn records(&self) -> impl Iterator<Item = PlaneRecord> + '_ {
        let places = self.voxels.places().into_iter();
        let cells = self.cells.iter().zip(&self.fits);
        places.zip(cells).filter(|(_, (cell, _))| cell.is_plane).filter_map(|(place, (cell, fit))| {
            let (first, level) = place?;
            Some(PlaneRecord {
                voxel: first.indices(),
                level,
                point: cell.mean,
                normal: cell.normal,
                variance: fit.variance,
                normal_variance: fit.normal_variance,
                hits: cell.count,
                is_one_sided: cell.is_one_sided,
                unreliable: fit.unreliable,
            })
        })
    }

    /// A compacted map with largest voxels of this edge, metres, from its records. None if the edge or a
    /// record is damaged: a number that is not finite, a duplicate voxel or one outside of all maps, a
    /// smaller voxel before the larger one around it.
    pub fn from_records(edge: f32, records: impl Iterator<Item = PlaneRecord>) -> Option<Self> {
        if !(1e-3..=1e3).contains(&edge) {
            return None;
        }
        let mut map = Self::new(edge);
        for record in records {
            let (cell, fit, level, smallest) = record.parts()?;
            map.add_voxel(level, smallest)?;
            map.cells.push(cell);
            map.fits.push(fit);
        }
        Some(map)
    }

    fn add_voxel(&mut self, level: u32, smallest: Smallest) -> Option<usize> {
        let largest = self.voxels.largest(smallest);
        if level == 0 {
            return largest.is_none().then(|| self.voxels.add_largest(smallest));
        }
        let parent =
            (1..level).try_fold(largest?, |parent, level| self.voxels.child(parent, smallest, level))?;
        let is_new = self.voxels.child(parent, smallest, level).is_none();
        is_new.then(|| self.voxels.add_child(parent, smallest, level))
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Point3f;

    use super::*;

    fn walls() -> PlaneMap {
        let mut map = PlaneMap::new(1.0);
        let origin = Point3f::new(0.5, 0.4, 1.0);
        for i in 0..4000 {
            let (u, v) = (0.05 * (i % 80) as f32 - 2.0, 0.05 * (i / 80) as f32);
            let noise = 0.01 * ((i * 7 % 5) as f32 - 2.0);
            map.insert_seen_from(&Point3f::new(u, 3.0 + noise, v), &origin);
            map.insert_seen_from(&Point3f::new(u, v, -1.0 - noise), &origin);
        }
        map.compacted()
    }

    #[test]
    fn planes_survive_writing_and_reading() {
        let map = walls();
        let records: Vec<PlaneRecord> = map.records().collect();
        assert!(records.len() >= 16, "{}", records.len());
        for record in &records {
            let off = record.point.cast::<f64>() - record.corner(map.edge());
            let size = 1.0 / f64::from(1 << record.level);
            assert!(off.iter().all(|v| (-1e-4..=size + 1e-4).contains(v)), "{record:?}");
        }
        let back = PlaneMap::from_records(map.edge(), records.iter().copied()).unwrap();
        assert_eq!(back.records().collect::<Vec<_>>(), records);
        for i in 0..600 {
            let place = Point3f::new(0.1 * (i % 40) as f32 - 2.0, 3.0, 0.2 * (i / 40) as f32);
            assert_eq!(back.plane_near(&place), map.plane_near(&place));
        }
    }

    #[test]
    fn damaged_planes_are_rejected() {
        let records: Vec<PlaneRecord> = walls().records().collect();
        let with = |change: fn(&mut PlaneRecord)| {
            let mut records = records.clone();
            change(&mut records[3]);
            PlaneMap::from_records(1.0, records.into_iter())
        };
        assert!(with(|_| ()).is_some());
        assert!(with(|r| r.point.x = f32::NAN).is_none());
        assert!(with(|r| r.normal *= 2.0).is_none());
        assert!(with(|r| r.variance = -1.0).is_none());
        assert!(with(|r| r.level = 3).is_none());
        assert!(with(|r| r.voxel[1] = 1 << 20).is_none());
        let twice = records.iter().chain(&records[..1]).copied();
        assert!(PlaneMap::from_records(1.0, twice).is_none());
        assert!(PlaneMap::from_records(f32::NAN, records.iter().copied()).is_none());
        let small = PlaneRecord { level: 1, ..records[0] };
        assert!(PlaneMap::from_records(1.0, std::iter::once(small)).is_none());
    }
}
