//! Updates poses in the published parametrisations.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, SMatrix, SVector, Vector6};
use portolan_geometry::{Quaternion, Rigid3, Vector3, nalgebra as na, quaternion_from_angle_axis};
use portolan_solver::NormalBlocks;

use super::sums::LinkSums;
use super::{FIXED, GlobalError, Link, TRACE, hold};
use portolan_spatial::helical_motion;

/// Cosine of the middle angle below which Euler angles are singular.
const SINGULAR: f64 = 1e-3;

/// `exp(ξ) T` to first order in the translation, exact in the rotation (order translation, rotation; world).
pub(super) fn move_by_twist(pose: &Rigid3, twist: &Vector6<f64>) -> Rigid3 {
    let turn = quaternion_from_angle_axis(&Vector3::new(twist[3], twist[4], twist[5]));
    let shift = na::Translation3::new(twist[0], twist[1], twist[2]);
    let mut moved = Rigid3::from_parts(shift, turn) * pose;
    moved.rotation.renormalize();
    moved
}

/// Subtracts the error X = H ΔX (section 2.3, `R = Rx Ry Rz`) from position and Euler angles; where H is
/// singular, from the pose itself.
pub(super) fn move_by_euler(pose: &Rigid3, error: &Vector6<f64>) -> Rigid3 {
    let r = pose.rotation.to_rotation_matrix();
    let r = r.matrix();
    let angles = Vector3::new((-r.m23).atan2(r.m33), r.m13.clamp(-1.0, 1.0).asin(), (-r.m12).atan2(r.m11));
    let (sx, cx) = angles.x.sin_cos();
    let (sy, cy) = angles.y.sin_cos();
    if cy.abs() < SINGULAR {
        return move_by_twist(pose, &-error);
    }
    let turn = Vector3::new(error[3], error[4], error[5]);
    let rates = Matrix3::new(1.0, 0.0, sy, 0.0, cx, -sx * cy, 0.0, sx, cx * cy);
    let Some(inverse) = rates.try_inverse() else { return move_by_twist(pose, &-error) };
    let angles = angles - inverse * turn;
    let t = pose.translation.vector;
    let t = t - (Vector3::new(error[0], error[1], error[2]) - t.cross(&turn));
    let about = |axis, angle| Quaternion::from_axis_angle(&axis, angle);
    let rotation = about(Vector3::x_axis(), angles.x)
        * about(Vector3::y_axis(), angles.y)
        * about(Vector3::z_axis(), angles.z);
    Rigid3::from_parts(na::Translation3::from(t), rotation)
}

/// One step with quaternions (section 2.4): seven unknowns for each scan, of which the scale is discarded.
pub(super) fn quaternion_step(
    poses: &mut [Rigid3],
    links: &[Link],
    sums: &[LinkSums],
) -> Result<usize, GlobalError> {
    let size = 7 * poses.len();
    let (mut matrix, mut right) = (DMatrix::<f64>::identity(size, size) * TRACE, DVector::<f64>::zeros(size));
    let mut used = 0;
    for (link, sum) in links.iter().zip(sums) {
        let Some((block, vector)) = weighted7(sum) else { continue };
        used += 1;
        let (a, b) = (7 * link.from, 7 * link.to);
        for (r, c, sign) in [(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)] {
            let mut view = matrix.fixed_view_mut::<7, 7>(r, c);
            view += block * sign;
        }
        for (r, sign) in [(a, 1.0), (b, -1.0)] {
            let mut view = right.fixed_rows_mut::<7>(r);
            view += vector * sign;
        }
    }
    for k in 0..7 {
        matrix[(k, k)] += FIXED;
    }
    let solution = matrix.cholesky().ok_or(GlobalError::Singular)?.solve(&right);
    for (i, pose) in poses.iter_mut().enumerate().skip(1) {
        let x: SVector<f64, 7> = solution.fixed_rows::<7>(7 * i).into_owned();
        let (shift, scale, v) = (Vector3::new(x[0], x[1], x[2]), x[3], Vector3::new(x[4], x[5], x[6]));
        let t = pose.translation.vector;
        let t = t - (shift + t * scale - v.cross(&t));
        let q = pose.rotation.quaternion();
        let (p, q, r, s) = (q.w, q.i, q.j, q.k);
        // The lower right part of H is twice an orthogonal matrix.
        let h = na::Matrix4::new(p, q, r, s, q, -p, s, -r, r, -s, -p, q, s, r, -q, -p) * 2.0;
        let change = h.transpose() * na::Vector4::new(scale, v.x, v.y, v.z) / 4.0;
        let rotation = na::Quaternion::new(p - change[0], q - change[1], r - change[2], s - change[3]);
        *pose = Rigid3::from_parts(na::Translation3::from(t), Quaternion::new_normalize(rotation));
    }
    Ok(used)
}

fn weighted7(sum: &LinkSums) -> Option<(SMatrix<f64, 7, 7>, SVector<f64, 7>)> {
    let count = sum.statistics.count;
    if count < 4 {
        return None;
    }
    let difference = sum.matrix7.cholesky()?.solve(&sum.vector7);
    let rest = sum.statistics.squares - sum.vector7.dot(&difference);
    let variance = rest / (3.0 * count as f64 - 7.0).max(1.0);
    (variance > 1e-12).then(|| (sum.matrix7 / variance, sum.vector7 / variance))
}

