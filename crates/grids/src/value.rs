//! 16-bit cell codes and the tables that update them.
//!
//! A code is linear between two bounds: 0 is unknown, 1…32767 span the bounds, bit 15 marks a cell that
//! the scan being inserted has already changed. All arithmetic is `f32` in the order written, since
//! files and other programs depend on every bit.

/// Code of an unknown cell.
pub const UNKNOWN_CELL: u16 = 0;
/// Set in cells that the current scan has changed; never in a finished grid or a file.
pub const UPDATE_MARKER: u16 = 1 << 15;
/// Number of codes without the marker.
pub const CODE_COUNT: usize = 1 << 15;

/// Smallest probability of a hybrid grid.
pub const MIN_PROBABILITY: f32 = 0.1;
/// Largest probability of a hybrid grid.
pub const MAX_PROBABILITY: f32 = 1.0 - MIN_PROBABILITY;
/// Smallest correspondence cost (one minus probability) of a 2D grid: 0.100000024.
pub const MIN_CORRESPONDENCE_COST: f32 = 1.0 - MAX_PROBABILITY;
/// Largest correspondence cost of a 2D grid.
pub const MAX_CORRESPONDENCE_COST: f32 = 1.0 - MIN_PROBABILITY;

/// Codes of probabilities, as hybrid grids store them.
pub const PROBABILITY_CODE: ValueCode = ValueCode::new(MIN_PROBABILITY, MAX_PROBABILITY);
/// Codes of correspondence costs, as 2D probability grids store them.
pub const CORRESPONDENCE_COST_CODE: ValueCode =
    ValueCode::new(MIN_CORRESPONDENCE_COST, MAX_CORRESPONDENCE_COST);

/// The linear code between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueCode {
    lower: f32,
    upper: f32,
    scale: f32,
    offset: f32,
    codes_per_unit: f32,
}

impl ValueCode {
    /// Codes for values between `lower` and `upper`, which must be finite and in this order.
    pub const fn new(lower: f32, upper: f32) -> Self {
        let scale = (upper - lower) / 32766.0;
        Self { lower, upper, scale, offset: lower - scale, codes_per_unit: 32766.0 / (upper - lower) }
    }

    /// The smallest value.
    pub const fn lower(&self) -> f32 {
        self.lower
    }

    /// The largest value.
    pub const fn upper(&self) -> f32 {
        self.upper
    }

    /// The code 1…32767 nearest to `value`, which is clamped to the bounds first. Not-a-number becomes
    /// the lower bound.
    pub fn encode(&self, value: f32) -> u16 {
        // `max` and `min` instead of `clamp`, because they map not-a-number to a bound.
        let clamped = value.max(self.lower).min(self.upper);
        ((clamped - self.lower) * self.codes_per_unit).round() as u16 + 1
    }

    /// The value of a code; `unknown` for code 0. The update marker is ignored.
    #[inline]
    pub fn decode(&self, code: u16, unknown: f32) -> f32 {
        let code = code & !UPDATE_MARKER;
        if code == UNKNOWN_CELL { unknown } else { f32::from(code) * self.scale + self.offset }
    }
}

/// The odds `p/(1−p)` of a probability.
pub fn odds(probability: f32) -> f32 {
    probability / (1.0 - probability)
}

/// The probability of odds, inverse of [`odds`].
pub fn probability_from_odds(odds: f32) -> f32 {
    odds / (odds + 1.0)
}

/// Update table: for every code the code after one observation, with the update marker set.
#[derive(Clone, Debug, PartialEq)]
pub struct UpdateTable(Box<[u16; CODE_COUNT]>);

impl UpdateTable {
    /// For 2D grids, whose cells hold correspondence costs: multiplies the odds of the probability
    /// by `odds`; an unknown cell takes the probability of `odds` itself.
    pub fn for_correspondence_costs(odds: f32) -> Self {
        Self::new(|code| {
            let updated = match code {
                UNKNOWN_CELL => odds,
                _ => odds * self::odds(1.0 - CORRESPONDENCE_COST_CODE.decode(code, 0.0)),
            };
            CORRESPONDENCE_COST_CODE.encode(1.0 - probability_from_odds(updated))
        })
    }

    /// For hybrid grids, whose cells hold probabilities.
    pub fn for_probabilities(odds: f32) -> Self {
        Self::new(|code| {
            let updated = match code {
                UNKNOWN_CELL => odds,
                _ => odds * self::odds(PROBABILITY_CODE.decode(code, 0.0)),
            };
            PROBABILITY_CODE.encode(probability_from_odds(updated))
        })
    }

