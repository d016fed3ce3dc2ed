//! Time as a count of 100 ns ticks since 0001-01-01T00:00:00 UTC (the "Universal Time Scale").

use std::fmt;
use std::ops::{Add, AddAssign, Sub, SubAssign};

const TICKS_PER_SECOND: i64 = 10_000_000;
/// Seconds between 0001-01-01 and 1970-01-01.
const UNIX_EPOCH_SECONDS: i64 = 62_135_596_800;
const UNIX_EPOCH_TICKS: i64 = UNIX_EPOCH_SECONDS * TICKS_PER_SECOND;

/// A point in time, in 100 ns ticks since 0001-01-01 UTC. All arithmetic saturates, because time stamps come
/// from untrusted input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(i64);

/// A signed span of time, in 100 ns ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Duration(i64);

impl Time {
    /// Earlier than every other time.
    pub const MIN: Self = Self(i64::MIN);
    /// Later than every other time.
    pub const MAX: Self = Self(i64::MAX);
    /// 1970-01-01T00:00:00 UTC.
    pub const UNIX_EPOCH: Self = Self(UNIX_EPOCH_TICKS);

    /// From ticks as stored in files.
    pub const fn from_ticks(ticks: i64) -> Self {
        Self(ticks)
    }

    /// Ticks as stored in files.
    pub const fn ticks(self) -> i64 {
        self.0
    }

    /// From a ROS stamp; rounded to the nearest 100 ns.
    pub const fn from_ros(seconds: i64, nanoseconds: u32) -> Self {
        Self(
            seconds
                .saturating_add(UNIX_EPOCH_SECONDS)
                .saturating_mul(TICKS_PER_SECOND)
                .saturating_add((nanoseconds as i64 + 50) / 100),
        )
    }

    /// From nanoseconds since the Unix epoch; rounded to the nearest 100 ns.
    pub const fn from_unix_nanoseconds(nanoseconds: i64) -> Self {
        Self::from_ros(nanoseconds.div_euclid(1_000_000_000), nanoseconds.rem_euclid(1_000_000_000) as u32)
    }

    /// From seconds since the Unix epoch; rounded to the nearest 100 ns. Present dates need more digits
    /// than an `f64` has: use [`Time::from_unix_decimal`] for text. NaN gives the epoch.
    pub fn from_unix_seconds(seconds: f64) -> Self {
        // The integer part is split off first: 1e9 s in ticks needs 54 bits, one more than f64 has.
        let whole = seconds.floor();
        let ticks = ((seconds - whole) * TICKS_PER_SECOND as f64).round() as i64;
        Self((whole as i64).saturating_add(UNIX_EPOCH_SECONDS).saturating_mul(TICKS_PER_SECOND))
            + Duration(ticks)
    }

    /// From decimal text such as `1000000070.179699`, exact to 100 ns (further digits are rounded).
    /// Text with an exponent, or not a number, is left to [`str::parse`]; `None` if that fails too.
    pub fn from_unix_decimal(text: &str) -> Option<Self> {
        let (negative, digits) = match text.strip_prefix('-') {
            Some(rest) => (true, rest),
            None => (false, text.strip_prefix('+').unwrap_or(text)),
        };
        let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
        let plain = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
        if !plain(whole) || !plain(fraction) || (whole.is_empty() && fraction.is_empty()) {
            let seconds: f64 = text.parse().ok()?;
            return seconds.is_finite().then(|| Self::from_unix_seconds(seconds));
        }
        let whole: i64 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
        let mut ticks = 0;
        for i in 0..7 {
            ticks = ticks * 10 + i64::from(fraction.as_bytes().get(i).map_or(0, |b| b - b'0'));
        }
        ticks += i64::from(fraction.as_bytes().get(7).is_some_and(|b| *b >= b'5'));
        let span = Duration(whole.saturating_mul(TICKS_PER_SECOND).saturating_add(ticks));
        Some(if negative { Self::UNIX_EPOCH - span } else { Self::UNIX_EPOCH + span })
    }

    /// Nanoseconds since the Unix epoch.
    pub const fn unix_nanoseconds(self) -> i64 {
        self.0.saturating_sub(UNIX_EPOCH_TICKS).saturating_mul(100)
    }

    /// Seconds since the Unix epoch (about 0.1 µs of resolution for present dates).
    pub fn unix_seconds(self) -> f64 {
        self.0.saturating_sub(UNIX_EPOCH_TICKS) as f64 / TICKS_PER_SECOND as f64
    }

