//! 16-bit codes of cells and the bytes of textures (`formats.md §4.5, §4.7`).

use std::sync::LazyLock;

/// Smallest probability a cell can have.
pub const MIN_PROBABILITY: f32 = 0.1;
/// Largest probability a cell can have.
pub const MAX_PROBABILITY: f32 = 1.0 - MIN_PROBABILITY;
/// Smallest correspondence cost (one minus probability); 0.100000024 in single precision.
pub const MIN_CORRESPONDENCE_COST: f32 = 1.0 - MAX_PROBABILITY;
/// Largest correspondence cost.
pub const MAX_CORRESPONDENCE_COST: f32 = 1.0 - MIN_PROBABILITY;

/// The largest code. Code 0 means unknown; codes from 1 on cover the range of values.
pub const MAX_CODE: i32 = 32767;

/// The code of a cell without the update marker in its highest bit, which is only used by running programs
/// and has no meaning in files; none if the cell is not a 16-bit number.
pub fn without_marker(cell: i32) -> Option<usize> {
    u16::try_from(cell).ok().map(|c| usize::from(c & 0x7fff))
}

/// Linear mapping of the codes 1 to 32767 to the values between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CodeRange {
    scale: f32,
    offset: f32,
}

impl CodeRange {
    /// Code 1 is `low`, code 32767 is `high`.
    pub fn new(low: f32, high: f32) -> Self {
        let scale = (high - low) / 32766.0;
        Self { scale, offset: low - scale }
    }

    /// The value of a known cell.
    pub fn value(self, code: i32) -> f32 {
        code as f32 * self.scale + self.offset
    }
}

/// Bounds of the codes of a probability grid; the defaults if the file has none (both exactly 0).
pub fn correspondence_cost_bounds(min: f32, max: f32) -> (f32, f32) {
    if min == 0.0 && max == 0.0 { (MIN_CORRESPONDENCE_COST, MAX_CORRESPONDENCE_COST) } else { (min, max) }
}

/// Probability as a byte from 1 (0.1) over 128 (0.5) to 255 (0.9), linear in the log odds. Probabilities are
/// clamped to the bounds.
pub fn log_odds_byte(probability: f32) -> u8 {
    let logit = |p: f32| (p / (1.0 - p)).ln();
    let (low, high) = (logit(MIN_PROBABILITY), logit(MAX_PROBABILITY));
    let scaled = (logit(probability.clamp(MIN_PROBABILITY, MAX_PROBABILITY)) - low) * 254.0 / (high - low);
    // `as` saturates; NaN becomes 0.
    (scaled.round() as u8).saturating_add(1)
}

/// Texture pixel `(value, alpha)` from `delta`: positive values are free, negative ones occupied.
pub fn pixel(delta: i32) -> [u8; 2] {
    let value = delta.clamp(0, 255) as u8;
    let alpha = (-delta).clamp(0, 255) as u8;
    // Both 0 would mean unknown.
    if value == 0 && alpha == 0 { [0, 1] } else { [value, alpha] }
}

/// The texture pixel of a known cell with this probability.
pub fn probability_pixel(probability: f32) -> [u8; 2] {
    pixel(128 - i32::from(log_odds_byte(probability)))
}

/// Probability of each code of a hybrid grid (code 0 counts as 0.1).
pub static PROBABILITIES: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let range = CodeRange::new(MIN_PROBABILITY, MAX_PROBABILITY);
    (0..=MAX_CODE).map(|code| range.value(code.max(1))).collect()
});

/// Texture pixel of each code of a probability grid with these bounds of correspondence costs.
pub fn probability_grid_pixels(min_cost: f32, max_cost: f32) -> Vec<[u8; 2]> {
    let range = CodeRange::new(min_cost, max_cost);
    let known = (1..=MAX_CODE).map(|code| probability_pixel(1.0 - range.value(code)));
    std::iter::once([0, 0]).chain(known).collect()
}

#[cfg(test)]
// Golden values keep the digits that were printed.
#[allow(clippy::excessive_precision)]
mod tests {
    use super::*;

    #[test]
    fn golden_values_of_codes() {
        assert_eq!((MIN_PROBABILITY, MAX_PROBABILITY), (0.100000001, 0.899999976));
        assert_eq!((MIN_CORRESPONDENCE_COST, MAX_CORRESPONDENCE_COST), (0.100000024, 0.899999976));
        let bytes: Vec<u8> = PROBABILITIES.iter().flat_map(|p| p.to_le_bytes()).collect();
        assert_eq!(crc32fast::hash(&bytes), 0x2af6_d869);
        let costs = CodeRange::new(MIN_CORRESPONDENCE_COST, MAX_CORRESPONDENCE_COST);
        let costs = (1..=MAX_CODE).map(|code| costs.value(code));
        let bytes: Vec<u8> =
            std::iter::once(MAX_CORRESPONDENCE_COST).chain(costs).flat_map(f32::to_le_bytes).collect();
        assert_eq!(crc32fast::hash(&bytes), 0x1b89_72a3);
    }

    #[test]
    fn golden_values_of_log_odds() {
        let bytes: Vec<u8> = PROBABILITIES[1..].iter().map(|p| log_odds_byte(*p)).collect();
        assert_eq!(crc32fast::hash(&bytes), 0x04e8_7796);
        let samples = [0.1, 0.2, 0.3, 0.45, 0.5, 0.55, 0.7, 0.9].map(log_odds_byte);
        assert_eq!(samples, [1, 48, 79, 116, 128, 140, 177, 255]);
        assert_eq!([f32::NAN, -5.0, 7.0].map(log_odds_byte), [1, 1, 255]);
    }

    #[test]
    fn no_known_cell_looks_unknown() {
        assert_eq!([pixel(0), pixel(300), pixel(-300)], [[0, 1], [255, 0], [0, 255]]);
    }
}
