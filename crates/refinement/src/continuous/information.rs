//! Finds directions that the surfaces measured at a time do not determine.

use nalgebra::{Matrix3, Matrix6, SymmetricEigen};
use portolan_geometry::Vector3;

use super::report::Undetermined;

/// Length of the intervals of which the information is summed, seconds.
pub(crate) const SECONDS: f64 = 1.0;
/// Fraction of the information of the best direction below which a direction is not determined: errors of
/// normals of two degrees would feign as much.
pub(crate) const LEAST_SHARE: f64 = 2e-3;
/// Cosine above which directions in consecutive seconds are the same.
const SAME: f64 = 0.94;

/// Finds undetermined directions, from the information (translation, rotation about the tracking frame; world
/// axes) of each second. Empty seconds (without surfaces) are covered by other warnings.
pub(crate) fn undetermined(information: &[Matrix6<f64>]) -> Vec<Undetermined> {
    let mut found: Vec<Undetermined> = Vec::new();
    for (second, matrix) in information.iter().enumerate() {
        if matrix.trace() <= 0.0 {
            continue;
        }
        let (from, to) = (second as f64 * SECONDS, (second + 1) as f64 * SECONDS);
        let block = |r, c| matrix.fixed_view::<3, 3>(r, c).into_owned();
        for (is_rotation, first) in [(false, 0), (true, 3)] {
            let other = 3 - first;
            for direction in weak_directions(block(first, first), block(first, other), block(other, other)) {
                let same = found.iter_mut().rev().find(|u| {
                    u.to == from
                        && u.is_rotation == is_rotation
                        && Vector3::from(u.direction).dot(&direction).abs() > SAME
                });
                match same {
                    Some(longer) => longer.to = to,
                    None => found.push(Undetermined { from, to, is_rotation, direction: direction.into() }),
                }
            }
        }
    }
    found
}

/// Directions of the block `own` with little information once the block `other` is eliminated.
fn weak_directions(own: Matrix3<f64>, between: Matrix3<f64>, other: Matrix3<f64>) -> Vec<Vector3> {
    let slack = Matrix3::identity() * (1e-9 * other.trace().max(f64::MIN_POSITIVE));
    let Some(inverse) = (other + slack).try_inverse() else { return Vec::new() };
    let marginal = own - between * inverse * between.transpose();
    let eigen = SymmetricEigen::new((marginal + marginal.transpose()) * 0.5);
    let most = eigen.eigenvalues.max();
    (0..3)
        .filter(|k| eigen.eigenvalues[*k] < LEAST_SHARE * most)
        .map(|k| {
            let v: Vector3 = eigen.eigenvectors.column(k).into_owned();
            // One of the two opposite directions, always the same.
            if v[v.iamax()] < 0.0 { -v } else { v }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(points: &[([f64; 3], [f64; 3])]) -> Matrix6<f64> {
        points
            .iter()
            .map(|(at, normal)| {
                let (p, n) = (Vector3::from(*at), Vector3::from(*normal));
                let j = nalgebra::Vector6::new(n.x, n.y, n.z, p.cross(&n).x, p.cross(&n).y, p.cross(&n).z);
                j * j.transpose()
            })
            .sum()
    }

    #[test]
    fn a_corridor_has_one_free_direction() {
        let mut points = Vec::new();
        for i in 0..20 {
            let x = f64::from(i) - 10.0;
            points.extend([([x, 1.0, 0.3], [0.0, -1.0, 0.0]), ([x, -1.0, 0.2], [0.0, 1.0, 0.0])]);
            points.extend([([x, 0.5, -1.0], [0.0, 0.0, 1.0]), ([x, -0.5, -1.0], [0.0, 0.0, 1.0])]);
        }
        let corridor = seen(&points);
        let found = undetermined(&[corridor, corridor]);
        assert_eq!(found.len(), 1);
        assert!(!found[0].is_rotation && found[0].direction[0].abs() > 0.99 && found[0].to == 2.0);
        points.extend([([10.0, 0.1, 0.2], [-1.0, 0.0, 0.0]), ([10.0, -0.3, 0.5], [-1.0, 0.0, 0.0])]);
        assert!(undetermined(&[seen(&points)]).is_empty());
        assert!(undetermined(&[Matrix6::zeros()]).is_empty());
    }
}
