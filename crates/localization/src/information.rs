//! Computes the information about the pose of a scan from its points at surfaces.

use portolan_geometry::Vector3;

use crate::belief::{Freedom, Matrix6, Vector6};
use crate::settings::matching::{NORMAL_VARIANCE, POINT_SIGMA, SPURIOUS_FRACTION};

/// A point at a surface: its position from the scanner, in the axes of the map, and the normal of the
/// surface there.
#[derive(Clone, Copy)]
pub(crate) struct Contact {
    pub lever: Vector3,
    pub normal: Vector3,
}

/// Information of point-to-surface constraints along normals (Censi 2007, "On achievable accuracy for
/// range-finder localization").
pub(crate) fn information(contacts: impl Iterator<Item = Contact>, freedom: Freedom) -> Matrix6 {
    let (mut sum, mut along_surfaces) = (Matrix6::zeros(), Matrix6::zeros());
    for Contact { lever, normal } in contacts {
        let (_, along_normal) = distance_information(&lever, &normal);
        sum += along_normal;
        along_surfaces += along_surface(&lever, &along_normal);
    }
    let kept = match freedom {
        Freedom::TwoD => without_spurious(&sum, freedom),
        // n̂ = n + δ, with δ along the surface: E[n̂ n̂ᵀ] is n nᵀ and the variance of δ in both of its directions.
        Freedom::ThreeD => {
            reduced(&(sum - NORMAL_VARIANCE * along_surfaces), lever_scale(&sum, freedom), 0.0)
        }
    };
    kept / (POINT_SIGMA * POINT_SIGMA)
}

/// Derivative by the pose of a distance along a direction, for a point at a lever from the scanner, and its
/// outer product: the information of that distance.
pub(crate) fn distance_information(lever: &Vector3, direction: &Vector3) -> (Vector6, Matrix6) {
    let turn = lever.cross(direction);
    let row = Vector6::new(direction.x, direction.y, direction.z, turn.x, turn.y, turn.z);
    (row, row * row.transpose())
}

/// Information that distances along both directions of a surface would have, if the distance along its
/// normal has the given one.
pub(crate) fn along_surface(lever: &Vector3, along_normal: &Matrix6) -> Matrix6 {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    axes.map(|axis| distance_information(lever, &axis).1).iter().sum::<Matrix6>() - along_normal
}

/// In 3D: the positive part of the information.
pub(crate) fn positive(information: &Matrix6) -> Matrix6 {
    reduced(information, lever_scale(information, Freedom::ThreeD), 0.0)
}

/// Subtracts the spurious information that errors of normals add in every direction.
fn without_spurious(information: &Matrix6, freedom: Freedom) -> Matrix6 {
    reduced(information, lever_scale(information, freedom), SPURIOUS_FRACTION)
}

/// Subtracts this fraction of the largest eigenvalue in every direction and keeps the positive part.
/// Rotations are compared with translations by a lever, metres.
fn reduced(information: &Matrix6, lever: f64, fraction: f64) -> Matrix6 {
    let scale = Vector6::new(1.0, 1.0, 1.0, lever, lever, lever);
    let scaled = information.component_mul(&(scale * scale.transpose()).map(|v: f64| 1.0 / v));
    let eigen = scaled.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let kept = eigen.eigenvalues.map(|value| (value - fraction * most).max(0.0));
    let reduced = eigen.eigenvectors * Matrix6::from_diagonal(&kept) * eigen.eigenvectors.transpose();
    reduced.component_mul(&(scale * scale.transpose()))
}

/// Typical distance of the points that constrain rotation, metres, so that rotations can be compared with
/// translations.
fn lever_scale(information: &Matrix6, freedom: Freedom) -> f64 {
    let (axes, turning) = match freedom {
        Freedom::TwoD => (2.0, 1.0),
        Freedom::ThreeD => (3.0, 3.0),
    };
    let sum = |from: usize| (from..from + 3).map(|i| information[(i, i)]).sum::<f64>();
    let (shifts, turns) = (sum(0) / axes, sum(3) / turning);
    if shifts > 0.0 { (turns / shifts).sqrt().max(0.1) } else { 1.0 }
}

