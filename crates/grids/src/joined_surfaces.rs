//! Fills surfaces between neighbouring beams.
//!
//! Far away neighbouring beams are many cells apart, and their hits form dots in the grid. A scan taken half
//! a metre farther on hits the same wall between the dots, where the grid is unknown. If neighbours are on
//! one line with the beam before or after them they hit one surface, and the points between them are a part
//! of it.
//!
//! Submaps that are made again at the end do without: sharp walls everywhere let a robot be localised in
//! another building (docs/experiments/2026-11-far-walls-2d.md).

use portolan_geometry::{Point3f, Vector2f};
use portolan_sensor::RangeData;

use super::insert_sectors::beam_spacing;

/// Maximum angle between neighbouring beams, in beam spacings: none is missing between them.
const NEIGHBOURS: f32 = 1.5;
/// Maximum distance between returns that are joined, metres: a door fits into a wider gap.
const FARTHEST: f32 = 0.8;

/// Points between neighbouring returns of one surface, `step` metres apart at most, in the frame of the scan, metres.
pub(crate) fn between_neighbours(scan: &RangeData, step: f32) -> Vec<Vector2f> {
    let spacing = beam_spacing(scan);
    let beams = in_order(scan);
    let mut points = Vec::new();
    if !spacing.is_finite() {
        return points;
    }
    let is_pair = |a: &Beam, b: &Beam| b.direction - a.direction <= NEIGHBOURS * spacing;
    for (i, pair) in beams.windows(2).enumerate() {
        let [a, b] = pair else { continue };
        let along = b.end - a.end;
        let length = along.norm();
        if length <= step || length > FARTHEST || !is_pair(a, b) {
            continue;
        }
        let before = i.checked_sub(1).and_then(|i| beams.get(i)).filter(|beam| is_pair(beam, a));
        let after = beams.get(i + 2).filter(|beam| is_pair(b, beam));
        let goes_on = |from: &Vector2f, to: &Vector2f| {
            let other = to - from;
            other.dot(&along) > 0.0 && other.perp(&along).abs() <= step * length
        };
        let is_surface = before.is_some_and(|before| goes_on(&before.end, &a.end))
            || after.is_some_and(|after| goes_on(&b.end, &after.end));
        if is_surface {
            let count = (length / step).ceil();
            points.extend((1..count as u32).map(|k| a.end + along * (k as f32 / count)));
        }
    }
    points
}

struct Beam {
    direction: f32,
    end: Vector2f,
}

/// The returns of a scan by direction.
fn in_order(scan: &RangeData) -> Vec<Beam> {
    let origin = scan.origin.xy().coords;
    let beam = |point: &Point3f| {
        let end = point.xy().coords;
        let along = end - origin;
        Beam { direction: along.y.atan2(along.x), end }
    };
    let mut beams: Vec<Beam> =
        scan.returns.points.iter().map(beam).filter(|beam| beam.direction.is_finite()).collect();
    beams.sort_by(|a, b| a.direction.total_cmp(&b.direction));
    beams
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;
    use portolan_sensor::PointCloud;

    /// A scan of half a turn with a beam each degree from the origin to `range` of its direction in radians.
    fn scan(range: impl Fn(f32) -> Option<f32>) -> RangeData {
        let beam = |i: u16| {
            let direction = f32::from(i).to_radians();
            range(direction).map(|r| Point3f::new(r * direction.cos(), r * direction.sin(), 0.0))
        };
        RangeData {
            origin: Point3f::origin(),
            returns: PointCloud::new((0..=180).filter_map(beam).collect()),
            misses: PointCloud::default(),
        }
    }

    fn wall(distance: f32) -> impl Fn(f32) -> Option<f32> {
        move |direction| Some(distance / direction.sin()).filter(|range| (0.0..60.0).contains(range))
    }

    #[test]
    fn gaps_of_a_far_wall_are_joined_and_those_of_a_near_one_are_not() {
        let points = between_neighbours(&scan(wall(20.0)), 0.1);
        assert!(points.len() > 300, "{}", points.len());
        assert!(points.iter().all(|point| (point.y - 20.0).abs() < 1e-3));
        // The widest gaps that are joined are 0.8 m, where beams hit the wall at a grazing angle.
        assert!(points.iter().all(|point| point.x.abs() < 23.5));
        assert!(between_neighbours(&scan(wall(1.0)), 0.1).iter().all(|point| point.x.abs() > 1.5));
    }

    #[test]
    fn a_corner_is_not_cut_and_a_door_is_not_closed() {
        let corner = scan(|direction| Some(if direction < 1.57 { 20.0 / direction.sin() } else { 12.0 }));
        let points = between_neighbours(&corner, 0.1);
        let is_between = |point: &Vector2f| (12.5..19.5).contains(&point.norm());
        assert!(!points.is_empty() && !points.iter().any(is_between));
        // Four beams pass through a door of 1.4 m.
        let door = scan(|direction| {
            let wall = wall(20.0)(direction)?;
            let x = wall * direction.cos();
            if (2.0..3.4).contains(&x) { None } else { Some(wall) }
        });
        let is_in_door = |point: &Vector2f| (2.1..3.3).contains(&point.x);
        assert!(!between_neighbours(&door, 0.1).iter().any(is_in_door));
    }

    #[test]
    fn returns_that_are_not_collinear_are_not_joined() {
        let leaves = scan(|direction| Some(20.0 + 3.0 * (43_758.55 * (12.99 * direction).sin()).fract()));
        let few = between_neighbours(&leaves, 0.1).len();
        assert!(few < 300, "{few} where 180 gaps have room for some 2,500");
        assert!(between_neighbours(&scan(|_| None), 0.1).is_empty());
        let two = scan(|direction| (direction < 0.02).then_some(20.0));
        assert!(between_neighbours(&two, 0.1).is_empty());
        let absurd = scan(|direction| Some(if direction < 1.0 { f32::NAN } else { f32::INFINITY }));
        assert!(between_neighbours(&absurd, 0.1).is_empty());
    }
}
