//! Histograms of the directions of walls, which decide whether two scans can match at a yaw at all.
//!
//! A cloud is cut into slices of equal height. Each slice is walked around its centroid, and the
//! directions of lines between nearby points are counted, more if the line is seen at a right angle. Half
//! a turn has as many buckets as the histogram. All arithmetic is `f32` (`slam3d.md` §4).

use std::collections::BTreeMap;
use std::f32::consts::PI;

use nalgebra as na;
use portolan_geometry::{Point3f, Vector2f};
use portolan_sensor::{PointCloud, lround};

use portolan_grids::is_finite;

/// Height of a slice, metres.
const SLICE_HEIGHT: f32 = 0.2;
/// Number of slices above and below the origin that are stored in an array; others are in a map.
const NEAR_SLICES: i64 = 512;
/// Points nearer to each other or to the centroid than this have no direction worth counting, metres.
const MIN_DISTANCE: f32 = 0.2;
/// Points farther from each other than this are not on the same wall, metres.
const MAX_DISTANCE: f32 = 0.9;

/// The histogram of a cloud (metres, in a gravity-aligned frame) with `num_buckets` buckets over half a
/// turn. Points that are not finite are left out.
pub fn rotational_histogram(cloud: &PointCloud, num_buckets: usize) -> Vec<f32> {
    let mut histogram = vec![0.0; num_buckets];
    if num_buckets == 0 {
        return histogram;
    }
    for slice in slices_of(cloud) {
        add_slice(&sorted_by_angle(slice), &mut histogram);
    }
    histogram
}

/// The finite points in slices of equal height, from the lowest to the highest; some slices are empty.
fn slices_of(cloud: &PointCloud) -> impl Iterator<Item = Vec<Point3f>> {
    let mut near = vec![Vec::new(); 2 * NEAR_SLICES as usize];
    let mut below: BTreeMap<i64, Vec<Point3f>> = BTreeMap::new();
    for point in cloud.points.iter().filter(|p| is_finite(p)) {
        let number = lround(point.z / SLICE_HEIGHT);
        let place = usize::try_from(number.saturating_add(NEAR_SLICES)).ok();
        match place.and_then(|place| near.get_mut(place)) {
            Some(slice) => slice.push(*point),
            None => below.entry(number).or_default().push(*point),
        }
    }
    let above = below.split_off(&0);
    below.into_values().chain(near).chain(above.into_values())
}

fn centroid(points: &[Point3f]) -> Vector2f {
    let sum = points.iter().fold(na::Vector3::zeros(), |sum, p| sum + p.coords);
    (sum / points.len() as f32).xy()
}

/// The points of a slice not too near to its centroid, by the angle around it.
fn sorted_by_angle(slice: Vec<Point3f>) -> Vec<Point3f> {
    let center = centroid(&slice);
    let mut by_angle = Vec::with_capacity(slice.len());
    for (p, i) in slice.iter().zip(0_u32..) {
        let offset = p.coords.xy() - center;
        if offset.norm() >= MIN_DISTANCE {
            by_angle.push(u64::from(ascending(offset.y.atan2(offset.x))) << 32 | u64::from(i));
        }
    }
    // Of equal angles the first point comes first: its number stands below the angle.
    by_angle.sort_unstable();
    by_angle.into_iter().filter_map(|key| slice.get(key as u32 as usize).copied()).collect()
}

/// Bits that ascend as numbers do ([`f32::total_cmp`]).
fn ascending(number: f32) -> u32 {
    let bits = number.to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}

fn add_slice(slice: &[Point3f], histogram: &mut [f32]) {
    let Some(mut reference) = slice.first().map(|p| p.coords.xy()) else { return };
    let center = centroid(slice);
    for point in slice.iter().map(|p| p.coords.xy()) {
        let (delta, direction) = (point - reference, point - center);
        let (distance, range) = (delta.norm(), direction.norm());
        if distance < MIN_DISTANCE || range < MIN_DISTANCE {
            continue;
        }
        if distance > MAX_DISTANCE {
            // Cartographer moves on only here, not with every point of a wall.
            reference = point;
            continue;
        }
        let angle = delta.y.atan2(delta.x);
        let value = (1.0 - ((delta / distance).dot(&(direction / range))).abs()).max(0.0);
        add_value(angle, value, histogram);
    }
}

fn add_value(mut angle: f32, value: f32, histogram: &mut [f32]) {
    while angle > PI {
        angle -= PI;
    }
    while angle < 0.0 {
        angle += PI;
    }
    let bucket = lround(histogram.len() as f32 * angle / PI - 0.5);
    let last = histogram.len() - 1;
    histogram[(bucket.max(0) as usize).min(last)] += value;
}

/// The histogram of a cloud rotated by `angle` radians, interpolated between buckets. An empty one remains
/// empty.
pub fn rotate_histogram(histogram: &[f32], angle: f32) -> Vec<f32> {
    let n = histogram.len();
    let turn = -angle * n as f32 / PI;
    let whole = lround(turn - 0.5);
    let fraction = turn - whole as f32;
    let shift = whole.rem_euclid(n.max(1) as i64) as usize;
    let at = |i: usize| histogram[i % n];
    (0..n).map(|i| fraction * at(i + 1 + shift) + (1.0 - fraction) * at(i + shift)).collect()
}

