//! Rounding for the cells of filters, grids and compressed clouds.

/// Nearest integer, halves away from zero (`lround` of `spec/slam2d.md`). Exact for every finite value
/// within `i64`; beyond it saturates, and NaN gives zero.
#[inline]
pub fn lround(value: f32) -> i64 {
    let truncated = value as i64;
    // Exact: below 2^23 the difference has few bits, above there is no fraction.
    let fraction = value - truncated as f32;
    truncated.saturating_add(i64::from(fraction >= 0.5)).saturating_sub(i64::from(fraction <= -0.5))
}

/// [`lround`] of numbers of magnitude below 2^22; the result for others is arbitrary. Rust's own conversions,
/// which saturate numbers beyond the integers, are not compiled into vector instructions; this is.
#[inline]
pub fn lround_small(value: f32) -> i32 {
    // From this value to twice it, the single-precision numbers are exactly the integers, numbered by their
    // low bits.
    const WHOLE: f32 = (1 << 23) as f32;
    let size = value.abs();
    let to_even = size + WHOLE - WHOLE;
    let nearest = to_even + if size - to_even == 0.5 { 1.0 } else { 0.0 };
    let whole = (nearest + WHOLE).to_bits().wrapping_sub(WHOLE.to_bits()) as i32;
    let sign = value.to_bits() as i32 >> 31;
    (whole ^ sign).wrapping_sub(sign)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn halves_are_rounded_away_from_zero() {
        let cases = [
            (0.5, 1),
            (-0.5, -1),
            (1.5, 2),
            (2.5, 3),
            (-2.5, -3),
            (0.499_999_97, 0),
            (8_388_607.5, 8_388_608),
        ];
        for (value, expected) in cases {
            assert_eq!(lround(value), expected, "{value}");
            if expected < 1 << 22 {
                assert_eq!(i64::from(lround_small(value)), expected, "{value}");
            }
        }
        assert_eq!((lround(f32::NAN), lround(f32::INFINITY)), (0, i64::MAX));
    }

    proptest! {
        #[test]
        fn agrees_with_the_standard_library(bits in any::<u32>()) {
            let value = f32::from_bits(bits);
            prop_assume!(value.abs() < 9.0e18);
            prop_assert_eq!(lround(value), value.round() as i64);
            if value.abs() < 4_194_304.0 {
                prop_assert_eq!(i64::from(lround_small(value)), lround(value));
            }
        }
    }
}