/// One step with helical motions (section 2.5).
pub(super) fn helix_step(
    poses: &mut [Rigid3],
    links: &[Link],
    sums: &[LinkSums],
) -> Result<usize, GlobalError> {
    let mut equations = NormalBlocks::new(poses.len());
    let mut used = 0;
    for (link, sum) in links.iter().zip(sums).filter(|(_, s)| s.statistics.count >= 3) {
        used += 1;
        let pairs = &sum.pairs;
        let n = pairs.weight;
        // Σ Jₓᵀ J_y for J = [I | −[x]×].
        let product = |x: &Vector3, y: &Vector3, yx: &Matrix3<f64>| {
            let mut m = Matrix6::zeros();
            m.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * n));
            m.fixed_view_mut::<3, 3>(0, 3).copy_from(&-y.cross_matrix());
            m.fixed_view_mut::<3, 3>(3, 0).copy_from(&x.cross_matrix());
            // [x]×ᵀ[y]× = (x·y) I − y xᵀ.
            m.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Matrix3::identity() * yx.trace() - yx));
            m
        };
        let (p, q) = (&pairs.model, &pairs.data);
        let rows = |m: &Matrix6<f64>| -> [f64; 36] { std::array::from_fn(|i| m[(i / 6, i % 6)]) };
        equations.add_block(link.from, link.from, &rows(&product(p, p, &sum.model_model)));
        equations.add_block(link.to, link.to, &rows(&product(q, q, &pairs.data_data)));
        let between = -product(p, q, &pairs.data_model);
        if link.from > link.to {
            equations.add_block(link.from, link.to, &rows(&between));
        } else {
            equations.add_block(link.to, link.from, &rows(&between.transpose()));
        }
        // Σ p × z = −Σ p × q, Σ q × z = Σ q × p with z = p − q.
        let dm = pairs.data_model;
        let q_cross_p = Vector3::new(dm.m23 - dm.m32, dm.m31 - dm.m13, dm.m12 - dm.m21);
        let z = p - q;
        let (a, b) = (q_cross_p, q_cross_p);
        equations.add_right(link.from, &[-z.x, -z.y, -z.z, -a.x, -a.y, -a.z]);
        equations.add_right(link.to, &[z.x, z.y, z.z, b.x, b.y, b.z]);
    }
    hold(&mut equations, poses.len());
    let solution = equations.solve().map_err(|_| GlobalError::Singular)?.ok_or(GlobalError::Singular)?;
    for (pose, x) in poses.iter_mut().zip(solution.chunks_exact(6)).skip(1) {
        let motion = helical_motion(&Vector3::new(x[3], x[4], x[5]), &Vector3::new(x[0], x[1], x[2]));
        *pose = motion * *pose;
        pose.rotation.renormalize();
    }
    Ok(used)
}

/// One step with small rotations about the centroids of the pairs, then translations (section 2.6).
pub(super) fn small_angle_step(
    poses: &mut [Rigid3],
    links: &[Link],
    sums: &[LinkSums],
) -> Result<usize, GlobalError> {
    let size = 3 * poses.len();
    let used: Vec<(&Link, &LinkSums)> =
        links.iter().zip(sums).filter(|(_, s)| s.statistics.count >= 3).collect();
    let (mut matrix, mut right) = (DMatrix::<f64>::identity(size, size) * TRACE, DVector::<f64>::zeros(size));
    for (link, sum) in &used {
        let (_, p) = sum.pairs.centroids();
        let n = sum.pairs.weight;
        let mm = sum.model_model - p * p.transpose() * n;
        let dd = sum.pairs.centred_data_data();
        let dm = sum.pairs.centred_data_model();
        let square = |m: Matrix3<f64>| Matrix3::identity() * m.trace() - m;
        let (a, b) = (3 * link.from, 3 * link.to);
        let mut add = |r: usize, c: usize, block: Matrix3<f64>| {
            let mut view = matrix.fixed_view_mut::<3, 3>(r, c);
            view += block;
        };
        add(a, a, square(mm));
        add(b, b, square(dd));
        add(a, b, -square(dm));
        add(b, a, -square(dm).transpose());
        let q_cross_p = Vector3::new(dm.m23 - dm.m32, dm.m31 - dm.m13, dm.m12 - dm.m21);
        for (at, sign) in [(a, -1.0), (b, 1.0)] {
            let mut view = right.fixed_rows_mut::<3>(at);
            view += q_cross_p * sign;
        }
    }
    (0..3).for_each(|k| matrix[(k, k)] += FIXED);
    let turns = matrix.cholesky().ok_or(GlobalError::Singular)?.solve(&right);
    let turn = |i: usize| quaternion_from_angle_axis(&turns.fixed_rows::<3>(3 * i).into_owned());
    let (mut matrix, mut right) = (DMatrix::<f64>::identity(size, size) * TRACE, DVector::<f64>::zeros(size));
    for (link, sum) in &used {
        let (q, p) = sum.pairs.centroids();
        let difference = turn(link.from) * p - turn(link.to) * q;
        let (a, b) = (3 * link.from, 3 * link.to);
        for k in 0..3 {
            matrix[(a + k, a + k)] += 1.0;
            matrix[(b + k, b + k)] += 1.0;
            matrix[(a + k, b + k)] -= 1.0;
            matrix[(b + k, a + k)] -= 1.0;
            right[a + k] -= difference[k];
            right[b + k] += difference[k];
        }
    }
    (0..3).for_each(|k| matrix[(k, k)] += FIXED);
    let shifts = matrix.cholesky().ok_or(GlobalError::Singular)?.solve(&right);
    for (i, pose) in poses.iter_mut().enumerate().skip(1) {
        let shift = na::Translation3::from(shifts.fixed_rows::<3>(3 * i).into_owned());
        *pose = Rigid3::from_parts(shift, turn(i)) * *pose;
        pose.rotation.renormalize();
    }
    Ok(used.len())
}
