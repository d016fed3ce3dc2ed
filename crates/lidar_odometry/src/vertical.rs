//! Estimates the vertical from floors, ceilings and walls, for a trajectory that starts without an IMU.

use nalgebra as na;
use portolan_geometry::Vector3;

use crate::plane_map::PlaneMap;
use crate::settings::VerticalSettings;
use crate::settings::constants::vertical::{CANDIDATES, LEAST_PLANES, WALL_WEIGHT};

/// The direction in the frame of the planes that is normal to floors and ceilings and perpendicular to the
/// normals of walls, near `assumed` (unit vectors). None if the planes do not determine it.
///
/// It minimises `Σ_walls w (n·u)² − Σ_floors w (n·u)²`, whose minimum is an eigenvector, with walls and
/// floors selected again within narrowing tolerances.
pub(crate) fn vertical_from_planes(
    map: &PlaneMap,
    assumed: &Vector3,
    settings: &VerticalSettings,
) -> Option<Vector3> {
    let planes: Vec<(Vector3, f64)> = map
        .planes()
        .map(|(plane, hits)| (plane.normal.cast::<f64>(), f64::from(hits.min(settings.max_hits_per_plane))))
        .collect();
    let total: f64 = planes.iter().map(|(_, weight)| weight).sum();
    if total < LEAST_PLANES * f64::from(settings.max_hits_per_plane) {
        return None;
    }
    let mut up = best_start(&planes, assumed, settings)?;
    let mut fraction = 0.0;
    for tolerance in settings.tolerances {
        let mut sum = na::Matrix3::zeros();
        let mut used = 0.0;
        for (normal, weight) in &planes {
            let cosine = normal.dot(&up).abs();
            if cosine > tolerance.cos() {
                sum -= normal * normal.transpose() * *weight;
                used += weight;
            } else if cosine < tolerance.sin() {
                sum += normal * normal.transpose() * (WALL_WEIGHT * weight);
                used += weight;
            }
        }
        let eigen = na::SymmetricEigen::new(sum);
        let vector: Vector3 = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        up = vector * vector.dot(&up).signum();
        fraction = used / total;
    }
    (fraction >= settings.min_fraction && up.dot(assumed) > settings.max_tilt.cos()).then_some(up)
}

/// The assumed direction, or the normal near it, that most planes agree with.
fn best_start(planes: &[(Vector3, f64)], assumed: &Vector3, settings: &VerticalSettings) -> Option<Vector3> {
    let assumed = assumed.try_normalize(1e-9)?;
    let tolerance = *settings.tolerances.first()?;
    let agreement = |up: &Vector3| -> f64 {
        let part = |(normal, weight): &(Vector3, f64)| {
            let cosine = normal.dot(up).abs();
            if cosine > tolerance.cos() {
                *weight
            } else if cosine < tolerance.sin() {
                WALL_WEIGHT * weight
            } else {
                0.0
            }
        };
        planes.iter().map(part).sum()
    };
    let mut best = (agreement(&assumed), assumed);
    let stride = planes.len().div_ceil(CANDIDATES).max(1);
    for (normal, _) in planes.iter().step_by(stride) {
        let candidate = normal * normal.dot(&assumed).signum();
        if candidate.dot(&assumed) > settings.max_tilt.cos() {
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
    fn vertical_of_a_tilted_room_is_estimated() {
        let tilt = rotation_from_roll_pitch_yaw(0.1, -0.2, 0.7);
        let mut map = PlaneMap::new(1.0);
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
        let up = vertical_from_planes(&map, &Vector3::z(), &VerticalSettings::default()).unwrap();
        assert!(up.dot(&(tilt * Vector3::z())) > 0.005_f64.cos(), "{up}");
        let nothing = PlaneMap::new(1.0);
        assert_eq!(vertical_from_planes(&nothing, &Vector3::z(), &VerticalSettings::default()), None);
    }
}
