//! Search window around a guess.

use portolan_recall::{Answer, Sink, Words};

/// Metres and radians to either side of a guess.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchWindow {
    /// Along each axis, metres.
    pub linear: f64,
    /// Radians.
    pub angular: f64,
}

impl Answer for SearchWindow {
    fn write(&self, words: &mut impl Sink) {
        [self.linear, self.angular].write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let [linear, angular] = Answer::read(words)?;
        Some(Self { linear, angular })
    }
}
