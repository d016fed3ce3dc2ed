//! Robust losses, which limit the weight of large residuals.

/// A loss `ρ(s)` of the squared norm `s = ‖r‖²` of a whole factor; the cost is `½ Σ ρ(s)`. All but
/// [`Loss::Tolerant`] have `ρ(s) ≈ s` for small `s`. Scales are in units of the (weighted) residual.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Loss {
    /// `s`: plain least squares.
    #[default]
    None,
    /// `s` up to `s = a²`, then `2a√s − a²`: linear in the residual.
    Huber(f64),
    /// `b·ln(1 + e^{(s−a)/b}) − b·ln(1 + e^{−a/b})`: nearly zero up to `s = a`, then `s − a`, with a
    /// transition of width `b`. Here `a` and `b` are in units of `s`.
    Tolerant(f64, f64),
    /// `c²·ln(1 + s/c²)`.
    Cauchy(f64),
    /// `a²/3·(1 − (1 − s/a²)³)` up to `s = a²`, then constant.
    Tukey(f64),
    /// `s·c²/(c² + s)`.
    GemanMcClure(f64),
    /// `s` up to `c²`, then constant: larger residuals have no effect.
    Truncated(f64),
}

/// Value and derivatives of a loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossValue {
    /// `ρ(s)`.
    pub value: f64,
    /// `ρ′(s)`: the weight of the factor.
    pub first: f64,
    /// `ρ″(s)`.
    pub second: f64,
}

/// Argument from which `ln(1 + eˣ) = x` in double precision.
const LOG_OF_LARGEST_MANTISSA: f64 = 36.7;

impl Loss {
    /// `ρ`, `ρ′` and `ρ″` at `s ≥ 0`.
    pub fn evaluate(&self, s: f64) -> LossValue {
        let plain = LossValue { value: s, first: 1.0, second: 0.0 };
        match *self {
            Self::None => plain,
            Self::Huber(a) if s <= a * a => plain,
            Self::Huber(a) => {
                let norm = s.sqrt();
                let first = (a / norm).max(f64::MIN_POSITIVE);
                LossValue { value: 2.0 * a * norm - a * a, first, second: -first / (2.0 * s) }
            }
            Self::Tolerant(a, b) => tolerant(s, a, b),
            Self::Cauchy(c) => {
                let inverse = 1.0 / (1.0 + s / (c * c));
                let value = c * c * (s / (c * c)).ln_1p();
                LossValue { value, first: inverse, second: -inverse * inverse / (c * c) }
            }
            Self::Tukey(a) if s <= a * a => {
                let rest = 1.0 - s / (a * a);
                let value = a * a / 3.0 * (1.0 - rest.powi(3));
                LossValue { value, first: rest * rest, second: -2.0 * rest / (a * a) }
            }
            Self::Tukey(a) => LossValue { value: a * a / 3.0, first: 0.0, second: 0.0 },
            Self::GemanMcClure(c) => {
                let ratio = c * c / (c * c + s);
                let second = -2.0 * ratio.powi(3) / (c * c);
                LossValue { value: s * ratio, first: ratio * ratio, second }
            }
            Self::Truncated(c) if s <= c * c => plain,
            Self::Truncated(c) => LossValue { value: c * c, first: 0.0, second: 0.0 },
        }
    }

    /// Whether every scale is positive and finite; `a` of [`Loss::Tolerant`] may be zero.
    pub fn is_valid(&self) -> bool {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        match *self {
            Self::None => true,
            Self::Tolerant(a, b) => a >= 0.0 && a.is_finite() && positive(b),
            Self::Huber(c) | Self::Cauchy(c) | Self::Tukey(c) => positive(c),
            Self::GemanMcClure(c) | Self::Truncated(c) => positive(c),
        }
    }
}

fn tolerant(s: f64, a: f64, b: f64) -> LossValue {
    let offset = b * (-a / b).exp().ln_1p();
    let x = (s - a) / b;
    if x > LOG_OF_LARGEST_MANTISSA {
        return LossValue { value: s - a - offset, first: 1.0, second: 0.0 };
    }
    let power = x.exp();
    LossValue {
        value: b * power.ln_1p() - offset,
        first: (power / (1.0 + power)).max(f64::MIN_POSITIVE),
        second: 0.5 / (b * (1.0 + x.cosh())),
    }
}

