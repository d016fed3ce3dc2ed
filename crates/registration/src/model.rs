//! Models that a scan is matched with: another scan, or several registered ones.

use portolan_geometry::{Rigid3, Vector3, nalgebra as na};

use super::ScanCloud;

/// A point of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelPoint {
    /// Index of the scan in the model.
    pub scan: u32,
    /// Index of the point in the scan.
    pub point: u32,
}

/// The nearest point of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelHit {
    /// The point.
    pub at: ModelPoint,
    /// Its distance, metres.
    pub distance: f32,
    /// Lower bound of the distance of all other points of the model, metres (up to the search distance).
    pub others: f32,
}

/// Points that others are matched with, in a frame of their own.
pub trait Model: Sync {
    /// The nearest point within `max_distance` metres.
    fn hit(&self, query: [f32; 3], max_distance: f32) -> Option<ModelHit>;

    /// Position of a point, metres, frame of the model.
    fn place(&self, at: ModelPoint) -> Vector3;

    /// Unit normal at a point, if surfaces were computed and there is one.
    fn normal(&self, at: ModelPoint) -> Option<Vector3>;

    /// Number of its points.
    fn count(&self) -> usize;

    /// Whether points have surfaces.
    fn has_surfaces(&self) -> bool;
}

impl Model for ScanCloud {
    fn hit(&self, query: [f32; 3], max_distance: f32) -> Option<ModelHit> {
        let (nearest, others) = self.nearest_two(query, max_distance)?;
        let at = ModelPoint { scan: 0, point: nearest.index };
        Some(ModelHit { at, distance: nearest.squared_distance.sqrt(), others })
    }

    fn place(&self, at: ModelPoint) -> Vector3 {
        Vector3::from(self.points()[at.point as usize].map(f64::from))
    }

    fn normal(&self, at: ModelPoint) -> Option<Vector3> {
        Some(Vector3::from(self.surface(at.point as usize)?.normal.map(f64::from)))
    }

    fn count(&self) -> usize {
        self.points().len()
    }

    fn has_surfaces(&self) -> bool {
        self.surface_count() > 0
    }
}

/// Several scans as one model (a metascan). Nothing is copied or sorted again: each scan keeps its own search
/// tree.
#[derive(Clone, Debug, Default)]
pub struct Metascan<'a> {
    scans: Vec<(&'a ScanCloud, Rigid3, Rigid3)>,
}

impl<'a> Metascan<'a> {
    /// Scans and their poses in the frame of the model.
    pub fn new(scans: impl IntoIterator<Item = (&'a ScanCloud, Rigid3)>) -> Self {
        Self { scans: scans.into_iter().map(|(scan, pose)| (scan, pose, pose.inverse())).collect() }
    }
}

impl Model for Metascan<'_> {
    fn hit(&self, query: [f32; 3], max_distance: f32) -> Option<ModelHit> {
        let mut best: Option<ModelHit> = None;
        let mut others = max_distance;
        let query = na::Point3::from(query.map(f64::from));
        for (number, (scan, _, scan_from_model)) in self.scans.iter().enumerate() {
            let local = scan_from_model * query;
            // Up to the distance of the second nearest point so far, since nearer ones also count.
            let Some(hit) = scan.hit([local.x as f32, local.y as f32, local.z as f32], others) else {
                continue;
            };
            let hit = ModelHit { at: ModelPoint { scan: number as u32, ..hit.at }, ..hit };
            match best {
                Some(b) if b.distance <= hit.distance => others = others.min(hit.distance),
                _ => {
                    others = others.min(hit.others).min(best.map_or(f32::INFINITY, |b| b.distance));
                    best = Some(hit);
                }
            }
        }
        best.map(|hit| ModelHit { others, ..hit })
    }

    fn place(&self, at: ModelPoint) -> Vector3 {
        let (scan, pose, _) = &self.scans[at.scan as usize];
        (pose * na::Point3::from(scan.place(at))).coords
    }

    fn normal(&self, at: ModelPoint) -> Option<Vector3> {
        let (scan, pose, _) = &self.scans[at.scan as usize];
        Some(pose.rotation * scan.normal(at)?)
    }

    fn count(&self) -> usize {
        self.scans.iter().map(|(scan, ..)| scan.count()).sum()
    }

    fn has_surfaces(&self) -> bool {
        self.scans.iter().any(|(scan, ..)| scan.has_surfaces())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metascan_matches_as_one_large_scan() {
        let mut state = 5_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1_u32 << 24) as f32
        };
        let poses =
            [Rigid3::identity(), Rigid3::translation(1.0, 0.0, 0.5), Rigid3::translation(-0.5, 1.0, 0.0)];
        let parts: Vec<ScanCloud> = (0..3)
            .map(|_| ScanCloud::new((0..300).map(|_| std::array::from_fn(|_| 3.0 * random())).collect()))
            .collect();
        let meta = Metascan::new(parts.iter().zip(poses));
        let mut all = Vec::new();
        for (part, pose) in parts.iter().zip(&poses) {
            all.extend(part.points().iter().map(|p| {
                let x = pose * na::Point3::from(p.map(f64::from));
                [x.x as f32, x.y as f32, x.z as f32]
            }));
        }
        let whole = ScanCloud::new(all);
        for _ in 0..500 {
            let query = std::array::from_fn(|_| 4.0 * random() - 0.5);
            match (meta.hit(query, 0.6), whole.hit(query, 0.6)) {
                (Some(a), Some(b)) => {
                    assert!((a.distance - b.distance).abs() < 1e-5 && (a.others - b.others).abs() < 1e-5);
                    assert!((meta.place(a.at) - whole.place(b.at)).norm() < 1e-5);
                }
                (a, b) => assert_eq!(a.is_some(), b.is_some()),
            }
        }
    }
}
