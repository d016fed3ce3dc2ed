//! Lossless serialisation of answers as 64-bit words.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Duration, Quaternion, Rigid2, Rigid3, Time, Vector3};

/// A value that can be serialised to 64-bit words and read back bit by bit.
pub trait Answer: Sized {
    /// Appends the value to `words`.
    fn write(&self, words: &mut impl Sink);

    /// Reads a value from the next words; none if they do not hold such a value.
    fn read(words: &mut Words<'_>) -> Option<Self>;
}

/// Consumer of words, one after the other.
pub trait Sink {
    /// Takes one word.
    fn put(&mut self, word: u64);
}

impl Sink for Vec<u64> {
    fn put(&mut self, word: u64) {
        self.push(word);
    }
}

/// Reader of words, one after the other.
pub struct Words<'a>(std::slice::Iter<'a, u64>);

impl<'a> Words<'a> {
    /// Begins at the first of these words.
    pub fn new(words: &'a [u64]) -> Self {
        Self(words.iter())
    }

    /// All remaining words as one value; none if words are left over or missing.
    pub fn whole<T: Answer>(mut self) -> Option<T> {
        let answer = T::read(&mut self)?;
        self.0.next().is_none().then_some(answer)
    }
}

impl Answer for u64 {
    fn write(&self, words: &mut impl Sink) {
        words.put(*self);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        words.0.next().copied()
    }
}

/// Implements [`Answer`] for types that are serialised as another type.
macro_rules! answers_as {
    ($($type:ty as $other:ty: $to:expr, $from:expr;)*) => {
        $(impl Answer for $type {
            fn write(&self, words: &mut impl Sink) {
                let to: fn(&$type) -> $other = $to;
                to(self).write(words);
            }

            fn read(words: &mut Words<'_>) -> Option<Self> {
                let from: fn($other) -> Option<$type> = $from;
                from(<$other>::read(words)?)
            }
        })*
    };
}

answers_as! {
    f64 as u64: |v| v.to_bits(), |bits| Some(Self::from_bits(bits));
    f32 as u64: |v| u64::from(v.to_bits()), |bits| u32::try_from(bits).ok().map(Self::from_bits);
    u32 as u64: |v| u64::from(*v), |v| Self::try_from(v).ok();
    bool as u64: |v| u64::from(*v), |v| (v < 2).then_some(v == 1);
    Time as u64: |v| v.ticks() as u64, |v| Some(Self::from_ticks(v as i64));
    Duration as u64: |v| v.ticks() as u64, |v| Some(Self::from_ticks(v as i64));
    Quaternion as [f64; 4]: |q| [q.i, q.j, q.k, q.w],
        |[i, j, k, w]| Some(Self::new_unchecked(na::Quaternion::new(w, i, j, k)));
    Rigid2 as [f64; 3]: |p| [p.translation.x, p.translation.y, p.angle], |[x, y, a]| Some(Self::new(x, y, a));
    Rigid3 as (Vector3, Quaternion): |p| (p.translation.vector, p.rotation),
        |(shift, rotation)| Some(Self::from_parts(shift.into(), rotation));
}

impl<A: Answer, B: Answer> Answer for (A, B) {
    fn write(&self, words: &mut impl Sink) {
        self.0.write(words);
        self.1.write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        Some((A::read(words)?, B::read(words)?))
    }
}

impl<T: Answer, const N: usize> Answer for [T; N] {
    fn write(&self, words: &mut impl Sink) {
        self.iter().for_each(|value| value.write(words));
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let values: Option<Vec<T>> = (0..N).map(|_| T::read(words)).collect();
        values?.try_into().ok()
    }
}

impl<T: Answer> Answer for Option<T> {
    fn write(&self, words: &mut impl Sink) {
        self.is_some().write(words);
        if let Some(value) = self {
            value.write(words);
        }
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        Some(if bool::read(words)? { Some(T::read(words)?) } else { None })
    }
}

impl<T: Answer> Answer for Vec<T> {
    fn write(&self, words: &mut impl Sink) {
        (self.len() as u64).write(words);
        self.iter().for_each(|value| value.write(words));
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let count = u64::read(words)?;
        // With a wrong length reading stops at the end of the words: nothing is allocated in advance.
        (0..count).map(|_| T::read(words)).collect()
    }
}

impl<const R: usize, const C: usize> Answer for na::SMatrix<f64, R, C> {
    fn write(&self, words: &mut impl Sink) {
        self.iter().for_each(|value| value.write(words));
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let mut matrix = Self::zeros();
        for value in matrix.iter_mut() {
            *value = f64::read(words)?;
        }
        Some(matrix)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn back<T: Answer>(value: &T) -> Option<T> {
        let mut words = Vec::new();
        value.write(&mut words);
        Words::new(&words).whole()
    }

    #[test]
    fn every_bit_round_trips() {
        let rotation = Quaternion::new_unchecked(na::Quaternion::new(-0.1, 0.2, -0.0, 0.974_68));
        let pose = Rigid3::from_parts(Vector3::new(-0.0, 1e-300, 7.0).into(), rotation);
        let read = back(&pose).unwrap();
        let bits = |pose: &Rigid3| {
            let q = pose.rotation;
            let t = pose.translation;
            [t.x, t.y, t.z, q.i, q.j, q.k, q.w].map(f64::to_bits)
        };
        assert_eq!(bits(&read), bits(&pose));
        assert!(back(&f64::NAN).unwrap().is_nan());
        let several = (vec![Some(1.5f32), None], ([true, false], (Time::from_ticks(-3), 7u32)));
        assert_eq!(back(&several), Some(several));
        assert_eq!(back(&na::Matrix2::new(1.0, 2.0, 3.0, 4.0)).unwrap().m12, 2.0);
    }

    #[test]
    fn words_of_other_types_are_refused() {
        assert_eq!(Words::new(&[2]).whole::<bool>(), None);
        assert_eq!(Words::new(&[u64::MAX, 1, 2]).whole::<Vec<f64>>(), None);
        assert_eq!(Words::new(&[1 << 40]).whole::<f32>(), None);
        assert_eq!(Words::new(&[1, 2]).whole::<u64>(), None);
        assert_eq!(Words::new(&[]).whole::<Rigid2>(), None);
    }
}
