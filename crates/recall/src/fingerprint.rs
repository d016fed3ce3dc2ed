//! Fingerprint (64-bit hash) that identifies a question.

use crate::{Answer, Sink};

/// An odd constant whose bits look random: the golden ratio as a fraction of 2⁶⁴.
const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;

/// Hash of everything that an answer depends on. It is the same on every run of the same program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fingerprint(u64);

impl Fingerprint {
    /// Begins with a subject, so that questions asked at different places of the program differ.
    pub fn of(subject: &str) -> Self {
        let mut fingerprint = Self::default();
        fingerprint.add_text(subject);
        fingerprint
    }

    /// Adds a word. Each step is invertible, so that two inputs that differ in one word never collide, and mixes high
    /// bits into low ones.
    pub fn add_word(&mut self, word: u64) {
        let mixed = (self.0 ^ word).wrapping_add(1).wrapping_mul(FACTOR);
        self.0 = mixed ^ (mixed >> 29);
    }

    /// Adds a text.
    pub fn add_text(&mut self, text: &str) {
        self.add_bytes(text.as_bytes());
    }

    /// Adds bytes and their count.
    pub fn add_bytes(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        words.iter().for_each(|word| self.add_word(u64::from_le_bytes(*word)));
        self.add_word(rest.iter().fold(0, |word, byte| word << 8 | u64::from(*byte)));
        self.add_word(bytes.len() as u64);
    }

    /// Adds any value that implements [`Answer`].
    pub fn add<T: Answer>(&mut self, value: T) {
        value.write(self);
    }

    /// Adds numbers, two per word, and their count.
    pub fn add_f32s(&mut self, numbers: impl Iterator<Item = f32>) {
        let (mut count, mut half) = (0u64, 0u64);
        for number in numbers {
            count += 1;
            half = half << 32 | u64::from(number.to_bits());
            if count.is_multiple_of(2) {
                self.add_word(half);
                half = 0;
            }
        }
        self.add_word(half);
        self.add_word(count);
    }

    /// The hash.
    pub fn value(self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}

impl Sink for Fingerprint {
    fn put(&mut self, word: u64) {
        self.add_word(word);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(numbers: &[f32]) -> u64 {
        let mut fingerprint = Fingerprint::of("test");
        fingerprint.add_f32s(numbers.iter().copied());
        fingerprint.value()
    }

    #[test]
    fn signs_order_and_number_count() {
        let all = [
            of(&[1.0, 2.0, 3.0, 4.0]),
            of(&[-1.0, 2.0, 3.0, 4.0]),
            of(&[-1.0, 2.0, -3.0, 4.0]),
            of(&[1.0, 2.0, -3.0, 4.0]),
            of(&[2.0, 1.0, 3.0, 4.0]),
            of(&[1.0, 2.0, 3.0]),
            of(&[1.0, 2.0, 3.0, 0.0]),
            of(&[]),
            of(&[0.0]),
            of(&[-0.0]),
        ];
        let different: std::collections::BTreeSet<u64> = all.into_iter().collect();
        assert_eq!(different.len(), all.len());
        assert_ne!(Fingerprint::of("a").value(), Fingerprint::of("b").value());
    }
}
