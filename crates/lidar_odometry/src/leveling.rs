//! Which way is up, from floors, ceilings and walls.

use nalgebra as na;
use portolan_geometry::Vector3;

use crate::map::SurfaceMap;

/// The scanner is assumed to be tilted less than this, radians.
const MAX_TILT: f64 = 0.8;
/// Surfaces this near to level or upright count, radians: first and last.
const TOLERANCES: [f64; 4] = [0.35, 0.2, 0.1, 0.06];
/// A floor shows which way is up better than a wall, which fixes only one direction.
const WEIGHT_OF_WALLS: f64 = 0.5;
/// So many hits on planes are needed.
const MIN_HITS: f64 = 500.0;
/// And so large a share of them on floors, ceilings and walls as found.
const MIN_SHARE: f64 = 0.3;

/// The direction in the frame of the surfaces that floors and ceilings face and walls do not, near
/// `believed` (unit vectors). None if the surfaces do not tell.
///
/// It minimises `Σ_walls w (n·u)² − Σ_floors w (n·u)²`, whose minimum is an eigenvector, with walls and
/// floors chosen anew within narrowing tolerances.
pub fn up_direction(surfaces: &SurfaceMap, believed: &Vector3) -> Option<Vector3> {
    let planes: Vec<(Vector3, f64)> = surfaces
        .planes()
        .map(|(plane, hits)| (plane.normal.cast::<f64>(), f64::from(hits.min(200))))
        .collect();
    let total: f64 = planes.iter().map(|(_, weight)| weight).sum();
    if total < MIN_HITS {
        return None;
    }
    let mut up = best_start(&planes, believed)?;
    let mut share = 0.0;
    for tolerance in TOLERANCES {
        let mut sum = na::Matrix3::zeros();
        let mut used = 0.0;
        for (normal, weight) in &planes {
            let cosine = normal.dot(&up).abs();
            if cosine > tolerance.cos() {
                sum -= normal * normal.transpose() * *weight;
                used += weight;
            } else if cosine < tolerance.sin() {
                sum += normal * normal.transpose() * (WEIGHT_OF_WALLS * weight);
                used += weight;
            }
        }
        let eigen = na::SymmetricEigen::new(sum);
        let vector: Vector3 = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        up = vector * vector.dot(&up).signum();
        share = used / total;
    }
    (share >= MIN_SHARE && up.dot(believed) > MAX_TILT.cos()).then_some(up)
}

/// The believed direction, or the normal near it, that most surfaces agree with.
fn best_start(planes: &[(Vector3, f64)], believed: &Vector3) -> Option<Vector3> {
    let believed = believed.try_normalize(1e-9)?;
    let agreement = |up: &Vector3| -> f64 {
        let part = |(normal, weight): &(Vector3, f64)| {
            let cosine = normal.dot(up).abs();
            if cosine > 0.97 {
                *weight
            } else if cosine < 0.15 {
                WEIGHT_OF_WALLS * weight
            } else {
                0.0
            }
        };
        planes.iter().map(part).sum()
    };
    let mut best = (agreement(&believed), believed);
    let stride = planes.len().div_ceil(200).max(1);
    for (normal, _) in planes.iter().step_by(stride) {
        let candidate = normal * normal.dot(&believed).signum();
        if candidate.dot(&believed) > MAX_TILT.cos() {
            let found = agreement(&candidate);
            if found > best.0 {
                best = (found, candidate);
            }
        }
    }
    Some(best.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Point3f, rotation_from_roll_pitch_yaw};

    #[test]
    fn a_tilted_room_tells_where_up_is() {
        let tilt = rotation_from_roll_pitch_yaw(0.1, -0.2, 0.7);
        let mut map = SurfaceMap::new(1.0);
        let mut add = |x: f64, y: f64, z: f64| {
            let p = tilt * Vector3::new(x, y, z);
            map.insert(&Point3f::new(p.x as f32, p.y as f32, p.z as f32));
        };
        for i in 0..100 {
            for j in 0..100 {
                let (u, v) = (0.06 * f64::from(i) - 3.0, 0.06 * f64::from(j) - 3.0);
                add(u, v, -1.0);
                if v.abs() < 1.5 {
                    add(3.0, u, v);
                    add(u, -2.0, v);
                    // A ramp.
                    add(u, v, 3.0 + 0.3 * u);
                }
            }
        }
        let up = up_direction(&map, &Vector3::z()).unwrap();
        assert!(up.dot(&(tilt * Vector3::z())) > 0.005_f64.cos(), "{up}");
        assert_eq!(up_direction(&SurfaceMap::new(1.0), &Vector3::z()), None);
    }
}
