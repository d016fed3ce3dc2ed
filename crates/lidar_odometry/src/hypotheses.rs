//! Chooses among hypotheses of the motion, by one rule for all.
//!
//! Where the motion is unknown there are several hypotheses: of a single sweep (the prediction, the motion
//! if a sensor fails, and those that a correlation without prior proposes), of the first sweeps of a
//! trajectory, and of a gap. Sweeps are registered under each, and its score is their fit to the map. The
//! first hypothesis is the one with the highest prior probability. Another one is accepted only if it fits
//! clearly better, because along a tunnel all fit alike; among those that do, the best one is.

/// An alternative to the first hypothesis.
pub(crate) struct Other<H> {
    pub motion: H,
    /// Ratio by which its fit has to exceed that of the first hypothesis.
    pub clearly_better: f64,
}

/// The result of the accepted hypothesis. `first` is the result of the first hypothesis. `follow`
/// evaluates another one; it gives none if that does not fit better than the given limit, and may stop
/// early.
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

    /// Fit of the accepted hypothesis among these.
    fn chosen(first: f64, others: &[f64]) -> f64 {
        let others = others.iter().map(|fit| Other { motion: *fit, clearly_better: 1.1 });
        best(first, others, |fit| *fit, |fit, _| Some(fit))
    }

    #[test]
    fn the_first_hypothesis_is_kept_unless_another_is_clearly_better() {
        assert_eq!(chosen(1.0, &[1.05, 0.3]), 1.0);
        assert_eq!(chosen(1.0, &[1.2, 0.3]), 1.2);
        assert_eq!(chosen(0.0, &[0.0]), 0.0);
    }

    #[test]
    fn the_best_of_several_better_hypotheses_is_accepted() {
        assert_eq!(chosen(1.0, &[1.2, 1.25, 1.15]), 1.25);
    }

    #[test]
    fn hypotheses_are_tested_against_the_fit_that_they_need() {
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
