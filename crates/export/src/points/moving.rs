//! `voxel_filter_and_remove_moving_objects`: removes points in voxels with many rays passing through per point.

use portolan_geometry::Point3f;
use portolan_spatial::VoxelHash;

use super::batch::voxel_of;
use super::{Flush, Log, PointsBatch, PointsError, Stage};

/// Maximum number of occupied voxels, of some 30 bytes each.
const MAX_VOXELS: usize = 1 << 26;
/// Maximum number of steps along a ray; points with longer rays are ignored as invalid.
const MAX_STEPS: f32 = 1e6;

enum Pass {
    MarkingHits,
    CountingRays,
    Filtering,
}

#[derive(Clone, Copy, Default)]
struct Voxel {
    hits: u32,
    rays: u32,
}

/// Counts the points in each voxel in a first pass and the rays through it in a second one. In a third pass
/// it keeps points in voxels with fewer rays than `miss_per_hit_limit` times hits.
pub(super) struct RemoveMoving {
    miss_per_hit_limit: f64,
    voxel_size: f32,
    voxels: VoxelHash<Voxel>,
    pass: Pass,
}

impl RemoveMoving {
    /// `voxel_size` is the edge of a voxel, metres; it must be positive.
    pub fn new(voxel_size: f64, miss_per_hit_limit: f64) -> Self {
        let (voxels, pass) = (VoxelHash::default(), Pass::MarkingHits);
        Self { miss_per_hit_limit, voxel_size: voxel_size as f32, voxels, pass }
    }

    fn mark_hits(&mut self, batch: &PointsBatch) -> Result<(), PointsError> {
        for cell in batch.points.iter().filter_map(|p| voxel_of(p, self.voxel_size)) {
            let voxel = self.voxels.or_default(cell);
            voxel.hits = voxel.hits.saturating_add(1);
        }
        if self.voxels.len() > MAX_VOXELS {
            let reason = format!("there are points in more than {MAX_VOXELS} voxels");
            return Err(PointsError::TooLarge { action: "voxel_filter_and_remove_moving_objects", reason });
        }
        Ok(())
    }

    fn count_rays(&mut self, batch: &PointsBatch) {
        for point in &batch.points {
            let delta = point - batch.origin;
            let length = delta.norm();
            if !length.is_finite() || length / self.voxel_size > MAX_STEPS {
                continue;
            }
            let mut x = 0.0_f32;
            while x < length {
                let on_ray = batch.origin + (x / length) * delta;
                if let Some(voxel) = voxel_of(&on_ray, self.voxel_size).and_then(|c| self.voxels.get_mut(&c))
                {
                    voxel.rays = voxel.rays.saturating_add(1);
                }
                x += self.voxel_size;
            }
        }
    }

    fn is_static(&self, point: &Point3f) -> bool {
        let voxel = voxel_of(point, self.voxel_size).and_then(|c| self.voxels.get(&c));
        voxel.is_some_and(|v| f64::from(v.rays) < self.miss_per_hit_limit * f64::from(v.hits))
    }
}

impl Stage for RemoveMoving {
    fn process(&mut self, batch: &mut PointsBatch) -> Result<bool, PointsError> {
        match self.pass {
            Pass::MarkingHits => self.mark_hits(batch).map(|()| false),
            Pass::CountingRays => {
                self.count_rays(batch);
                Ok(false)
            }
            Pass::Filtering => {
                batch.retain(|p| self.is_static(p));
                Ok(true)
            }
        }
    }

    fn needs_another_pass(&mut self, log: Log) -> bool {
        let (next, text) = match self.pass {
            Pass::MarkingHits => (Pass::CountingRays, "Counting rays..."),
            Pass::CountingRays => (Pass::Filtering, "Filtering outliers..."),
            Pass::Filtering => return false,
        };
        log(text);
        self.pass = next;
        true
    }

    fn end_pass(&mut self, _flush: Flush, _log: Log) -> Result<(), PointsError> {
        // If a later stage of this kind needs all points once more, the same points pass again.
        Ok(())
    }
}
