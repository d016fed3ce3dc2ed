//! The rigid transform that fits pairs of points best, in six closed forms (specification section 1.1).

use nalgebra::{Matrix3, Matrix4, Matrix6, SymmetricEigen, Vector4, Vector6};
use portolan_geometry::{Quaternion, Rigid3, Vector3, nalgebra as na, quaternion_from_angle_axis};

use crate::PairMoments;

/// Methods to minimise `Σ |m − (R d + t)|²`. The first four are exact and agree. Helix and small angles are
/// linearised: one step of the iteration that ICP repeats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum ClosedForm {
    /// Unit quaternion (Horn 1987).
    #[default]
    Quaternion,
    /// Singular values (Arun, Huang and Blostein 1987).
    Svd,
    /// Orthonormal matrices (Horn, Hilden and Negahdaripour 1988).
    Orthonormal,
    /// Dual quaternion (Walker, Shao and Volz 1991).
    DualQuaternion,
    /// Instantaneous helical motion (Hofer and Pottmann 2003).
    Helix,
    /// Small angles about the centroid.
    SmallAngle,
}

/// The transform from the data points to the model points. `None` for fewer than three pairs, or if the
/// result is not finite.
pub fn best_transform(pairs: &PairMoments, form: ClosedForm) -> Option<Rigid3> {
    if pairs.count < 3 || pairs.weight.is_nan() || pairs.weight <= 0.0 {
        return None;
    }
    let found = match form {
        ClosedForm::Quaternion => about_centroids(pairs, quaternion(pairs)),
        ClosedForm::Svd => about_centroids(pairs, svd(pairs)?),
        ClosedForm::Orthonormal => about_centroids(pairs, orthonormal(pairs)?),
        ClosedForm::DualQuaternion => dual_quaternion(pairs),
        ClosedForm::Helix => helix(pairs)?,
        ClosedForm::SmallAngle => about_centroids(pairs, small_angle(pairs)?),
    };
    portolan_geometry::is_valid_pose(&found).then_some(found)
}

fn about_centroids(pairs: &PairMoments, rotation: Quaternion) -> Rigid3 {
    let (data, model) = pairs.centroids();
    Rigid3::from_parts(na::Translation3::from(model - rotation * data), rotation)
}

fn from_matrix(matrix: &Matrix3<f64>) -> Quaternion {
    Quaternion::from_rotation_matrix(&na::Rotation3::from_matrix_unchecked(*matrix))
}

/// The eigenvector of the largest eigenvalue.
fn largest(matrix: Matrix4<f64>) -> Vector4<f64> {
    let eigen = SymmetricEigen::new(matrix);
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
}

fn quaternion(pairs: &PairMoments) -> Quaternion {
    let s = pairs.centred_data_model();
    let delta = Vector3::new(s.m23 - s.m32, s.m31 - s.m13, s.m12 - s.m21);
    let mut q = Matrix4::zeros();
    q[(0, 0)] = s.trace();
    q.fixed_view_mut::<1, 3>(0, 1).copy_from(&delta.transpose());
    q.fixed_view_mut::<3, 1>(1, 0).copy_from(&delta);
    q.fixed_view_mut::<3, 3>(1, 1).copy_from(&(s + s.transpose() - Matrix3::identity() * s.trace()));
    let v = largest(q);
    Quaternion::new_normalize(na::Quaternion::new(v[0], v[1], v[2], v[3]))
}

fn svd(pairs: &PairMoments) -> Option<Quaternion> {
    let svd = pairs.centred_data_model().try_svd(true, true, f64::EPSILON, 1000)?;
    let (u, v) = (svd.u?, svd.v_t?.transpose());
    // If a mirror image would fit better, the direction of least weight is flipped.
    let sign = (v * u.transpose()).determinant().signum();
    let mut flip = Matrix3::identity();
    let least = svd.singular_values.imin();
    flip[(least, least)] = sign;
    Some(from_matrix(&(v * flip * u.transpose())))
}

