//! Point clouds on a millimetre grid, as nodes store them (`formats.md §4.3`).

use std::collections::BTreeMap;

use portolan_geometry::Point3f;

use crate::proto::sensor::CompressedPointCloud;

/// Edge of a grid cell, metres.
const PRECISION: f32 = 0.001;
/// Bits of a coordinate within a block.
const BITS: u32 = 10;
const MASK: i32 = (1 << BITS) - 1;
/// Smallest cell index that cannot be stored: 2²³ cells (8388 m).
const MAX_CELL: f32 = 8_388_608.0;

/// Why a cloud could not be compressed or decompressed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PointCloudError {
    /// A coordinate is not finite or beyond 8388 m.
    #[error("Point out of bounds: point {index} at ({x}, {y}, {z}) m; coordinates must be below 8388 m")]
    OutOfBounds {
        /// Number of the point.
        index: usize,
        /// Metres.
        x: f32,
        /// Metres.
        y: f32,
        /// Metres.
        z: f32,
    },
    /// The numbers end within a block.
    #[error("the compressed cloud is cut off: {found} of {stated} points are there")]
    Truncated {
        /// Points according to the message.
        stated: i64,
        /// Points found.
        found: usize,
    },
    /// A block states a negative number of points.
    #[error("the compressed cloud has a block of {0} points")]
    BlockSize(i32),
}

/// Compresses points, with an error of at most half a millimetre in each coordinate. The points come back in
/// the order of their blocks, not in that of `points`.
///
/// # Errors
/// If a point is beyond the bounds of the format.
pub fn compress(points: &[Point3f]) -> Result<CompressedPointCloud, PointCloudError> {
    let mut blocks: BTreeMap<[i32; 9], ([i32; 3], Vec<i32>)> = BTreeMap::new();
    for (index, point) in points.iter().enumerate() {
        let cell = [point.x, point.y, point.z].map(|v| (v / PRECISION).round());
        if !cell.iter().all(|v| v.abs() < MAX_CELL) {
            let [x, y, z] = [point.x, point.y, point.z];
            return Err(PointCloudError::OutOfBounds { index, x, y, z });
        }
        let cell = cell.map(|v| v as i32);
        let block = cell.map(|v| v >> BITS);
        let [x, y, z] = cell.map(|v| v & MASK);
        let entry = blocks.entry(block_order(block)).or_insert_with(|| (block, Vec::new()));
        entry.1.push((z << (2 * BITS)) + (y << BITS) + x);
    }
    let mut point_data = Vec::with_capacity(points.len() + 4 * blocks.len());
    for (block, words) in blocks.values() {
        point_data.push(words.len() as i32);
        point_data.extend_from_slice(block);
        point_data.extend_from_slice(words);
    }
    Ok(CompressedPointCloud { num_points: points.len() as i32, point_data })
}

/// Sort key of blocks: the order of a three-level grid, z before y before x on each level.
fn block_order([x, y, z]: [i32; 3]) -> [i32; 9] {
    [z >> 6, y >> 6, x >> 6, z >> 3 & 7, y >> 3 & 7, x >> 3 & 7, z & 7, y & 7, x & 7]
}

/// Decompresses points, metres. The message is validated; memory stays below twelve bytes for each number in
/// it.
///
/// # Errors
/// If the message is damaged.
pub fn decompress(cloud: &CompressedPointCloud) -> Result<Vec<Point3f>, PointCloudError> {
    let stated = i64::from(cloud.num_points);
    let wanted = usize::try_from(stated).unwrap_or(0);
    let mut points = Vec::with_capacity(wanted.min(cloud.point_data.len()));
    let mut rest = &cloud.point_data[..];
    while points.len() < wanted {
        let truncated = PointCloudError::Truncated { stated, found: points.len() };
        let Some(([count, block @ ..], after)) = rest.split_first_chunk::<4>() else {
            return Err(truncated);
        };
        let count = usize::try_from(*count).map_err(|_| PointCloudError::BlockSize(*count))?;
        let (words, after) = after.split_at_checked(count).ok_or(truncated)?;
        rest = after;
        let [x, y, z] = block.map(|b| b.wrapping_shl(BITS));
        let wanted_here = words.iter().take(wanted - points.len());
        points.extend(wanted_here.map(|word| {
            let at = |corner: i32, within: i32| corner.wrapping_add(within) as f32 * PRECISION;
            Point3f::new(at(x, word & MASK), at(y, word >> BITS & MASK), at(z, word >> (2 * BITS)))
        }));
    }
    Ok(points)
}

#[cfg(test)]
// Golden values keep the digits that were printed.
#[allow(clippy::excessive_precision)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn golden_values() {
        let points = [
            [1.2345, -0.5, 0.25],
            [-3.0, 2.0, 0.001],
            [1.2349, -0.5004, 0.2496],
            [100.0, -200.0, 5.0],
            [0.0, 0.0, 0.0],
            [1.0235, -0.0005, 0.0015],
            [-0.0015, 70.0, -0.0025],
        ]
        .map(Point3f::from);
        let cloud = compress(&points).unwrap();
        assert_eq!(cloud.num_points, 7);
        let expected = [
            1, -1, 68, -1, 1072022526, 1, 97, -196, 4, 948634272, 1, 0, -1, 0, 3145727, 2, 1, -1, 0,
            262680787, 262680787, 1, -3, 1, 0, 2048072, 1, 0, 0, 0, 0,
        ];
        assert_eq!(cloud.point_data, expected);
        let back = decompress(&cloud).unwrap();
        assert_eq!(back[0], Point3f::new(-0.00200000009, 70.0, -0.00200000009));
        assert_eq!(back[1], Point3f::new(100.000008, -200.000015, 5.0));
        assert_eq!(back[5], Point3f::new(-3.00000024, 2.0, 0.00100000005));
    }

    #[test]
    fn golden_cloud() {
        let mut state = 1_u32;
        let mut draw = |a: f32| {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            ((state >> 8) as f32 / 16777216.0 * 2.0 - 1.0) * a
        };
        let points: Vec<_> = (0..1000).map(|_| Point3f::new(draw(20.0), draw(20.0), draw(3.0))).collect();
        let cloud = compress(&points).unwrap();
        assert_eq!(
            (cloud.point_data.len(), &cloud.point_data[..5]),
            (4812, &[1, -20, -18, -3, 470291353][..])
        );
        let bytes: Vec<u8> = cloud.point_data.iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(crc32fast::hash(&bytes), 0x1899_a761);
    }

    #[test]
    fn points_too_far_away_are_named() {
        for x in [8389.0, f32::NAN, f32::NEG_INFINITY] {
            let points = [Point3f::origin(), Point3f::new(x, 0.0, 0.0)];
            assert!(matches!(compress(&points), Err(PointCloudError::OutOfBounds { index: 1, .. })));
        }
    }

    proptest! {
        #[test]
        fn repacking_is_exact(points in prop::collection::vec(prop::array::uniform3(-900.0f32..900.0), 0..60)) {
            let points: Vec<_> = points.into_iter().map(Point3f::from).collect();
            let once = compress(&points).unwrap();
            let back = decompress(&once).unwrap();
            prop_assert_eq!(back.len(), points.len());
            prop_assert_eq!(compress(&back).unwrap(), once);
        }

        #[test]
        fn any_numbers_terminate(num_points in any::<i32>(), point_data in prop::collection::vec(prop_oneof![0..5, any::<i32>()], 0..60)) {
            let cloud = CompressedPointCloud { num_points, point_data };
            if let Ok(points) = decompress(&cloud) {
                prop_assert!(points.len() <= cloud.point_data.len());
            }
        }
    }
}
