//! Estimates the directions of surfaces in a planar scan.

use portolan_geometry::Vector2;
use portolan_sensor::PointCloud;

/// Range of distances between neighbouring returns, metres, that belong to one surface and give its
/// direction.
const NEIGHBOURS: (f32, f32) = (0.15, 0.5);
/// Number of following returns that are searched for a neighbour.
const LOOKED_AT: usize = 12;

/// Unit vectors along the surface at each return, where it has a neighbour on the surface. Returns are in the
/// order in which the scanner measured them.
pub fn surface_tangents(returns: &PointCloud) -> Vec<Option<Vector2>> {
    let points = &returns.points;
    let mut tangents = vec![None; points.len()];
    for (i, a) in points.iter().enumerate() {
        for (j, b) in points.iter().enumerate().skip(i + 1).take(LOOKED_AT) {
            let along = b - a;
            let length = along.x.hypot(along.y);
            if length >= NEIGHBOURS.0 && length <= NEIGHBOURS.1 {
                let tangent = Vector2::new(f64::from(along.x / length), f64::from(along.y / length));
                tangents[i] = Some(tangent);
                tangents[j] = Some(tangent);
                break;
            }
        }
    }
    tangents
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;

    #[test]
    fn tangents_follow_from_neighbouring_points() {
        let wall = (0..5).map(|i| Point3f::new(2.0, 0.2 * i as f32, 0.0));
        let cloud = PointCloud::new(wall.chain([Point3f::new(9.0, 9.0, 0.0)]).collect());
        let tangents = surface_tangents(&cloud);
        assert!(tangents[..5].iter().all(|t| t.is_some_and(|t| (t - Vector2::y()).norm() < 1e-6)));
        assert_eq!(tangents[5], None);
    }
}