/// `R = H (HᵀH)^(−1/2)`, built from the eigenvectors v of HᵀH and their images u = H v/√λ. The third pair
/// completes both to right-handed systems, so that coplanar points (for which the formula divides by zero)
/// and mirror images give rotations, too.
fn orthonormal(pairs: &PairMoments) -> Option<Quaternion> {
    let h = pairs.centred_data_model().transpose();
    let eigen = SymmetricEigen::new(h.transpose() * h);
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let v = [0, 1].map(|k: usize| eigen.eigenvectors.column(order[k]).into_owned());
    let u0 = (h * v[0]).try_normalize(1e-300)?;
    let u1 = h * v[1];
    let u1 = (u1 - u0 * u0.dot(&u1)).try_normalize(1e-300)?;
    let rotation =
        u0 * v[0].transpose() + u1 * v[1].transpose() + u0.cross(&u1) * v[0].cross(&v[1]).transpose();
    Some(from_matrix(&rotation))
}

/// With s = t∘q the cost is quadratic in both; s follows from q, which is an eigenvector.
fn dual_quaternion(pairs: &PairMoments) -> Rigid3 {
    let n = pairs.weight;
    let dm = pairs.data_model;
    // Σ Q(m)ᵀ W(d), and C₂ = 2 Σ (W(d) − Q(m)); components in the order x, y, z, w.
    let cross = Vector3::new(dm.m32 - dm.m23, dm.m13 - dm.m31, dm.m21 - dm.m12);
    let mut product = Matrix4::zeros();
    product.fixed_view_mut::<3, 3>(0, 0).copy_from(&(dm + dm.transpose() - Matrix3::identity() * dm.trace()));
    product.fixed_view_mut::<3, 1>(0, 3).copy_from(&-cross);
    product.fixed_view_mut::<1, 3>(3, 0).copy_from(&-cross.transpose());
    product[(3, 3)] = dm.trace();
    let c1 = product * -2.0;
    let c2 = (right_product(&pairs.data) - left_product(&pairs.model)) * 2.0;
    let a = (c2.transpose() * c2 / (2.0 * n) - c1 - c1.transpose()) * 0.5;
    let q = largest(a);
    let s = c2 * q * (-1.0 / (2.0 * n));
    let rotation = Quaternion::new_normalize(na::Quaternion::new(q[3], q[0], q[1], q[2]));
    // t = s ∘ q*.
    let s = na::Quaternion::new(s[3], s[0], s[1], s[2]);
    let t = s * rotation.quaternion().conjugate();
    Rigid3::from_parts(na::Translation3::from(t.vector().into_owned()), rotation)
}

/// The matrix of b ↦ a∘b for a pure quaternion a.
fn left_product(a: &Vector3) -> Matrix4<f64> {
    let k = a.cross_matrix();
    let mut m = Matrix4::zeros();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&k);
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(a);
    m.fixed_view_mut::<1, 3>(3, 0).copy_from(&-a.transpose());
    m
}

/// The matrix of b ↦ b∘a.
fn right_product(a: &Vector3) -> Matrix4<f64> {
    let mut m = left_product(a);
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&-a.cross_matrix());
    m
}

fn helix(pairs: &PairMoments) -> Option<Rigid3> {
    let dd = pairs.data_data;
    let mut matrix = Matrix6::zeros();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * dd.trace() - dd));
    matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&pairs.data.cross_matrix());
    matrix.fixed_view_mut::<3, 3>(3, 0).copy_from(&-pairs.data.cross_matrix());
    matrix.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Matrix3::identity() * pairs.weight));
    let dm = pairs.data_model;
    let moment = Vector3::new(dm.m23 - dm.m32, dm.m31 - dm.m13, dm.m12 - dm.m21);
    let mut right = Vector6::zeros();
    right.fixed_rows_mut::<3>(0).copy_from(&moment);
    right.fixed_rows_mut::<3>(3).copy_from(&(pairs.model - pairs.data));
    let x = matrix.lu().solve(&right)?;
    Some(helical_motion(&x.fixed_rows::<3>(0).into_owned(), &x.fixed_rows::<3>(3).into_owned()))
}

/// The exact helical motion with the axis and pitch of the velocity field `v(x) = c̄ + c × x` and the angle
/// `atan |c|` (specification section 1.3); a translation by c̄ where c is zero.
pub fn helical_motion(c: &Vector3, c_bar: &Vector3) -> Rigid3 {
    let norm = c.norm();
    if norm < 1e-12 {
        return Rigid3::translation(c_bar.x, c_bar.y, c_bar.z);
    }
    let (angle, axis) = (norm.atan(), c / norm);
    let pitch = c.dot(c_bar) / (norm * norm);
    let moment = (c_bar - c * pitch) / norm;
    let point = axis.cross(&moment);
    let rotation = quaternion_from_angle_axis(&(axis * angle));
    let translation = point - rotation * point + axis * (pitch * angle);
    Rigid3::from_parts(na::Translation3::from(translation), rotation)
}