    fn new(updated_code: impl Fn(u16) -> u16) -> Self {
        let mut table = Box::new([0; CODE_COUNT]);
        for (code, entry) in (0u16..).zip(table.iter_mut()) {
            *entry = updated_code(code) | UPDATE_MARKER;
        }
        Self(table)
    }

    /// The code after the observation, with the marker; a marker on `code` is ignored.
    #[inline]
    pub fn updated(&self, code: u16) -> u16 {
        self.0[usize::from(code & !UPDATE_MARKER)]
    }

    /// All entries in ascending order of the code they belong to.
    pub fn entries(&self) -> &[u16] {
        &self.0[..]
    }
}

/// The byte of a submap texture for a probability: log odds spread over 1…255 between the smallest and
/// the largest probability, to which it is clamped.
pub fn log_odds_byte(probability: f32) -> u8 {
    let log_odds = |p: f32| (p / (1.0 - p)).ln();
    let (lowest, highest) = (log_odds(MIN_PROBABILITY), log_odds(MAX_PROBABILITY));
    let clamped = probability.clamp(MIN_PROBABILITY, MAX_PROBABILITY);
    ((log_odds(clamped) - lowest) * 254.0 / (highest - lowest)).round() as u8 + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crc(bytes: impl Iterator<Item = u8>) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&bytes.collect::<Vec<u8>>());
        hasher.finalize()
    }

    #[test]
    fn decoded_values_equal_the_golden_tables() {
        let table = |code: ValueCode, unknown: f32| {
            crc((0..1u16 << 15).flat_map(move |v| code.decode(v, unknown).to_le_bytes()))
        };
        assert_eq!(table(PROBABILITY_CODE, MIN_PROBABILITY), 0x2af6_d869);
        assert_eq!(table(CORRESPONDENCE_COST_CODE, MAX_CORRESPONDENCE_COST), 0x1b89_72a3);
        assert_eq!(PROBABILITY_CODE.decode(100, 0.0), 0.102_417_14);
        assert_eq!(CORRESPONDENCE_COST_CODE.decode(16384, 0.0), 0.5);
    }

    #[test]
    fn update_tables_equal_the_golden_tables() {
        let check = |table: UpdateTable, expected: u32, first: u16| {
            assert_eq!(crc(table.entries().iter().flat_map(|v| v.to_le_bytes())), expected);
            assert_eq!(table.updated(UNKNOWN_CELL), first);
        };
        for (p, expected, first) in [
            (0.55, 0xa28c_efc2, 47104),
            (0.49, 0x12cd_91ca, 49562),
            (0.7, 0x2f57_5527, 40961),
            (0.4, 0x3aa3_b981, 53248),
        ] {
            check(UpdateTable::for_correspondence_costs(odds(p)), expected, first);
        }
        for (p, expected, first) in [
            (0.55, 0x8ddf_7c77, 51200),
            (0.49, 0x30a8_7922, 48742),
            (0.7, 0x9fa1_83a3, 57344),
            (0.4, 0xb799_efa8, 45056),
        ] {
            check(UpdateTable::for_probabilities(odds(p)), expected, first);
        }
    }

    #[test]
    fn texture_bytes_equal_the_golden_table() {
        let bytes = (1..1u16 << 15).map(|v| log_odds_byte(PROBABILITY_CODE.decode(v, 0.0)));
        assert_eq!(crc(bytes), 0x04e8_7796);
        for (p, expected) in [(0.1, 1), (0.2, 48), (0.3, 79), (0.5, 128), (0.7, 177), (0.9, 255)] {
            assert_eq!(log_odds_byte(p), expected, "{p}");
        }
    }

    #[test]
    fn codes_survive_decoding_and_encoding() {
        for code in [
            PROBABILITY_CODE,
            CORRESPONDENCE_COST_CODE,
            ValueCode::new(-0.1, 0.1),
            ValueCode::new(-0.3, 0.3),
            ValueCode::new(0.0, 10.0),
        ] {
            for v in 1..1u16 << 15 {
                assert_eq!(code.encode(code.decode(v, 0.0)), v);
                assert_eq!(code.encode(code.decode(v | UPDATE_MARKER, 0.0)), v);
            }
            assert_eq!((code.encode(-99.0), code.encode(99.0), code.encode(f32::NAN)), (1, 32767, 1));
        }
    }
}
