//! Manifolds of the variables, and their degrees of freedom.

use nalgebra as na;

/// Degrees of freedom of a translation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TranslationFreedom {
    /// All.
    #[default]
    Free,
    /// In its plane z = const.
    ConstantZ,
    /// Not at all.
    Constant,
}

/// Degrees of freedom of a rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RotationFreedom {
    /// All: `q ⊞ δ = exp(δ) ⊗ q` with `exp(δ) = (cos‖δ‖, sin‖δ‖/‖δ‖·δ)`, so that δ is half a rotation vector.
    #[default]
    Free,
    /// About the z axis of the map: `q ⊞ δ = (√(1−δ²), 0, 0, δ) ⊗ q`, δ at most ½ in one step.
    YawOnly,
    /// About the horizontal axes of the body: `q ⊞ (a, b) = q ⊗ exp(a, b, 0)`. For a pose that is aligned to
    /// gravity while its heading is kept.
    ConstantYaw,
    /// Not at all.
    Constant,
}

/// Storage layout and degrees of freedom of one variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manifold {
    /// This number of components, updated by addition.
    Euclidean(u32),
    /// One number, updated by addition, kept at zero or above.
    NonNegative,
    /// A position `(x, y, z)`.
    Translation(TranslationFreedom),
    /// A 2D pose `(x, y, θ)`, updated by addition; θ is not wrapped.
    Se2,
    /// A unit quaternion `(w, x, y, z)`.
    Rotation(RotationFreedom),
    /// A pose `(x, y, z, qw, qx, qy, qz)`; translation and rotation move independently.
    Se3(TranslationFreedom, RotationFreedom),
}

impl Manifold {
    /// A pose with all degrees of freedom.
    pub const SE3: Self = Self::Se3(TranslationFreedom::Free, RotationFreedom::Free);

    /// Number of stored components of the variable.
    pub fn ambient_dimension(&self) -> usize {
        match self {
            Self::Euclidean(n) => *n as usize,
            Self::NonNegative => 1,
            Self::Translation(_) | Self::Se2 => 3,
            Self::Rotation(_) => 4,
            Self::Se3(..) => 7,
        }
    }

    /// Number of columns of the Jacobians of factors: the unrestricted tangent space. A rotation has three,
    /// the half-angle components of a rotation multiplied from the left (see [`RotationFreedom::Free`]). A
    /// pose has the translation first.
    pub fn tangent_dimension(&self) -> usize {
        match self {
            Self::Euclidean(n) => *n as usize,
            Self::NonNegative => 1,
            Self::Translation(_) | Self::Se2 | Self::Rotation(_) => 3,
            Self::Se3(..) => 6,
        }
    }

    /// Degrees of freedom.
    pub fn free_dimension(&self) -> usize {
        match self {
            Self::Translation(t) => t.dimension(),
            Self::Rotation(r) => r.dimension(),
            Self::Se3(t, r) => t.dimension() + r.dimension(),
            Self::Euclidean(_) | Self::NonNegative | Self::Se2 => self.tangent_dimension(),
        }
    }

    fn is_restricted(&self) -> bool {
        self.free_dimension() != self.tangent_dimension()
    }

    /// `out = x ⊞ delta`, with `delta` of [`Manifold::free_dimension`] components.
    pub(crate) fn plus(&self, x: &[f64], delta: &[f64], out: &mut [f64]) {
        out.copy_from_slice(x);
        match self {
            Self::Euclidean(_) | Self::Se2 => add(out, delta),
            Self::NonNegative => {
                add(out, delta);
                out[0] = out[0].max(0.0);
            }
            Self::Translation(_) => add(out, delta),
            Self::Rotation(freedom) => freedom.plus(out, delta),
            Self::Se3(translation, rotation) => {
                let (first, second) = delta.split_at(translation.dimension());
                add(&mut out[..3], first);
                rotation.plus(&mut out[3..], second);
            }
        }
    }

    /// Converts a Jacobian (column by column, `rows` long) for the unrestricted tangent space to one for the
    /// degrees of freedom, in place; returns the part used.
    pub(crate) fn restrict<'a>(&self, x: &[f64], rows: usize, jacobian: &'a mut [f64]) -> &'a mut [f64] {
        let columns = self.free_dimension();
        if self.is_restricted() {
            match self {
                Self::Translation(freedom) => {
                    restrict_rows(rows, jacobian, |row, out| freedom.restrict(row, out))
                }
                Self::Rotation(freedom) => {
                    let axes = freedom.axes(x);
                    restrict_rows(rows, jacobian, |row, out| freedom.restrict(&axes, row, out));
                }
                Self::Se3(translation, rotation) => {
                    let axes = rotation.axes(&x[3..]);
                    restrict_rows(rows, jacobian, |row, out| {
                        let (first, second) = out.split_at_mut(translation.dimension());
                        translation.restrict(&row[..3], first);
                        rotation.restrict(&axes, &row[3..], second);
                    });
                }
                Self::Euclidean(_) | Self::NonNegative | Self::Se2 => {}
            }
        }
        &mut jacobian[..rows * columns]
    }
}

fn add(out: &mut [f64], delta: &[f64]) {
    out.iter_mut().zip(delta).for_each(|(x, d)| *x += d);
}