    /// The ROS stamp `(sec, nsec)`.
    pub const fn to_ros(self) -> (i64, u32) {
        let ticks = self.0.saturating_sub(UNIX_EPOCH_TICKS);
        (ticks.div_euclid(TICKS_PER_SECOND), (ticks.rem_euclid(TICKS_PER_SECOND) * 100) as u32)
    }

    /// Seconds since the Unix epoch as decimal text with seven places: exact, unlike an `f64`.
    pub fn unix_decimal(self) -> String {
        let ticks = self.0.saturating_sub(UNIX_EPOCH_TICKS);
        let sign = if ticks < 0 { "-" } else { "" };
        let ticks = ticks.unsigned_abs();
        let per_second = TICKS_PER_SECOND.unsigned_abs();
        format!("{sign}{}.{:07}", ticks / per_second, ticks % per_second)
    }

    /// Seconds from `earlier` to this time.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self - earlier).seconds()
    }
}

impl Duration {
    /// Zero.
    pub const ZERO: Self = Self(0);

    /// From ticks of 100 ns.
    pub const fn from_ticks(ticks: i64) -> Self {
        Self(ticks)
    }

    /// From seconds; truncated toward zero to 100 ns, as the pbstream format does. NaN gives zero.
    pub fn from_seconds(seconds: f64) -> Self {
        Self((seconds * TICKS_PER_SECOND as f64) as i64)
    }

    /// Ticks of 100 ns.
    pub const fn ticks(self) -> i64 {
        self.0
    }

    /// In seconds.
    pub fn seconds(self) -> f64 {
        self.0 as f64 / TICKS_PER_SECOND as f64
    }
}

impl fmt::Display for Time {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.4}", self.unix_seconds())
    }
}

impl Add<Duration> for Time {
    type Output = Self;
    fn add(self, rhs: Duration) -> Self {
        Self(self.0.saturating_add(rhs.0))
    }
}

impl AddAssign<Duration> for Time {
    fn add_assign(&mut self, rhs: Duration) {
        *self = *self + rhs;
    }
}

impl Sub<Duration> for Time {
    type Output = Self;
    fn sub(self, rhs: Duration) -> Self {
        Self(self.0.saturating_sub(rhs.0))
    }
}

impl SubAssign<Duration> for Time {
    fn sub_assign(&mut self, rhs: Duration) {
        *self = *self - rhs;
    }
}

impl Sub for Time {
    type Output = Duration;
    fn sub(self, rhs: Self) -> Duration {
        Duration(self.0.saturating_sub(rhs.0))
    }
}

impl Add for Duration {
    type Output = Self;
    fn add(self, rhs: Self) -> Self {
        Self(self.0.saturating_add(rhs.0))
    }
}

impl Sub for Duration {
    type Output = Self;
    fn sub(self, rhs: Self) -> Self {
        Self(self.0.saturating_sub(rhs.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ros_stamps_round_to_ticks_and_back() {
        let time = Time::from_ros(1_000_000_070, 179_699_051);
        assert_eq!(time.ticks(), (1_000_000_070 + UNIX_EPOCH_SECONDS) * TICKS_PER_SECOND + 1_796_991);
        assert_eq!(time.to_ros(), (1_000_000_070, 179_699_100));
        assert_eq!(time.unix_decimal(), "1000000070.1796991");
    }

    #[test]
    fn decimal_seconds_keep_their_digits() {
        let exact = Time::from_unix_decimal("1000000070.179699").unwrap();
        assert_eq!(exact.unix_decimal(), "1000000070.1796990");
        assert_eq!(Time::from_unix_decimal("-.25").unwrap().unix_decimal(), "-0.2500000");
        assert_eq!(Time::from_unix_decimal("1.5e3").unwrap().unix_decimal(), "1500.0000000");
        assert!(Time::from_unix_decimal("nan").is_none() && Time::from_unix_decimal("").is_none());
        assert_eq!(Time::from_unix_seconds(-0.25).unix_decimal(), "-0.2500000");
    }

    #[test]
    fn absurd_stamps_saturate() {
        assert_eq!(Time::from_unix_seconds(f64::INFINITY), Time::MAX);
        assert_eq!(Time::MAX + Duration::from_seconds(1.0), Time::MAX);
        assert_eq!(Time::MIN - Duration::from_seconds(1.0), Time::MIN);
        let _ = Time::MAX - Time::MIN;
        let _ = Time::MIN.to_ros();
    }
}
