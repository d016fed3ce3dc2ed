//! Chooses the source of the times of points in clouds.

use super::{Chosen, SensorPlan};
use crate::azimuth_time::{AzimuthTimes, Turn};
use crate::point_time::{PointTime, PointTimeOrigin};
use crate::skew::{Skew, SkewFactor, SkewState};
use crate::statistics::RangeStatistics;

/// Source of the times of points. Without a source all points have the time of the stamp.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointTimes {
    /// The time field of the clouds.
    pub recorded: Option<PointTime>,
    /// From the azimuth.
    pub by_azimuth: AzimuthTimes,
    pub turn: Option<Turn>,
}

impl PointTimes {
    const OF_STAMP: Self = Self { recorded: None, by_azimuth: AzimuthTimes::Off, turn: None };

    fn recorded(times: Option<PointTime>) -> Self {
        Self { recorded: times, ..Self::OF_STAMP }
    }
}

/// Options that change the choice.
const CHANGE: &str = "--point-times recorded, from-stamp, around-stamp, until-stamp or off";

/// Chooses the times of points. If the user asks for times by azimuth, recorded times are not used.
pub(super) fn times_of_points(
    chosen: &Chosen,
    is_cloud: bool,
    asked: AzimuthTimes,
    plan: &mut SensorPlan,
) -> PointTimes {
    let times = chosen.survey.point_time;
    let statistics = chosen.survey.range.clone().unwrap_or_default();
    let is_spinning = is_cloud && statistics.is_spinning();
    let turn = statistics.skew.filter(|s| is_spinning && s.is_turn_known()).map(|s| s.turn());
    match (asked, times) {
        (AzimuthTimes::Recorded, _) => PointTimes::recorded(times),
        (AzimuthTimes::Auto, Some(_)) => recorded_or_none(chosen, &statistics, times, plan),
        _ if !is_spinning => PointTimes::recorded(times),
        (AzimuthTimes::Auto, None) => by_azimuth_or_none(chosen, &statistics, turn, plan),
        (asked, _) => {
            if times.is_some() {
                let topic = chosen.topic();
                plan.note(format!("the times of the points of {topic} are not used, as asked for"), CHANGE);
            }
            PointTimes { by_azimuth: asked, turn, ..PointTimes::OF_STAMP }
        }
    }
}

/// Recorded times, unless the clouds are de-skewed.
fn recorded_or_none(
    chosen: &Chosen,
    statistics: &RangeStatistics,
    times: Option<PointTime>,
    plan: &mut SensorPlan,
) -> PointTimes {
    let Some(skew) = statistics.skew else { return PointTimes::recorded(times) };
    let topic = chosen.topic();
    if let Some(turn) = statistics.azimuth_turn {
        return by_azimuth_instead(chosen, statistics, turn, plan);
    }
    if let (Some(scale), Some(times)) = (statistics.time_scale, times)
        && (times.origin == PointTimeOrigin::Stamp || scale == 0.0)
    {
        let how = match scale {
            0.0 => "all points count as measured at the stamp".to_owned(),
            0.0.. => format!("they are taken to run {} times as fast", (100.0 * scale).round() / 100.0),
            _ => "they are taken to run backwards".to_owned(),
        };
        warn_of_times(chosen, statistics, &how, plan);
        return match scale {
            0.0 => PointTimes::OF_STAMP,
            _ => PointTimes::recorded(Some(PointTime { unit: scale * times.unit, ..times })),
        };
    }
    match skew.state() {
        SkewState::Raw | SkewState::Unknown => PointTimes::recorded(times),
        SkewState::Removed => {
            plan.note(
                format!(
                    "the points of {topic} have times, but they are de-skewed already ({}): the times are not \
                     used",
                    described(skew)
                ),
                CHANGE,
            );
            PointTimes::OF_STAMP
        }
        SkewState::Partial => {
            plan.note(
                format!(
                    "the times of the points of {topic} do not fit their motion ({}): are they right?",
                    described(skew)
                ),
                CHANGE,
            );
            if skew.is_mostly_raw() { PointTimes::recorded(times) } else { PointTimes::OF_STAMP }
        }
    }
}

/// Warns that recorded times are wrong, and reports which times are used.
fn warn_of_times(chosen: &Chosen, statistics: &RangeStatistics, how: &str, plan: &mut SensorPlan) {
    let caveat =
        if statistics.times_are_uncertain { "the best fit, though not a clear one, is that " } else { "" };
    let factors = statistics.skew.map_or_else(String::new, described);
    plan.warn(
        format!(
            "the times of the points of {} do not fit their motion ({factors}): {caveat}{how}",
            chosen.topic()
        ),
        CHANGE,
    );
}