/// Takes the unknowns as the sines of the angles of `Rx Ry Rz`, so that the result is exactly a rotation.
fn small_angle(pairs: &PairMoments) -> Option<Quaternion> {
    let dd = pairs.centred_data_data();
    let dm = pairs.centred_data_model();
    let matrix = Matrix3::identity() * dd.trace() - dd;
    let right = Vector3::new(dm.m23 - dm.m32, dm.m31 - dm.m13, dm.m12 - dm.m21);
    let angles = matrix.cholesky()?.solve(&right).map(|s| s.clamp(-1.0, 1.0).asin());
    let turn = |axis, angle| Quaternion::from_axis_angle(&axis, angle);
    Some(
        turn(Vector3::x_axis(), angles.x)
            * turn(Vector3::y_axis(), angles.y)
            * turn(Vector3::z_axis(), angles.z),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::angular_distance;
    use proptest::prelude::*;

    fn pairs(points: &[[f64; 3]], model_from_data: &Rigid3) -> PairMoments {
        let mut moments = PairMoments::default();
        for (i, p) in points.iter().enumerate() {
            let data = Vector3::from(*p);
            let model = model_from_data * na::Point3::from(data);
            moments.add(&model.coords, &data, 1.0 + (i % 3) as f64);
        }
        moments
    }

    const EXACT: [ClosedForm; 4] =
        [ClosedForm::Quaternion, ClosedForm::Svd, ClosedForm::Orthonormal, ClosedForm::DualQuaternion];

    proptest! {
        #[test]
        fn exact_forms_find_the_transform(
            points in prop::collection::vec([-5.0..5.0f64, -5.0..5.0f64, -5.0..5.0f64], 6..20),
            t in [-9.0..9.0f64, -9.0..9.0f64, -9.0..9.0f64], w in [-1.7..1.7f64, -1.7..1.7f64, -1.7..1.7f64],
        ) {
            let expected = Rigid3::new(Vector3::from(t), Vector3::from(w));
            let moments = pairs(&points, &expected);
            for form in EXACT {
                let found = best_transform(&moments, form).unwrap();
                prop_assert!((found.translation.vector - expected.translation.vector).norm() < 1e-4, "{form:?}");
                prop_assert!(angular_distance(&found.rotation, &expected.rotation) < 1e-5, "{form:?}");
            }
        }
    }

    #[test]
    fn points_in_a_plane_are_enough_for_the_exact_forms() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.5, 1.0, 0.0]];
        let expected = Rigid3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.4, -0.8, 1.2));
        for form in EXACT {
            let found = best_transform(&pairs(&points, &expected), form).unwrap();
            assert!((found.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-6, "{form:?}");
        }
    }

    #[test]
    fn the_other_forms_converge_when_repeated() {
        let points: Vec<[f64; 3]> = (0..30)
            .map(f64::from)
            .map(|i| [(i * 0.7).sin() * 3.0, (i * 1.3).cos() * 2.0, (i * 0.37).sin()])
            .collect();
        let expected = Rigid3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.1, -0.2, 0.3));
        for form in [ClosedForm::Helix, ClosedForm::SmallAngle] {
            let mut found = Rigid3::identity();
            for _ in 0..20 {
                let mut moments = PairMoments::default();
                for p in &points {
                    let p = na::Point3::from(Vector3::from(*p));
                    moments.add(&(expected * p).coords, &(found * p).coords, 1.0);
                }
                found = best_transform(&moments, form).unwrap() * found;
            }
            assert!((found.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-9, "{form:?}");
        }
    }

    #[test]
    fn too_few_pairs_and_no_turn_are_no_trouble() {
        assert!(best_transform(&PairMoments::default(), ClosedForm::Svd).is_none());
        let motion = helical_motion(&Vector3::zeros(), &Vector3::new(1.0, 2.0, 3.0));
        assert_eq!(motion.translation.vector, Vector3::new(1.0, 2.0, 3.0));
    }
}