/// Fraction of the largest information below which the information in a direction is rounding.
const NOTHING: f64 = 1e-9;

/// The degenerate direction of a match, as a unit vector in the map, or of length 0 if that is a rotation
/// alone; none if all directions are constrained.
pub(crate) fn degenerate_direction(information: &Matrix6, freedom: Freedom) -> Option<Vector3> {
    let lever = lever_scale(information, freedom);
    let scale = Vector6::new(1.0, 1.0, 1.0, lever, lever, lever);
    let mut scaled = information.component_mul(&(scale * scale.transpose()).map(|v: f64| 1.0 / v));
    let most = scaled.trace();
    let closed = Vector6::repeat(1.0) - freedom.variances(1.0, 1.0);
    scaled += Matrix6::from_diagonal(&(closed * most));
    let eigen = scaled.symmetric_eigen();
    let (index, least) = eigen.eigenvalues.argmin();
    let direction = eigen.eigenvectors.column(index).fixed_rows::<3>(0).into_owned();
    let is_turn = direction.norm() < std::f64::consts::FRAC_1_SQRT_2;
    let is_degenerate = least <= NOTHING * most;
    is_degenerate.then(|| if is_turn { Vector3::zeros() } else { direction.normalize() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walls with these normals, ten points each, seen from a distance.
    fn walls(normals: &[[f64; 2]]) -> Matrix6 {
        let contact = |normal: &[f64; 2], i: i32| {
            let normal = Vector3::new(normal[0], normal[1], 0.0);
            let along = Vector3::new(-normal.y, normal.x, 0.0);
            Contact { lever: 2.0 * normal + 0.3 * f64::from(i) * along, normal }
        };
        let contacts = normals.iter().flat_map(|n| (-5..=5).map(move |i| contact(n, i)));
        information(contacts, Freedom::TwoD)
    }

    #[test]
    fn in_3d_ground_does_not_hide_information_from_trunks() {
        let ground =
            (-20..=20).flat_map(|i| (-20..=20).map(move |j| [0.5 * f64::from(i), 0.5 * f64::from(j)]));
        let ground = ground.map(|[x, y]| Contact { lever: Vector3::new(x, y, -1.0), normal: Vector3::z() });
        let trunks = (0..360).map(|i| {
            let normal = Vector3::new(f64::from(i).to_radians().cos(), f64::from(i).to_radians().sin(), 0.0);
            Contact { lever: 5.0 * normal, normal }
        });
        let of_ground = information(ground.clone(), Freedom::ThreeD);
        assert!(of_ground[(0, 0)] < 1e-4 * of_ground[(2, 2)] && of_ground[(5, 5)] < 1.0, "{of_ground}");
        // 180 points face each axis; errors of 1681 + 180 normals may add a spurious 0.03 each.
        let both = information(ground.chain(trunks), Freedom::ThreeD) * (POINT_SIGMA * POINT_SIGMA);
        assert!((both[(0, 0)] - (180.0 - 0.03 * 1861.0)).abs() < 3.0, "{both}");
    }

    #[test]
    fn a_corridor_is_degenerate_along_its_walls_and_a_room_is_not() {
        let corridor = walls(&[[0.6, 0.8], [-0.6, -0.8]]);
        let direction = degenerate_direction(&corridor, Freedom::TwoD).unwrap();
        assert!(direction.cross(&Vector3::new(-0.8, 0.6, 0.0)).norm() < 1e-6, "{direction}");
        assert_eq!(degenerate_direction(&walls(&[[1.0, 0.0], [0.0, 1.0]]), Freedom::TwoD), None);
    }
}
