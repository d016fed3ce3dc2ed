//! Voxel filter that uses the largest voxels that leave enough points.

use portolan_geometry::Point3f;

use super::reservoir::sample;
use super::select;
use super::voxel_count::CountedPoints;
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
    // The range of a point that is not finite fails this comparison.
    let near: Vec<u32> =
        points.iter().zip(0_u32..).filter(|(p, _)| range(p) <= max_range).map(|(_, i)| i).collect();
    if near.len() <= min_num_points {
        return near;
    }
    let near_points = || near.iter().map(|i| points[*i as usize]);
    let mut search = Search { points: CountedPoints::new(near_points()), min_num_points };
    let chosen = sample(near_points(), search.length(max_length));
    chosen.into_iter().map(|i| near[i as usize]).collect()
}

fn range(p: &Point3f) -> f32 {
    (p.x * p.x + (p.y * p.y + p.z * p.z)).sqrt()
}

struct Search {
    points: CountedPoints,
    min_num_points: usize,
}

impl Search {
    /// Whether filtering with this edge leaves enough points.
    fn leaves_enough(&mut self, edge: f32) -> bool {
        self.points.are_in(self.min_num_points, edge)
    }

    /// The edge to filter with: the largest edge found that leaves enough points, or the finest edge tried.
    fn length(&mut self, max_length: f32) -> f32 {
        if self.leaves_enough(max_length) {
            return max_length;
        }
        let (mut high, mut finest) = (max_length, max_length);
        while high > 1e-2 * max_length {
            let mut low = high / 2.0;
            finest = low;
            if self.leaves_enough(low) {
                while (high - low) / low > 1e-1 {
                    let middle = (low + high) / 2.0;
                    if middle <= low || middle >= high {
                        break; // nothing lies between two neighbouring floats
                    }
                    if self.leaves_enough(middle) {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                return low;
            }
            high /= 2.0;
        }
        finest
    }
}
