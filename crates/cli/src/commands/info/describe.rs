//! Formats times, sizes and durations for the user.

use portolan_geometry::Time;

/// Date and time of day, UTC, to the second: `2023-11-14 22:13:20`.
pub fn utc(time: Time) -> String {
    let [year, month, day, hour, minute, second] = utc_parts(time.unix_seconds().floor() as i64);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02}")
}

/// Year, month, day, hour, minute and second, UTC, of Unix seconds.
pub fn utc_parts(seconds: i64) -> [i64; 6] {
    let (day, second) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    let (year, month, day) = civil(day);
    [year, month, day, second / 3600, second / 60 % 60, second % 60]
}

/// Year, month and day of a number of days since 1970-01-01 in the Gregorian calendar, by eras of 400 years
/// that begin in March.
fn civil(days: i64) -> (i64, i64, i64) {
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted.div_euclid(146_097), shifted.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * march_month + 2) / 5 + 1;
    let month = if march_month < 10 { march_month + 3 } else { march_month - 9 };
    (era * 400 + year_of_era + i64::from(month <= 2), month, day)
}

/// Size with unit, as `12.3 MB`.
pub fn size(bytes: u64) -> String {
    match bytes {
        0..1000 => format!("{bytes} bytes"),
        1000..1_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..1_000_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.2} GB", bytes as f64 / 1e9),
    }
}

/// Duration with units, as `83.2 s`, `12 min 5 s`, `3 h 4 min`.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.1} s"),
        s if s < 7200.0 => format!("{} min {:.0} s", (s / 60.0) as u64, (s % 60.0).floor()),
        s => format!("{} h {} min", (s / 3600.0) as u64, (s % 3600.0 / 60.0) as u64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        assert_eq!(utc(Time::from_unix_seconds(0.0)), "1970-01-01 00:00:00");
        assert_eq!(utc(Time::from_unix_seconds(1_700_000_000.0)), "2023-11-14 22:13:20");
        assert_eq!(utc(Time::from_unix_seconds(951_782_399.0)), "2000-02-28 23:59:59");
        assert_eq!(utc(Time::from_unix_seconds(951_782_400.0)), "2000-02-29 00:00:00");
        assert_eq!(utc(Time::from_unix_seconds(-1.0)), "1969-12-31 23:59:59");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([size(999), size(12_345), size(5_100_000)], ["999 bytes", "12.3 kB", "5.1 MB"]);
        assert_eq!([duration(83.24), duration(725.0)], ["83.2 s", "12 min 5 s"]);
    }
}
