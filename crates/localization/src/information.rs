//! What the points of a scan tell of its pose.

use portolan_geometry::Vector3;

use crate::belief::{Freedom, Matrix6, Vector6};

/// Standard deviation of the distance of one point from its wall, metres; so large because neighbours on one wall err
/// together.
const POINT_SIGMA: f64 = 0.1;
/// Normals are off by some 10°: so much of the information of the strongest direction appears in the weakest
/// without anything being there, and is taken off.
const SPURIOUS: f64 = 0.04;

/// A point at a surface: where it is from the scanner, in the axes of the map, and the normal of the surface there.
pub(crate) struct Contact {
    pub lever: Vector3,
    pub normal: Vector3,
}

/// Point-to-surface constraints along normals (Censi 2007, "On achievable accuracy for range-finder localization").
pub(crate) fn information(contacts: impl Iterator<Item = Contact>, freedom: Freedom) -> Matrix6 {
    let mut sum = Matrix6::zeros();
    for Contact { lever, normal } in contacts {
        let turn = lever.cross(&normal);
        let row = Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z);
        sum += row * row.transpose();
    }
    without_spurious(&sum, freedom) / (POINT_SIGMA * POINT_SIGMA)
}

/// Takes off what errors of normals add in every direction.
fn without_spurious(information: &Matrix6, freedom: Freedom) -> Matrix6 {
    let lever = lever_scale(information, freedom);
    let scale = Vector6::new(1.0, 1.0, 1.0, lever, lever, lever);
    let scaled = information.component_mul(&(scale * scale.transpose()).map(|v: f64| 1.0 / v));
    let eigen = scaled.symmetric_eigen();
    let most = eigen.eigenvalues.max();
    let kept = eigen.eigenvalues.map(|value| (value - SPURIOUS * most).max(0.0));
    let reduced = eigen.eigenvectors * Matrix6::from_diagonal(&kept) * eigen.eigenvectors.transpose();
    reduced.component_mul(&(scale * scale.transpose()))
}

/// How far, metres, the points lie that a turn moves, so that turns can be compared with shifts.
fn lever_scale(information: &Matrix6, freedom: Freedom) -> f64 {
    let (axes, turning) = match freedom {
        Freedom::Plane => (2.0, 1.0),
        Freedom::Space => (3.0, 3.0),
    };
    let sum = |from: usize| (from..from + 3).map(|i| information[(i, i)]).sum::<f64>();
    let (shifts, turns) = (sum(0) / axes, sum(3) / turning);
    if shifts > 0.0 { (turns / shifts).sqrt().max(0.1) } else { 1.0 }
}
