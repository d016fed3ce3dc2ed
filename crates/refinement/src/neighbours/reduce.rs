//! Reduction of clouds: one or a few points for each voxel of exactly the given edge.

/// What stands for the points of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VoxelRepresentative {
    /// The middle of the voxel (not a measured point).
    Centre,
    /// The mean of its points.
    Mean,
    /// So many of its points, chosen at random but always the same ones; all if there are fewer.
    Random(usize),
}

/// Reduces points (metres) by voxels of `edge` metres with a corner at the origin. Voxels come in ascending
/// order (x, then y, then z). Points that are not finite are left out; an edge that is not above zero
/// changes nothing.
pub fn reduce(points: &[[f32; 3]], edge: f32, representative: VoxelRepresentative) -> Vec<[f32; 3]> {
    if edge.is_nan() || edge <= 0.0 {
        return points.to_vec();
    }
    let inverse = 1.0 / f64::from(edge);
    let mut keyed: Vec<([i64; 3], u32)> = points
        .iter()
        .enumerate()
        .filter(|(_, p)| p.iter().all(|v| v.is_finite()))
        .map(|(i, p)| (p.map(|v| (f64::from(v) * inverse).floor() as i64), i as u32))
        .collect();
    keyed.sort_unstable();
    let mut reduced = Vec::new();
    let mut order: Vec<u32> = Vec::new();
    for voxel in keyed.chunk_by(|a, b| a.0 == b.0) {
        match representative {
            VoxelRepresentative::Centre => {
                reduced.push(voxel[0].0.map(|k| ((k as f64 + 0.5) * f64::from(edge)) as f32));
            }
            VoxelRepresentative::Mean => {
                let mut sum = [0.0f64; 3];
                for (_, i) in voxel {
                    for (sum, v) in sum.iter_mut().zip(points[*i as usize]) {
                        *sum += f64::from(v);
                    }
                }
                reduced.push(sum.map(|s| (s / voxel.len() as f64) as f32));
            }
            VoxelRepresentative::Random(count) => {
                order.clear();
                order.extend(voxel.iter().map(|(_, i)| *i));
                order.sort_unstable_by_key(|i| (scramble(*i), *i));
                reduced.extend(order.iter().take(count).map(|i| points[*i as usize]));
            }
        }
    }
    reduced
}

/// A fixed pseudo-random order of indices (Murmur3's finaliser).
fn scramble(index: u32) -> u32 {
    let mut h = index.wrapping_add(0x9e37_79b9);
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    h ^ (h >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voxels_have_exactly_the_edge_asked_for() {
        let points =
            [[0.01, 0.0, 0.0], [0.09, 0.0, 0.0], [0.11, 0.0, 0.0], [-0.01, 0.0, 0.0], [f32::NAN, 0.0, 0.0]];
        assert_eq!(
            reduce(&points, 0.1, VoxelRepresentative::Mean),
            [[-0.01, 0.0, 0.0], [0.05, 0.0, 0.0], [0.11, 0.0, 0.0]]
        );
        let centres = reduce(&points, 0.1, VoxelRepresentative::Centre);
        assert_eq!((centres.len(), centres[1]), (3, [0.05, 0.05, 0.05]));
        assert_eq!(reduce(&points, 0.1, VoxelRepresentative::Random(1)).len(), 3);
        assert_eq!(reduce(&points, 0.1, VoxelRepresentative::Random(5)).len(), 4);
    }
}
