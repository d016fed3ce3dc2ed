//! Selects, once the whole recording is known, the scans whose localisation is trusted: what is added to a
//! map stays there.

use portolan_geometry::{Duration, Time};

use crate::settings::evidence::{
    LEAST_TRUSTED_METRES, MOST_TRUSTED_CONTRADICTED, MOST_TRUSTED_STEP, UNTRUSTED_BEFORE_LOSS,
    UNTRUSTED_BEFORE_UNCERTAIN,
};
use crate::state::{Estimate, Reason, State};

/// Why a run of localised scans ended.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    /// There was no sign that its end was wrong.
    Undisputed,
    /// Scans within this time before its end are not trusted, seconds.
    Untrusted(f64),
    /// The whole run is rejected.
    Refuted,
}

/// Time spans, in order, of trusted localised scans: those that no contradiction soon after calls into
/// question.
pub(crate) fn trusted_spans(estimates: &[Estimate]) -> Vec<(Time, Time)> {
    let is_localised = |e: &Estimate| e.state == State::Localised;
    let mut spans: Vec<(Time, Time)> = Vec::new();
    let mut rest = estimates;
    while let Some(first) = rest.iter().position(is_localised) {
        rest = rest.get(first..).unwrap_or_default();
        let steps = rest.iter().zip(rest.iter().skip(1));
        let length = 1 + steps.take_while(|(a, b)| is_localised(b) && !is_jump(a, b)).count();
        let (run, after) = rest.split_at(length.min(rest.len()));
        spans.extend(trusted(run, end_of(after)));
        rest = after;
    }
    spans
}

fn is_jump(a: &Estimate, b: &Estimate) -> bool {
    let (Some(before), Some(here)) = (a.place, b.place) else { return true };
    let in_map = before.map_from_tracking.inverse() * here.map_from_tracking;
    let in_local = a.local_from_tracking.inverse() * b.local_from_tracking;
    (in_map.translation.vector - in_local.translation.vector).norm() > MOST_TRUSTED_STEP
}

/// Reason why a run ended, from the scans after it.
fn end_of(after: &[Estimate]) -> End {
    let Some(first_after) = after.first() else { return End::Undisputed };
    let next = after.iter().find(|e| e.state != State::Uncertain).unwrap_or(first_after);
    match (next.state, next.reason) {
        (State::Lost, Reason::AnotherPlaceFitsBetter) => End::Refuted,
        (State::Lost, Reason::OutsideTheMap | Reason::PlaceHidden) => End::Undisputed,
        (State::Lost, _) => End::Untrusted(UNTRUSTED_BEFORE_LOSS),
        // The place jumped.
        _ if first_after.state == State::Localised => End::Untrusted(UNTRUSTED_BEFORE_LOSS),
        _ if matches!(first_after.reason, Reason::OutsideTheMap | Reason::PlaceHidden) => End::Undisputed,
        _ => End::Untrusted(UNTRUSTED_BEFORE_UNCERTAIN),
    }
}

/// The trusted part of a run of localised scans.
fn trusted(run: &[Estimate], end: End) -> Option<(Time, Time)> {
    let last = run.last()?.time;
    let kept: &[Estimate] = match end {
        End::Undisputed => run,
        End::Untrusted(seconds) => {
            let until = last - Duration::from_seconds(seconds);
            run.get(..run.partition_point(|e| e.time < until)).unwrap_or_default()
        }
        End::Refuted => &[],
    };
    let places = || kept.iter().filter_map(|e| e.place.as_ref());
    let positions = || places().map(|place| place.map_from_tracking.translation.vector);
    let travelled: f64 = positions().zip(positions().skip(1)).map(|(a, b)| (b - a).norm()).sum();
    let contradiction = places().map(|place| f64::from(place.agreement.contradiction())).sum::<f64>();
    let is_trusted = travelled >= LEAST_TRUSTED_METRES
        && contradiction <= MOST_TRUSTED_CONTRADICTED * places().count() as f64;
    is_trusted.then_some((kept.first()?.time, kept.last()?.time))
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Rigid3;
    use portolan_grids::ScanAgreement;

    use super::*;
    use crate::belief::Matrix6;
    use crate::state::Place;

    /// A second for each letter, half a metre a second: l localised, u uncertain, x lost, b lost to a better place, j localised
    /// two metres farther.
    fn estimates(states: &str) -> Vec<Estimate> {
        let mut shift = 0.0;
        let estimate = |(i, letter): (usize, char)| {
            let (state, reason) = match letter {
                'u' => (State::Uncertain, Reason::ScansContradict),
                'o' => (State::Uncertain, Reason::OutsideTheMap),
                'x' => (State::Lost, Reason::ScansContradict),
                'b' => (State::Lost, Reason::AnotherPlaceFitsBetter),
                _ => (State::Localised, Reason::ScansFit),
            };
            shift += if letter == 'j' { 2.0 } else { 0.0 };
            let local_from_tracking = Rigid3::translation(0.5 * i as f64, 0.0, 0.0);
            let place = Place {
                map_from_tracking: Rigid3::translation(0.5 * i as f64 + shift, 0.0, 0.0),
                covariance: Matrix6::zeros(),
                agreement: ScanAgreement { explained: 0.8, in_free_space: 0.05, through_solid: 0.05 },
            };
            let time = Time::from_ticks(0) + Duration::from_seconds(i as f64);
            Estimate { time, state, reason, local_from_tracking, place: Some(place) }
        };
        states.chars().enumerate().map(estimate).collect()
    }

    fn spans(states: &str) -> Vec<(f64, f64)> {
        let start = Time::from_ticks(0);
        let seconds = |(a, b): (Time, Time)| (a.seconds_since(start), b.seconds_since(start));
        trusted_spans(&estimates(states)).into_iter().map(seconds).collect()
    }

    #[test]
    fn scans_before_a_contradiction_are_not_trusted() {
        let run = "l".repeat(30);
        assert_eq!(spans(&run), [(0.0, 29.0)]);
        assert_eq!(spans(&format!("uu{run}o")), [(2.0, 31.0)]);
        assert_eq!(spans(&format!("{run}uu{run}")), [(0.0, 26.0), (32.0, 61.0)]);
        assert_eq!(spans(&format!("{run}{run}ux")), [(0.0, 38.0)]);
        assert_eq!(spans(&format!("{run}{run}b{run}")), [(61.0, 90.0)]);
        assert_eq!(spans(&format!("{run}j{run}")), [(30.0, 60.0)]);
        assert!(spans("llllllll").is_empty(), "too little way");
    }
}
