//! The smooth step from 0 to 1 with vanishing first and second derivatives at both ends:
//! S(τ) = 6τ⁵ − 15τ⁴ + 10τ³.

/// Largest first derivative of the step, at its middle.
pub(crate) const STEEPEST: f64 = 1.875;
/// Largest second derivative of the step, 10/√3, at τ = ½ ∓ √3/6.
pub(crate) const MOST_CURVED: f64 = 5.773_502_691_896_258;

/// S(τ).
pub(crate) fn step(t: f64) -> f64 {
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// S′(τ).
pub(crate) fn slope(t: f64) -> f64 {
    let u = t * (1.0 - t);
    30.0 * u * u
}

/// S″(τ).
pub(crate) fn bend(t: f64) -> f64 {
    60.0 * t * (1.0 - t) * (1.0 - 2.0 * t)
}

/// ∫₀^τ S.
pub(crate) fn area(t: f64) -> f64 {
    t * t * t * t * (2.5 + t * (t - 3.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_and_integral_fit_together() {
        let h = 1e-5;
        for i in 1..100 {
            let t = f64::from(i) / 100.0;
            assert!(((step(t + h) - step(t - h)) / (2.0 * h) - slope(t)).abs() < 1e-8);
            assert!(((slope(t + h) - slope(t - h)) / (2.0 * h) - bend(t)).abs() < 1e-7);
            assert!(((area(t + h) - area(t - h)) / (2.0 * h) - step(t)).abs() < 1e-8);
            assert!(slope(t) <= STEEPEST && bend(t).abs() <= MOST_CURVED + 1e-12);
            assert!((step(t) + step(1.0 - t) - 1.0).abs() < 1e-14);
        }
        assert!((area(1.0) - 0.5).abs() < 1e-15 && (slope(0.5) - STEEPEST).abs() < 1e-15);
    }
}
