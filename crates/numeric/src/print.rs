//! Formats numbers as C and C++ do.

/// `printf("%.{digits}g")`: `digits` significant digits, no trailing zeros, an exponent where that is
/// shorter. The default formatting of C++ streams is `digits` = 6.
pub fn format_general(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        let text = if value.is_nan() { "nan" } else { "inf" };
        return if value.is_sign_negative() { format!("-{text}") } else { text.to_owned() };
    }
    let digits = digits.max(1);
    let scientific = format!("{value:.*e}", digits - 1);
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if exponent < -4 || exponent >= digits as i32 {
        let sign = if exponent < 0 { '-' } else { '+' };
        return format!("{}e{sign}{:02}", without_zeros(mantissa), exponent.unsigned_abs());
    }
    let places = usize::try_from(digits as i32 - 1 - exponent).unwrap_or(0);
    without_zeros(&format!("{value:.places$}")).to_owned()
}

fn without_zeros(number: &str) -> &str {
    if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { number }
}

/// A count with its noun: `1 pose`, `2 poses`.
pub fn counted(count: u64, one: &str, several: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {several}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prints_like_printf() {
        for (value, text) in [
            (0.05, "0.05"),
            (0.05000000074505806, "0.05"),
            (-5.262940406799316, "-5.26294"),
            (0.0, "0"),
            (-0.0, "-0"),
            (100.0, "100"),
            (999999.5, "1e+06"),
            (123456.7, "123457"),
            (1234567.0, "1.23457e+06"),
            (0.0001, "0.0001"),
            (0.00001234, "1.234e-05"),
            (1e-300, "1e-300"),
            (f64::NEG_INFINITY, "-inf"),
        ] {
            assert_eq!(format_general(value, 6), text);
        }
        assert_eq!(format_general(0.1, 17), "0.10000000000000001");
        assert_eq!(format_general(f64::from(0.1_f32), 9), "0.100000001");
    }
}
