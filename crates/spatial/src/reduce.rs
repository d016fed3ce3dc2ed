//! Voxel reduction of clouds: one or a few points for each voxel of exactly the given edge.

use portolan_numeric::scramble;

/// Which point or points replace the points of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VoxelRepresentative {
    /// The centre of the voxel (not a measured point).
    Centre,
    /// The mean of its points.
    Mean,
    /// This number of its points, chosen pseudo-randomly and reproducibly; all if there are fewer.
    Random(usize),
}

/// Bits per voxel coordinate when all three are packed into one number.
const PACKED_BITS: u32 = 32;

/// Reduces points (metres) by voxels of `edge` metres with a corner at the origin. Voxels are returned in
/// ascending order (x, then y, then z). Points that are not finite are left out. An edge that is not above
/// zero changes nothing.
pub fn reduce(points: &[[f32; 3]], edge: f32, representative: VoxelRepresentative) -> Vec<[f32; 3]> {
    if edge.is_nan() || edge <= 0.0 {
        return points.to_vec();
    }
    let keyed = by_voxel(points, edge);
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
                choose(voxel, count, &mut order);
                reduced.extend(order.iter().map(|i| points[*i as usize]));
            }
        }
    }
    reduced
}

/// Indices of (at most) `count` points of each voxel: those that [`reduce`] keeps with
/// [`VoxelRepresentative::Random`], in the same order.
pub fn reduce_indices(points: &[[f32; 3]], edge: f32, count: usize) -> Vec<u32> {
    if edge.is_nan() || edge <= 0.0 {
        return (0..points.len() as u32).collect();
    }
    let keyed = by_voxel(points, edge);
    let (mut kept, mut order) = (Vec::new(), Vec::new());
    for voxel in keyed.chunk_by(|a, b| a.0 == b.0) {
        choose(voxel, count, &mut order);
        kept.extend_from_slice(&order);
    }
    kept
}

/// Voxels and indices of the finite points, voxel by voxel.
fn by_voxel(points: &[[f32; 3]], edge: f32) -> Vec<([i64; 3], u32)> {
    let inverse = 1.0 / f64::from(edge);
    let index = |v: f32| whole(f64::from(v) * inverse);
    let voxel = |[x, y, z]: &[f32; 3]| [index(*x), index(*y), index(*z)];
    let finite = || points.iter().enumerate().filter(|(_, p)| p.iter().all(|v| v.is_finite()));
    let (mut low, mut high) = ([i64::MAX; 3], [i64::MIN; 3]);
    for (_, p) in finite() {
        let v = voxel(p);
        low = std::array::from_fn(|k| low[k].min(v[k]));
        high = std::array::from_fn(|k| high[k].max(v[k]));
    }
    if (0..3).any(|k| high[k].saturating_sub(low[k]) >= 1 << PACKED_BITS) {
        let mut keyed: Vec<([i64; 3], u32)> = finite().map(|(i, p)| (voxel(p), i as u32)).collect();
        keyed.sort_unstable();
        return keyed;
    }
    // Voxel and index packed into one number are much faster to sort.
    let pack = |p: &[f32; 3]| {
        let v = voxel(p);
        (0..3).fold(0_u128, |packed, k| packed << PACKED_BITS | (v[k] - low[k]) as u128)
    };
    let mut packed: Vec<u128> = finite().map(|(i, p)| pack(p) << 32 | i as u128).collect();
    packed.sort_unstable();
    let part =
        |packed: u128, k: u32| ((packed >> (32 + PACKED_BITS * (2 - k))) & ((1 << PACKED_BITS) - 1)) as i64;
    packed.into_iter().map(|p| (std::array::from_fn(|k| low[k] + part(p, k as u32)), p as u32)).collect()
}

/// The largest integer not above the value; a value out of range saturates. It avoids the function call that
/// `floor` is on some targets.
#[inline]
fn whole(value: f64) -> i64 {
    let toward_zero = value as i64;
    toward_zero.saturating_sub(i64::from(toward_zero as f64 > value))
}

/// Chooses some points of a voxel.
fn choose(voxel: &[([i64; 3], u32)], count: usize, order: &mut Vec<u32>) {
    order.clear();
    order.extend(voxel.iter().map(|(_, i)| *i));
    order.sort_unstable_by_key(|i| (scramble(*i), *i));
    order.truncate(count);
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
        let kept = reduce_indices(&points, 0.1, 1);
        let places: Vec<[f32; 3]> = kept.iter().map(|i| points[*i as usize]).collect();
        assert_eq!(places, reduce(&points, 0.1, VoxelRepresentative::Random(1)));
    }

    #[test]
    fn voxels_are_numbered_downward() {
        let values = [0.0, -0.0, 0.5, -0.5, -1.0, 2.0, -7.25, 1e18, -1e18, 1e30, -1e30, f64::INFINITY];
        assert_eq!(values.map(whole), values.map(|v| v.floor() as i64));
    }

    #[test]
    fn points_very_far_apart_have_voxels_too() {
        let points = [[1e12, 0.0, 0.0], [-1e12, 0.0, 0.0], [0.05, 0.0, 0.0], [0.06, 0.0, 0.0]];
        let reduced = reduce(&points, 0.1, VoxelRepresentative::Random(1));
        assert_eq!((reduced.len(), reduced[0][0], reduced[2][0]), (3, -1e12, 1e12));
        assert!(reduce(&[], 0.1, VoxelRepresentative::Mean).is_empty());
    }
}
