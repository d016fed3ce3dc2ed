//! Hypotheses of the motion, in one list with one rule.
//!
//! Where the motion is not known there are several: of a single sweep (the prediction, what holds if a sensor fails, what a
//! correlation with nothing known proposes), of the first sweeps of a trajectory, and of a gap. Each is followed, and the
//! score is how well the sweeps fit the map then. The first hypothesis is the most likely one before that. Another one is
//! taken only if it fits clearly better, because along a tunnel all fit alike; among those that do, the best one.

/// A hypothesis beside the first one.
pub(crate) struct Other<H> {
    pub motion: H,
    /// It has to fit so many times better than the first hypothesis.
    pub clearly_better: f64,
}

/// The hypothesis that counts, and what came of it. `first` was followed already; `follow` follows another one, and gives
/// nothing if that does not fit better than so much, which it may tell early.
pub(crate) fn best<H, F>(
    first: F,
    others: impl IntoIterator<Item = Other<H>>,
    fit: impl Fn(&F) -> f64,
    mut follow: impl FnMut(H, f64) -> Option<F>,
) -> F {
    let of_first = fit(&first);
    let mut best = first;
    for Other { motion, clearly_better } in others {
        let least = fit(&best).max(clearly_better * of_first);
        if let Some(other) = follow(motion, least).filter(|other| fit(other) > least) {
            best = other;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Which one counts of those that fit so well.
    fn chosen(first: f64, others: &[f64]) -> f64 {
        let others = others.iter().map(|fit| Other { motion: *fit, clearly_better: 1.1 });
        best(first, others, |fit| *fit, |fit, _| Some(fit))
    }

    #[test]
    fn the_first_one_stays_unless_another_is_clearly_better() {
        assert_eq!(chosen(1.0, &[1.05, 0.3]), 1.0);
        assert_eq!(chosen(1.0, &[1.2, 0.3]), 1.2);
        assert_eq!(chosen(0.0, &[0.0]), 0.0);
    }

    #[test]
    fn among_those_that_are_better_the_best_counts() {
        assert_eq!(chosen(1.0, &[1.2, 1.25, 1.15]), 1.25);
    }

    #[test]
    fn what_cannot_win_is_told_how_much_it_needs() {
        let mut needed = Vec::new();
        let others = [2.0, 1.0].map(|motion| Other { motion, clearly_better: 1.5 });
        best(
            1.0,
            others,
            |fit: &f64| *fit,
            |fit, least| {
                needed.push(least);
                (fit > least).then_some(fit)
            },
        );
        assert_eq!(needed, [1.5, 2.0]);
    }
}