/// Rewrites a Jacobian row by row; each row is read completely before it is written. The restricted row is
/// shorter and is written to the leading columns.
fn restrict_rows(rows: usize, jacobian: &mut [f64], restrict: impl Fn(&[f64], &mut [f64])) {
    let columns = jacobian.len() / rows.max(1);
    for r in 0..rows {
        let (mut row, mut out) = ([0.0; 6], [0.0; 6]);
        for c in 0..columns {
            row[c] = jacobian[c * rows + r];
        }
        restrict(&row[..columns], &mut out);
        for c in 0..columns {
            jacobian[c * rows + r] = out[c];
        }
    }
}

impl TranslationFreedom {
    fn dimension(self) -> usize {
        match self {
            Self::Free => 3,
            Self::ConstantZ => 2,
            Self::Constant => 0,
        }
    }

    fn restrict(self, row: &[f64], out: &mut [f64]) {
        let n = self.dimension();
        out[..n].copy_from_slice(&row[..n]);
    }
}

impl RotationFreedom {
    fn dimension(self) -> usize {
        match self {
            Self::Free => 3,
            Self::YawOnly => 1,
            Self::ConstantYaw => 2,
            Self::Constant => 0,
        }
    }

    fn plus(self, q: &mut [f64], delta: &[f64]) {
        let old = na::Quaternion::new(q[0], q[1], q[2], q[3]);
        let new = match (self, delta) {
            (Self::Free, &[a, b, c]) => exp_half_angle(a, b, c) * old,
            (Self::YawOnly, &[d]) => {
                let d = d.clamp(-0.5, 0.5);
                na::Quaternion::new((1.0 - d * d).sqrt(), 0.0, 0.0, d) * old
            }
            (Self::ConstantYaw, &[a, b]) => old * exp_half_angle(a, b, 0.0),
            _ => return,
        };
        // Normalise: rounding would accumulate over thousands of steps.
        let new = new / new.norm();
        q.copy_from_slice(&[new.w, new.i, new.j, new.k]);
    }

    /// The rotation's own axes in the outer frame, where they are needed: an update by `(a, b, 0)` from the
    /// right is one by `R (a, b, 0)` from the left.
    fn axes(self, q: &[f64]) -> na::Matrix3<f64> {
        if self != Self::ConstantYaw {
            return na::Matrix3::identity();
        }
        let q = na::Quaternion::new(q[0], q[1], q[2], q[3]);
        na::UnitQuaternion::new_normalize(q).to_rotation_matrix().into_inner()
    }

    fn restrict(self, axes: &na::Matrix3<f64>, row: &[f64], out: &mut [f64]) {
        match self {
            Self::Free => out[..3].copy_from_slice(&row[..3]),
            Self::YawOnly => out[0] = row[2],
            Self::ConstantYaw => {
                for (k, out) in out.iter_mut().take(2).enumerate() {
                    *out = (0..3).map(|i| row[i] * axes[(i, k)]).sum();
                }
            }
            Self::Constant => {}
        }
    }
}

/// `exp(δ)` of a half-angle vector.
fn exp_half_angle(a: f64, b: f64, c: f64) -> na::Quaternion<f64> {
    let norm = (a * a + b * b + c * c).sqrt();
    if norm == 0.0 {
        return na::Quaternion::identity();
    }
    let scale = norm.sin() / norm;
    na::Quaternion::new(norm.cos(), scale * a, scale * b, scale * c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn restricted_jacobians_are_derivatives_of_plus() {
        use RotationFreedom as R;
        use TranslationFreedom as T;
        let x = [0.3, -1.0, 2.0, 0.5, 0.5, -0.5, 0.5];
        for translation in [T::Free, T::ConstantZ, T::Constant] {
            for rotation in [R::Free, R::YawOnly, R::ConstantYaw, R::Constant] {
                let manifold = Manifold::Se3(translation, rotation);
                // With the identity as Jacobian, the result is the tangents of the degrees of freedom.
                let mut jacobian: Vec<f64> = na::Matrix6::<f64>::identity().as_slice().to_vec();
                let free = manifold.free_dimension();
                let restricted = manifold.restrict(&x, 6, &mut jacobian).to_vec();
                assert_eq!(restricted.len(), 6 * free);
                for k in 0..free {
                    let mut delta = vec![0.0; free];
                    delta[k] = 1e-6;
                    let (mut out, mut expected) = ([0.0; 7], [0.0; 7]);
                    manifold.plus(&x, &delta, &mut out);
                    let tangent: Vec<f64> = restricted[6 * k..6 * k + 6].iter().map(|v| v * 1e-6).collect();
                    Manifold::SE3.plus(&x, &tangent, &mut expected);
                    let error: f64 = out.iter().zip(&expected).map(|(a, b)| (a - b).abs()).sum();
                    assert!(error < 1e-11, "{manifold:?} {k}: {error}");
                }
            }
        }
    }

    #[test]
    fn large_steps_stay_on_the_manifold() {
        let mut out = [0.0; 4];
        for freedom in [RotationFreedom::Free, RotationFreedom::YawOnly, RotationFreedom::ConstantYaw] {
            let manifold = Manifold::Rotation(freedom);
            let delta = vec![3.0; manifold.free_dimension()];
            manifold.plus(&[1.0, 0.0, 0.0, 0.0], &delta, &mut out);
            assert!((out.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() < 1e-12);
        }
        let mut scalar = [0.0];
        Manifold::NonNegative.plus(&[1.0], &[-5.0], &mut scalar);
        assert_eq!(scalar[0], 0.0);
    }
}
