//! Checks analytic Jacobians numerically, for tests of factors.

use super::{Factor, Manifold};

/// Step of the central differences.
const STEP: f64 = 1e-6;

/// Largest difference between the Jacobians of a factor and central differences of its residual, over all
/// entries, each divided by one plus the magnitude of the largest entry. `variables` are manifold and numbers
/// of each variable; restrictions of the manifolds are ignored. Infinite if the factor cannot be evaluated.
pub fn jacobian_error(factor: &dyn Factor, variables: &[(Manifold, Vec<f64>)]) -> f64 {
    let rows = factor.residual_dimension();
    let mut numbers: Vec<Vec<f64>> = variables.iter().map(|(_, x)| x.clone()).collect();
    let manifolds: Vec<Manifold> = variables.iter().map(|(m, _)| unrestricted(m)).collect();
    let mut analytic: Vec<Vec<f64>> =
        manifolds.iter().map(|m| vec![0.0; rows * m.tangent_dimension()]).collect();
    let evaluate = |numbers: &[Vec<f64>], jacobians: Option<&mut [&mut [f64]]>| {
        let parameters: Vec<&[f64]> = numbers.iter().map(Vec::as_slice).collect();
        let mut residual = vec![0.0; rows];
        factor.evaluate(&parameters, &mut residual, jacobians).then_some(residual)
    };
    let mut slices: Vec<&mut [f64]> = analytic.iter_mut().map(Vec::as_mut_slice).collect();
    if evaluate(&numbers, Some(&mut slices)).is_none() {
        return f64::INFINITY;
    }
    let scale = 1.0 + analytic.iter().flatten().fold(0.0, |max: f64, v| max.max(v.abs()));
    let mut error: f64 = 0.0;
    for (index, (manifold, jacobian)) in manifolds.iter().zip(&analytic).enumerate() {
        for (k, column) in jacobian.chunks_exact(rows.max(1)).enumerate() {
            let mut at = |step: f64| {
                let mut delta = vec![0.0; manifold.tangent_dimension()];
                delta[k] = step;
                let original = numbers[index].clone();
                manifold.plus(&original, &delta, &mut numbers[index]);
                let residual = evaluate(&numbers, None);
                numbers[index] = original;
                residual
            };
            let (Some(above), Some(below)) = (at(STEP), at(-STEP)) else { return f64::INFINITY };
            for ((above, below), analytic) in above.iter().zip(&below).zip(column) {
                let numeric = (above - below) / (2.0 * STEP);
                let difference = (numeric - analytic).abs() / scale;
                error = if difference.is_nan() { f64::INFINITY } else { error.max(difference) };
            }
        }
    }
    error
}

fn unrestricted(manifold: &Manifold) -> Manifold {
    match manifold {
        Manifold::Se3(..) => Manifold::SE3,
        Manifold::Rotation(_) => Manifold::Rotation(Default::default()),
        Manifold::Translation(_) => Manifold::Translation(Default::default()),
        Manifold::NonNegative => Manifold::Euclidean(1),
        other => *other,
    }
}