/// Converts a robust least-squares problem to a plain one (Triggs et al., "Bundle adjustment: a modern
/// synthesis", 2000, section 4.3): residual and Jacobian are scaled so that `Jᵀr` is the gradient of
/// `½ρ(‖r‖²)` and `JᵀJ` its Hessian where that is positive. Where `ρ″ ≤ 0` the second-order term is left out,
/// which keeps `JᵀJ` positive (the rule of Ceres).
pub(crate) struct Correction {
    residual_scale: f64,
    jacobian_scale: f64,
    outer_product_scale: f64,
}

impl Correction {
    pub fn new(loss: &LossValue, s: f64) -> Self {
        let root = loss.first.sqrt();
        if s == 0.0 || loss.second <= 0.0 {
            return Self { residual_scale: root, jacobian_scale: root, outer_product_scale: 0.0 };
        }
        let alpha = 1.0 - (1.0 + 2.0 * s * loss.second / loss.first).sqrt();
        Self { residual_scale: root / (1.0 - alpha), jacobian_scale: root, outer_product_scale: alpha / s }
    }

    /// Corrects a Jacobian (column by column), with the uncorrected residual.
    pub fn apply_to_jacobian(&self, residual: &[f64], jacobian: &mut [f64]) {
        for column in jacobian.chunks_exact_mut(residual.len().max(1)) {
            let mut along = 0.0;
            if self.outer_product_scale != 0.0 {
                along =
                    column.iter().zip(residual).map(|(j, r)| j * r).sum::<f64>() * self.outer_product_scale;
            }
            for (j, r) in column.iter_mut().zip(residual) {
                *j = self.jacobian_scale * (*j - along * r);
            }
        }
    }

    /// Corrects the residual. Call it after the Jacobians have been corrected.
    pub fn apply_to_residual(&self, residual: &mut [f64]) {
        residual.iter_mut().for_each(|r| *r *= self.residual_scale);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOSSES: [Loss; 7] = [
        Loss::None,
        Loss::Huber(1.3),
        Loss::Tolerant(2.0, 0.5),
        Loss::Cauchy(0.7),
        Loss::Tukey(2.2),
        Loss::GemanMcClure(1.1),
        Loss::Truncated(1.5),
    ];

    #[test]
    fn derivatives_are_those_of_the_value() {
        for loss in LOSSES {
            for s in [0.01, 0.3, 1.0, 2.0, 4.0, 10.0, 100.0] {
                let h = 1e-5 * s;
                let (below, above) = (loss.evaluate(s - h), loss.evaluate(s + h));
                let at = loss.evaluate(s);
                let first = (above.value - below.value) / (2.0 * h);
                let second = (above.first - below.first) / (2.0 * h);
                assert!((first - at.first).abs() < 1e-6, "{loss:?} at {s}: {first} {at:?}");
                assert!((second - at.second).abs() < 1e-5, "{loss:?} at {s}: {second} {at:?}");
            }
            assert_eq!(loss.evaluate(0.0).value, 0.0);
            assert!(loss.is_valid());
        }
        assert!(!Loss::Huber(0.0).is_valid() && !Loss::Cauchy(f64::NAN).is_valid());
    }

    #[test]
    fn corrected_normal_equations_have_the_robust_gradient() {
        let residual = [0.8, -1.1];
        let jacobian = [2.0, 0.3, -0.4, 1.5];
        for loss in LOSSES {
            let s: f64 = residual.iter().map(|r| r * r).sum();
            let value = loss.evaluate(s);
            let correction = Correction::new(&value, s);
            let (mut r, mut j) = (residual, jacobian);
            correction.apply_to_jacobian(&residual, &mut j);
            correction.apply_to_residual(&mut r);
            for column in 0..2 {
                let corrected = j[2 * column] * r[0] + j[2 * column + 1] * r[1];
                let plain = jacobian[2 * column] * residual[0] + jacobian[2 * column + 1] * residual[1];
                assert!((corrected - value.first * plain).abs() < 1e-12, "{loss:?}");
            }
        }
    }
}
