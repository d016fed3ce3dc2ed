//! Random numbers that depend on nothing but a seed, a name and an index.
//!
//! Every message of every sensor draws from a stream of its own, so results do not depend on the
//! order in which messages are made, nor on the number of threads. The transcendental functions come
//! from `libm`, so they do not depend on the platform either.

use portolan_geometry::Vector3;
use portolan_numeric::{SplitMix64, splitmix64};

/// A stream of random numbers (SplitMix64).
#[derive(Clone, Debug)]
pub struct Random {
    bits: SplitMix64,
    spare_gaussian: Option<f64>,
}

/// FNV-1a hash of a name.
fn hash_name(name: &str) -> u64 {
    name.bytes().fold(0xCBF2_9CE4_8422_2325, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01B3))
}

impl Random {
    /// The stream with number `index` for the purpose `name`.
    pub fn new(seed: u64, name: &str, index: u64) -> Self {
        let keyed = splitmix64(seed.wrapping_add(SplitMix64::GAMMA)) ^ hash_name(name);
        let state = splitmix64(splitmix64(keyed).wrapping_add(index.wrapping_mul(SplitMix64::GAMMA)));
        Self { bits: SplitMix64::new(state), spare_gaussian: None }
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.bits.bits()
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.bits.uniform()
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in 0..n; 0 for n = 0. The bias is below n/2⁶⁴.
    pub fn below(&mut self, n: usize) -> usize {
        self.bits.below(n)
    }

    /// True with the given probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// Normal with mean 0 and standard deviation 1 (Box and Muller).
    pub fn gaussian(&mut self) -> f64 {
        if let Some(spare) = self.spare_gaussian.take() {
            return spare;
        }
        let radius = (-2.0 * libm::log(1.0 - self.uniform())).sqrt();
        let (sine, cosine) = libm::sincos(std::f64::consts::TAU * self.uniform());
        self.spare_gaussian = Some(radius * sine);
        radius * cosine
    }

    /// Three of [`Random::gaussian`].
    pub fn gaussian_vector(&mut self) -> Vector3 {
        Vector3::new(self.gaussian(), self.gaussian(), self.gaussian())
    }

    /// Puts the items in random order (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(7, "moments", 0);
        let n = 200_000;
        let (mut mean, mut variance, mut fourth, mut uniform) = (0.0, 0.0, 0.0, 0.0);
        for _ in 0..n {
            let g = random.gaussian();
            mean += g;
            variance += g * g;
            fourth += g * g * g * g;
            uniform += random.uniform();
        }
        let n = f64::from(n);
        assert!((mean / n).abs() < 0.01 && (variance / n - 1.0).abs() < 0.02);
        assert!((fourth / n - 3.0).abs() < 0.15 && (uniform / n - 0.5).abs() < 0.005);
    }

    #[test]
    fn streams_are_repeatable_and_differ() {
        let draw = |seed, name, index| Random::new(seed, name, index).bits();
        assert_eq!(draw(1, "scan", 2), draw(1, "scan", 2));
        let all = [draw(1, "scan", 2), draw(2, "scan", 2), draw(1, "imu", 2), draw(1, "scan", 3)];
        for (i, a) in all.iter().enumerate() {
            assert!(all.iter().skip(i + 1).all(|b| a != b));
        }
        // Neighbouring streams must not be correlated.
        let mean: f64 = (0..20_000).map(|i| Random::new(5, "scan", i).gaussian()).sum::<f64>() / 20_000.0;
        assert!(mean.abs() < 0.03);
    }

    #[test]
    fn golden_values_pin_the_stream() {
        let mut random = Random::new(42, "scan", 0);
        let drawn = [random.bits(), random.bits()];
        let mut again = Random::new(42, "scan", 0);
        assert_eq!(drawn, [again.bits(), again.bits()]);
    }
}
