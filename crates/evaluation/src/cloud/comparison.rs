//! Whether one cloud is better than another: a paired test over places.
//!
//! Values at neighbouring points are not independent, so their standard error is too optimistic. Values are
//! therefore first averaged within places of some metres. The differences of all places are then tested
//! together: by resampling (bootstrap) and by random changes of their signs (permutation test), always with
//! the same seed.

use std::collections::BTreeMap;
use std::fmt;

use portolan_numeric::{SplitMix64, mean};

use serde::Serialize;

/// Number of bootstrap resamples and of permutations.
const DRAWS: usize = 4000;
/// Minimum number of values that a place needs in both clouds.
const LEAST_VALUES: u32 = 4;
/// Minimum number of places for a comparison.
const LEAST_PLACES: usize = 6;
/// Probability of chance below which a difference counts as significant.
const SIGNIFICANT: f64 = 0.01;

/// A value at a place, given by its cell.
pub type PlaceValue = ([i32; 3], f64);

/// A value before and after.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairedComparison {
    /// Name of the compared quantity.
    #[serde(rename = "what")]
    pub quantity: String,
    /// Number of places in both clouds.
    pub places: usize,
    /// Mean over the places before.
    pub before: f64,
    /// Mean over the places after.
    pub after: f64,
    /// Mean difference (after minus before).
    pub change: f64,
    /// Interval that contains 95 % of the resampled means.
    pub interval_95: [f64; 2],
    /// Fraction of places with a smaller value after than before, 0 to 1.
    pub places_less: f64,
    /// Probability of a difference as large by chance (two-sided).
    pub probability_of_chance: f64,
}

impl PairedComparison {
    /// −1 if the value decreased, 1 if it increased, 0 if the difference may be by chance.
    pub fn direction(&self) -> i32 {
        match self.probability_of_chance < SIGNIFICANT {
            true => self.change.signum() as i32,
            false => 0,
        }
    }
}

/// The cell of `edge` metres that contains a point.
pub fn place_of(point: [f64; 3], edge: f64) -> [i32; 3] {
    point.map(|v| (v / edge).floor().clamp(f64::from(i32::MIN), f64::from(i32::MAX)) as i32)
}

/// Compares values by place; `None` if too few places have enough values in both clouds.
pub fn compare_places(
    quantity: &str,
    before: &[PlaceValue],
    after: &[PlaceValue],
) -> Option<PairedComparison> {
    let (before, after) = (means(before), means(after));
    let pairs: Vec<(f64, f64)> =
        before.iter().filter_map(|(place, b)| Some((*b, *after.get(place)?))).collect();
    if pairs.len() < LEAST_PLACES {
        return None;
    }
    let differences: Vec<f64> = pairs.iter().map(|(b, a)| a - b).collect();
    let count = differences.len();
    let change = mean(&differences)?;
    let mut random = SplitMix64::new(0x5eed);
    let mut resampled: Vec<f64> = (0..DRAWS)
        .map(|_| (0..count).map(|_| differences[random.below(count)]).sum::<f64>() / count as f64)
        .collect();
    resampled.sort_by(f64::total_cmp);
    let flipped = |random: &mut SplitMix64| {
        differences.iter().map(|d| if random.bits() >> 63 == 0 { *d } else { -d }).sum::<f64>() / count as f64
    };
    let extreme = (0..DRAWS).filter(|_| flipped(&mut random).abs() >= change.abs() * (1.0 - 1e-12)).count();
    Some(PairedComparison {
        quantity: quantity.to_owned(),
        places: count,
        before: pairs.iter().map(|p| p.0).sum::<f64>() / count as f64,
        after: pairs.iter().map(|p| p.1).sum::<f64>() / count as f64,
        change,
        interval_95: [resampled[DRAWS * 25 / 1000], resampled[DRAWS * 975 / 1000 - 1]],
        places_less: differences.iter().filter(|d| **d < 0.0).count() as f64 / count as f64,
        probability_of_chance: (extreme + 1) as f64 / (DRAWS + 1) as f64,
    })
}

/// Means of places with enough values.
fn means(values: &[PlaceValue]) -> BTreeMap<[i32; 3], f64> {
    let mut sums: BTreeMap<[i32; 3], (f64, u32)> = BTreeMap::new();
    for (place, value) in values.iter().filter(|(_, value)| value.is_finite()) {
        let sum = sums.entry(*place).or_default();
        *sum = (sum.0 + value, sum.1 + 1);
    }
    let enough = sums.into_iter().filter(|(_, (_, count))| *count >= LEAST_VALUES);
    enough.map(|(place, (sum, count))| (place, sum / f64::from(count))).collect()
}

impl fmt::Display for PairedComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match self.direction() {
            -1 => "less",
            1 => "more",
            _ => "no difference beyond chance",
        };
        write!(
            f,
            "{}: {:.4} -> {:.4}, change {:+.4} (95 % between {:+.4} and {:+.4}), less at {:.0} % of {} places, p = {:.4}: {verdict}",
            self.quantity,
            self.before,
            self.after,
            self.change,
            self.interval_95[0],
            self.interval_95[1],
            100.0 * self.places_less,
            self.places,
            self.probability_of_chance
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(offset: f64, scatter: f64, seed: u64) -> Vec<PlaceValue> {
        let mut random = SplitMix64::new(seed);
        (0..400)
            .map(|i| {
                let noise = random.bits() as f64 / u64::MAX as f64 - 0.5;
                // The places differ much more than the clouds: the case for pairing.
                ([i / 10, 0, 0], f64::from(i / 10) + offset + scatter * noise)
            })
            .collect()
    }

    #[test]
    fn a_small_but_steady_change_is_seen() {
        let found = compare_places("entropy", &values(0.0, 0.2, 1), &values(-0.1, 0.2, 2)).unwrap();
        assert_eq!((found.places, found.direction()), (40, -1));
        assert!(found.interval_95[1] < 0.0 && (found.change + 0.1).abs() < 0.03, "{found}");
    }

    #[test]
    fn random_differences_are_not_reported_as_changes() {
        let real = (0..40)
            .filter(|i| {
                compare_places("x", &values(0.0, 1.0, 2 * i + 10), &values(0.0, 1.0, 2 * i + 11))
                    .unwrap()
                    .direction()
                    != 0
            })
            .count();
        assert!(real <= 2, "{real} of 40");
        let same = compare_places("x", &values(0.0, 1.0, 1), &values(0.0, 1.0, 1)).unwrap();
        assert!(same.change == 0.0 && same.probability_of_chance == 1.0);
    }

    #[test]
    fn too_few_places_are_not_judged() {
        assert!(compare_places("x", &values(0.0, 1.0, 1)[..50], &values(0.0, 1.0, 2)).is_none());
        assert!(compare_places("x", &[], &[]).is_none());
    }
}