/// Times by azimuth for the points of a spinning lidar whose recorded times belong to other points. The
/// position of the stamp within the turn still follows from the recorded times.
fn by_azimuth_instead(
    chosen: &Chosen,
    statistics: &RangeStatistics,
    turn: Turn,
    plan: &mut SensorPlan,
) -> PointTimes {
    let interval = 1.0 / statistics.rate;
    let seconds = turn.in_intervals * interval;
    let by_azimuth = (statistics.sweep_begin)
        .and_then(|begin| AzimuthTimes::of_begin(begin, seconds))
        .unwrap_or_else(|| AzimuthTimes::of_stamps(chosen.survey.lag, seconds));
    let how = format!(
        "they are taken from the azimuth: sweeps {}{}",
        by_azimuth.describe_stamp(),
        describe_rotation(turn, interval)
    );
    warn_of_times(chosen, statistics, &how, plan);
    PointTimes { by_azimuth, turn: Some(turn), ..PointTimes::OF_STAMP }
}

/// Describes the turns of a lidar whose clouds come every `interval` seconds.
fn describe_rotation(turn: Turn, interval: f64) -> String {
    let sense = if turn.is_clockwise { "clockwise" } else { "counter-clockwise" };
    let seconds = turn.in_intervals * interval;
    let missing = match turn.in_intervals < 1.0 {
        true => format!(", and take {seconds:.2} s of the {interval:.2} s between clouds"),
        false => String::new(),
    };
    format!(", go {sense} from azimuth {:.0}°{missing}", turn.begin_radians.to_degrees())
}

/// Times by azimuth for the points of a spinning lidar that have none, unless the clouds are de-skewed.
fn by_azimuth_or_none(
    chosen: &Chosen,
    statistics: &RangeStatistics,
    turn: Option<Turn>,
    plan: &mut SensorPlan,
) -> PointTimes {
    let topic = chosen.topic();
    // A field of equal times means that the points are of one instant, unless sweeps show otherwise.
    if chosen.survey.has_time_field && turn.is_none() {
        return PointTimes::OF_STAMP;
    }
    let lack = if chosen.survey.has_time_field { "times that are all alike" } else { "no times" };
    let state = statistics.skew.map_or(SkewState::Unknown, |skew| skew.state());
    let described = statistics
        .skew
        .filter(|_| state != SkewState::Unknown)
        .map_or_else(|| "whether they are de-skewed is not known".to_owned(), described);
    let is_removed = state == SkewState::Removed
        || (state == SkewState::Partial && statistics.skew.is_some_and(|skew| !skew.is_mostly_raw()));
    if is_removed {
        let how_much = if state == SkewState::Removed { "already" } else { "in part" };
        plan.note(
            format!("the points of {topic} have {lack}, and they are de-skewed {how_much} ({described})"),
            CHANGE,
        );
        return PointTimes::OF_STAMP;
    }
    // Points in order of beams may begin anywhere in the turn, and times counted from there distort more than
    // equal times. For a lidar that only stood still the skew is unknown: it gets times from the first point
    // on, which is right for most drivers.
    if turn.is_none() && !statistics.only_stood && !statistics.is_in_firing_order {
        plan.note(
            format!(
                "the points of {topic} have no times, and neither whether they are de-skewed nor where sweeps begin is \
                 known: all count as measured at the stamp"
            ),
            CHANGE,
        );
        return PointTimes::OF_STAMP;
    }
    let interval = 1.0 / statistics.rate;
    let seconds = turn.map_or(1.0, |turn| turn.in_intervals) * interval;
    let by_azimuth = AzimuthTimes::of_stamps(chosen.survey.lag, seconds);
    let when = by_azimuth.describe_stamp();
    let how = turn.map_or_else(String::new, |turn| describe_rotation(turn, interval));
    plan.note(
        format!(
            "the points of {topic} have {lack}; they get them from their azimuth: sweeps {when}{how} \
             ({described})"
        ),
        CHANGE,
    );
    PointTimes { by_azimuth, turn, ..PointTimes::OF_STAMP }
}

fn described(skew: Skew) -> String {
    let part = |part: SkewFactor| match part.sigma.is_finite() {
        true => format!("{:.2} (sigma {:.2})", part.factor, part.sigma),
        false => "unknown".to_owned(),
    };
    let (translation, rotation) = (part(skew.translation), part(skew.rotation));
    format!("skew factor of translation {translation}, of rotation {rotation}; 1 is raw, 0 de-skewed")
}
