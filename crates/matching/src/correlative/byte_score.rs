//! Scores in 8 bits.

/// Bytes 0 to 255 for scores between two bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ByteScore {
    lowest: f32,
    step: f32,
    bytes_per_unit: f32,
}

impl ByteScore {
    /// Byte 0 is `lowest`, byte 255 is `highest`.
    pub fn new(lowest: f32, highest: f32) -> Self {
        let range = highest - lowest;
        Self { lowest, step: range / 255.0, bytes_per_unit: 255.0 / range }
    }

    /// The byte nearest to a score.
    pub fn byte(&self, score: f32) -> u8 {
        ((score - self.lowest) * self.bytes_per_unit).round() as u8
    }

    /// The score for the mean of some bytes.
    #[inline]
    pub fn of(&self, byte_sum: u32, num_points: usize) -> f32 {
        self.lowest + byte_sum as f32 / num_points as f32 * self.step
    }
}
