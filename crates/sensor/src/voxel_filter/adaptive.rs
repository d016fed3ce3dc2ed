//! The voxel filter that looks for the coarsest voxels that leave enough points.

use portolan_geometry::Point3f;

use super::reservoir::Reservoir;
use super::select;
use crate::PointCloud;

/// Keeps the points within `max_range` metres of the frame's origin, thinned with the largest voxels
/// (edge at most `max_length` metres) that leave at least `min_num_points`. When even voxels of about a
/// hundredth of `max_length` leave fewer, the result of the finest is returned. All of
/// `spec/slam2d.md` §6, bit-exact; points that are not finite are left out.
pub fn adaptive_voxel_filter(
    cloud: &PointCloud,
    max_length: f32,
    min_num_points: usize,
    max_range: f32,
) -> PointCloud {
    select(cloud, &adaptive_voxel_filter_indices(&cloud.points, max_length, min_num_points, max_range))
}

/// Indices of the points that [`adaptive_voxel_filter`] keeps, ascending.
pub fn adaptive_voxel_filter_indices(
    points: &[Point3f],
    max_length: f32,
    min_num_points: usize,
    max_range: f32,
) -> Vec<u32> {
    // A point that is not finite has no range within the limit.
    let near: Vec<u32> =
        points.iter().zip(0_u32..).filter(|(p, _)| range(p) <= max_range).map(|(_, i)| i).collect();
    if near.len() <= min_num_points {
        return near;
    }
    let mut search = Search { points, near: &near, min_num_points, reservoir: Reservoir::default() };
    search.run(max_length)
}

fn range(p: &Point3f) -> f32 {
    (p.x * p.x + (p.y * p.y + p.z * p.z)).sqrt()
}

struct Search<'a> {
    points: &'a [Point3f],
    near: &'a [u32],
    min_num_points: usize,
    reservoir: Reservoir,
}

impl Search<'_> {
    /// Filters with one edge length; the kept indices, and whether they are enough.
    fn filter(&mut self, length: f32, kept: &mut Vec<u32>) -> bool {
        let near = self.near;
        let chosen = self.reservoir.sample(near.iter().map(|i| self.points[*i as usize]), length);
        kept.clear();
        kept.extend(chosen.map(|i| near[i as usize]));
        kept.len() >= self.min_num_points
    }

    fn run(&mut self, max_length: f32) -> Vec<u32> {
        let mut best = Vec::new();
        if self.filter(max_length, &mut best) {
            return best;
        }
        let mut candidate = Vec::new();
        let mut high = max_length;
        while high > 1e-2 * max_length {
            let mut low = high / 2.0;
            if self.filter(low, &mut best) {
                while (high - low) / low > 1e-1 {
                    let middle = (low + high) / 2.0;
                    if middle <= low || middle >= high {
                        break; // nothing lies between two neighbouring floats
                    }
                    if self.filter(middle, &mut candidate) {
                        low = middle;
                        std::mem::swap(&mut best, &mut candidate);
                    } else {
                        high = middle;
                    }
                }
                return best;
            }
            high /= 2.0;
        }
        best
    }
}
