//! The local map: two planar voxel maps that overlap by half. Sweeps are registered to the older one and
//! inserted into both, so that every place is in two maps and at least half of the extent of the older one
//! is filled.

use std::sync::Arc;

use portolan_geometry::{Point3f, Quaternion, Rigid3, to_f32};
use portolan_sensor::RangeData;

use crate::later::Later;
use crate::plane_map::PlaneMap;
use crate::settings::{LocalMapSettings, OdometrySettings, PlaneFitSettings};
use crate::two_threads::is_worth_a_thread;

/// A planar voxel map that is being filled.
#[derive(Clone, Debug)]
pub struct GrowingMap {
    /// Its frame: level, with its origin at the first key frame.
    pub local_from_map: Rigid3,
    /// In that frame.
    pub planes: Later<PlaneMap>,
    /// Key frames inserted.
    pub keyframes: u32,
}

/// The local maps around the scanner.
#[derive(Clone, Debug)]
pub(crate) struct LocalMap {
    settings: LocalMapSettings,
    plane_fit: PlaneFitSettings,
    /// Number of key frames below which a map is warming up: single sweeps have few planes, and errors of
    /// the first ones fit it.
    warm_up_keyframes: usize,
    older: GrowingMap,
    newer: Option<GrowingMap>,
}

impl GrowingMap {
    /// Adds points seen from an origin (both in the local map). Many points are left to the caller of the
    /// returned function.
    fn insert(&self, points: &Arc<Vec<Point3f>>, origin: &Point3f) -> Option<Box<dyn FnOnce() + Send>> {
        let map_from_local = to_f32(&self.local_from_map.inverse());
        let origin = map_from_local * origin;
        // A matrix rotates many points faster than a quaternion, and explicit sums are faster than
        // products of matrices.
        let (turn, shift) = (map_from_local.rotation.to_rotation_matrix(), map_from_local.translation.vector);
        let [x, y, z] = turn.matrix().data.0;
        let along =
            move |axis: usize, p: &Point3f| x[axis] * p.x + y[axis] * p.y + z[axis] * p.z + shift[axis];
        let in_map = move |p: &Point3f| Point3f::new(along(0, p), along(1, p), along(2, p));
        if is_worth_a_thread(points.len()) {
            let points = Arc::clone(points);
            Some(self.planes.leave(move |planes| planes.insert_all(points.iter().map(in_map), &origin)))
        } else {
            self.planes.now().insert_all(points.iter().map(in_map), &origin);
            None
        }
    }
}

impl LocalMap {
    /// Local map with the first key frame. The axes of a map are those of the gravity-aligned frame of its
    /// first key frame.
    pub fn new(
        settings: &OdometrySettings,
        sweep_in_local: &RangeData,
        local_from_gravity_aligned: Quaternion,
    ) -> Self {
        let OdometrySettings { plane_fit, local_map, loss, .. } = settings;
        let older = empty(local_map, plane_fit, sweep_in_local.origin, local_from_gravity_aligned);
        let mut map = Self {
            settings: local_map.clone(),
            plane_fit: plane_fit.clone(),
            warm_up_keyframes: loss.sweeps,
            older,
            newer: None,
        };
        map.insert(&Arc::new(sweep_in_local.returns.points.clone()), &sweep_in_local.origin);
        map.older.keyframes = 1;
        map
    }

    /// The map that sweeps are registered to.
    pub fn older(&self) -> &GrowingMap {
        &self.older
    }

    /// All maps, oldest first.
    pub fn all(&self) -> impl Iterator<Item = &GrowingMap> {
        std::iter::once(&self.older).chain(&self.newer)
    }

    /// Whether the older map has too few key frames to be reliable.
    pub fn is_warming_up(&self) -> bool {
        (self.older.keyframes as usize) < self.warm_up_keyframes
    }

    /// Inserts points seen from an origin (both in the local map) into all maps. Many points are inserted
    /// in the background, into the older map first, which is needed sooner.
    pub fn insert(&self, points: &Arc<Vec<Point3f>>, origin: &Point3f) {
        let work: Vec<_> = self.all().filter_map(|map| map.insert(points, origin)).collect();
        if !work.is_empty() {
            rayon::spawn(|| work.into_iter().for_each(|insert| insert()));
        }
    }

    /// Counts a key frame, taken at an origin in the local map, before it is inserted. Gives whether it
    /// completes the older map.
    pub fn count_keyframe(&mut self, origin: Point3f, local_from_gravity_aligned: Quaternion) -> bool {
        let half = self.settings.keyframes_per_half.max(1);
        if self.newer.is_none() && self.older.keyframes >= half {
            self.newer = Some(empty(&self.settings, &self.plane_fit, origin, local_from_gravity_aligned));
        }
        self.older.keyframes += 1;
        if let Some(newer) = &mut self.newer {
            newer.keyframes += 1;
        }
        self.older.keyframes >= 2 * half
    }

    /// Returns the older map, which is complete, and replaces it by the newer one.
    pub fn take_complete(&mut self) -> Option<PlaneMap> {
        let complete = std::mem::replace(&mut self.older, self.newer.take()?);
        Some(complete.planes.now().compacted())
    }
}

fn empty(
    settings: &LocalMapSettings,
    plane_fit: &PlaneFitSettings,
    origin_in_local: Point3f,
    local_from_gravity_aligned: Quaternion,
) -> GrowingMap {
    let origin = origin_in_local.coords.cast::<f64>();
    GrowingMap {
        local_from_map: Rigid3::from_parts(origin.into(), local_from_gravity_aligned),
        planes: Later::new(PlaneMap::with_settings(settings.voxel_size as f32, plane_fit.clone())),
        keyframes: 0,
    }
}

#[cfg(test)]
mod tests {
    use portolan_sensor::PointCloud;

    use super::*;

    fn sweep(x: f32) -> RangeData {
        let origin = Point3f::new(x, 0.0, 1.0);
        let returns = PointCloud::new(vec![Point3f::new(x, 1.0, 0.0)]);
        RangeData { origin, returns, misses: PointCloud::default() }
    }

    /// Inserts a key frame. Whether it completed a map.
    fn insert_keyframe(map: &mut LocalMap, x: f32) -> bool {
        let is_complete = map.count_keyframe(sweep(x).origin, Quaternion::identity());
        map.insert(&Arc::new(sweep(x).returns.points), &sweep(x).origin);
        is_complete && map.take_complete().is_some()
    }

    #[test]
    fn maps_overlap_by_half() {
        let mut settings = OdometrySettings::default();
        (settings.local_map.keyframes_per_half, settings.loss.sweeps) = (3, 3);
        let mut map = LocalMap::new(&settings, &sweep(0.0), Quaternion::identity());
        let mut complete = Vec::new();
        for i in 1..10 {
            assert_eq!(map.is_warming_up(), i < 3, "{i}");
            if insert_keyframe(&mut map, i as f32) {
                complete.push(i);
            }
        }
        assert_eq!(complete, [5, 8]);
        assert_eq!(map.all().map(|map| map.keyframes).collect::<Vec<_>>(), [4, 1]);
        assert!((map.older().local_from_map.translation.x - 6.0).abs() < 1e-6);
    }

    #[test]
    fn with_one_key_frame_a_half_every_second_one_completes_a_map() {
        let mut settings = OdometrySettings::default();
        settings.local_map.keyframes_per_half = 0;
        let mut map = LocalMap::new(&settings, &sweep(0.0), Quaternion::identity());
        for i in 1..5 {
            assert!(insert_keyframe(&mut map, i as f32), "{i}");
        }
    }
}