/// Similarity of two histograms, between 0 and 1: the cosine between them, 1 where there is nothing to
/// compare. Histograms of different sizes are compared as far as both reach.
pub fn histogram_similarity(a: &[f32], b: &[f32]) -> f32 {
    let norm = |h: &[f32]| h.iter().map(|v| v * v).sum::<f32>().sqrt();
    let norms = norm(a) * norm(b);
    // Also true for values that are not finite: they are nothing to compare.
    if norms.is_nan() || norms < 1e-3 {
        return 1.0;
    }
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>() / norms
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::cloud_a;

    #[test]
    fn the_histogram_of_the_golden_cloud() {
        let histogram = rotational_histogram(&cloud_a(), 120);
        assert!((histogram.iter().sum::<f32>() - 2.900_254_5).abs() < 1e-5);
        let rotated = rotate_histogram(&histogram, 0.3);
        let golden = [0.162_222_09, 0.137_720_4, 0.0, 0.0, 0.381_246_95, 0.323_664_22];
        assert!(rotated.iter().zip(golden).all(|(a, b)| (a - b).abs() < 1e-6), "{rotated:?}");
        for (angle, golden) in [(0.0, 0.194_254_98), (0.05, 0.090_169_996), (-0.1, 1.0), (1.0, 0.000_792_438)]
        {
            let score = histogram_similarity(&histogram, &rotate_histogram(&histogram, 0.1 + angle));
            assert!((score - golden).abs() < 1e-6, "{angle}: {score}");
        }
    }

    #[test]
    fn slices_come_in_order_of_their_height() {
        let heights = [1e30, -1e30, 0.0, 500.0, -500.0, 0.3, -0.3, 102.4, -102.3, 0.31];
        let points = heights.map(|z| Point3f::new(0.0, 0.0, z)).to_vec();
        let slices: Vec<Vec<f32>> =
            slices_of(&PointCloud::new(points)).map(|s| s.iter().map(|p| p.z).collect()).collect();
        let full: Vec<&[f32]> = slices.iter().map(Vec::as_slice).filter(|s| !s.is_empty()).collect();
        let expected: [&[f32]; 9] =
            [&[-1e30], &[-500.0], &[-102.3], &[-0.3], &[0.0], &[0.3, 0.31], &[102.4], &[500.0], &[1e30]];
        assert_eq!(full, expected);
    }

    #[test]
    fn rotation_interpolates_between_buckets() {
        let one_hot =
            |bucket: usize| -> Vec<f32> { (0..10).map(|i| f32::from(u8::from(i == bucket))).collect() };
        let step = PI / 10.0;
        let score = |submap: usize, buckets: f32| {
            histogram_similarity(&one_hot(submap), &rotate_histogram(&one_hot(2), buckets * step))
        };
        for i in 0..10 {
            let t = i as f32 / 10.0;
            let expected = t / t.hypot(1.0 - t);
            for found in [score(3, t), score(3, 2.0 - t)] {
                assert!((found - expected).abs() < 1e-4, "{t}: {found}");
            }
            let back = |buckets: f32| {
                histogram_similarity(&one_hot(2), &rotate_histogram(&one_hot(3), buckets * step))
            };
            assert!((back(-t) - expected).abs() < 1e-4 && (back(t - 2.0) - expected).abs() < 1e-4);
        }
        let wall = one_hot(4);
        assert!((histogram_similarity(&wall, &wall) - 1.0).abs() < 1e-6);
        assert!(histogram_similarity(&wall, &rotate_histogram(&wall, 0.1)) < 0.99);
    }

    #[test]
    fn histograms_turn_by_buckets() {
        let histogram = [1.0, 2.0, 3.0, 4.0];
        assert_eq!(rotate_histogram(&histogram, 0.0), histogram);
        for (angle, expected) in [(PI / 4.0, [4.0, 1.0, 2.0, 3.0]), (-PI / 8.0, [1.5, 2.5, 3.5, 2.5])] {
            let turned = rotate_histogram(&histogram, angle);
            assert!(turned.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{turned:?}");
        }
    }

    #[test]
    fn empty_histograms_are_similar() {
        assert_eq!(histogram_similarity(&[0.0; 10], &[0.0; 10]), 1.0);
        assert_eq!(histogram_similarity(&[], &[]), 1.0);
        assert_eq!(histogram_similarity(&[f32::NAN, 1.0], &[1.0, 1.0]), 1.0);
        assert!(rotate_histogram(&[], 1.0).is_empty() && rotational_histogram(&cloud_a(), 0).is_empty());
        let far = PointCloud::new(vec![Point3f::new(f32::NAN, 0.0, 0.0), Point3f::new(0.0, 0.0, 1e30)]);
        assert_eq!(rotational_histogram(&far, 4), [0.0; 4]);
    }
}
