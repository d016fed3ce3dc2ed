//! Detects sensors that stop sending before the recording ends.

use std::collections::BTreeMap;

use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind};
use portolan_sensor::{SensorId, SensorKind};

/// Minimum duration of a silence, seconds.
const MIN_SILENCE: f64 = 2.0;
/// Minimum duration of a silence, as a multiple of the usual time between messages.
const MIN_PERIODS: f64 = 20.0;

/// Whether this time without messages, seconds, is a silence of a sensor that usually sends every `period`
/// seconds.
pub(crate) fn is_silence(seconds: f64, period: f64) -> bool {
    seconds > MIN_SILENCE && seconds > MIN_PERIODS * period
}

/// Times of the first and last message of each sensor.
#[derive(Debug, Default)]
pub(crate) struct Silences {
    activity: BTreeMap<SensorId, Activity>,
    end: Option<Time>,
}

#[derive(Debug)]
struct Activity {
    first: Time,
    last: Time,
    messages: u64,
}

impl Silences {
    pub fn add(&mut self, sensor: &SensorId, time: Time) {
        self.end = self.end.max(Some(time));
        match self.activity.get_mut(sensor) {
            Some(activity) => {
                activity.last = activity.last.max(time);
                activity.messages += 1;
            }
            None => {
                self.activity.insert(sensor.clone(), Activity { first: time, last: time, messages: 1 });
            }
        }
    }

    /// An issue for each sensor that was silent at the end. Satellite fixes and landmarks come irregularly
    /// and are left out.
    pub fn issues(&self) -> Vec<Issue> {
        let is_steady = |id: &SensorId| !matches!(id.kind, SensorKind::Landmark | SensorKind::FixedFramePose);
        let silence = |(id, activity): (&SensorId, &Activity)| {
            let end = self.end?;
            let silent = end.seconds_since(activity.last);
            let period = activity.last.seconds_since(activity.first) / activity.messages.max(1) as f64;
            let is_long = is_silence(silent, period);
            let issue = Issue::new(IssueKind::SensorSilent).of(id.id.clone());
            let issue = issue.with_number("seconds", format_args!("{silent:.1}")).between(activity.last, end);
            (is_long && is_steady(id)).then_some(issue)
        };
        self.activity.iter().filter_map(silence).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    #[test]
    fn only_persistently_silent_sensors_are_reported() {
        let sensor = |name: &str, kind| SensorId { id: name.into(), kind };
        let mut silences = Silences::default();
        for i in 0..600 {
            let time = Time::from_ticks(0) + Duration::from_seconds(0.1 * f64::from(i));
            silences.add(&sensor("left", SensorKind::Range), time);
            if i < 300 {
                silences.add(&sensor("right", SensorKind::Range), time);
                silences.add(&sensor("tags", SensorKind::Landmark), time);
            }
            if i % 250 == 0 {
                silences.add(&sensor("slow", SensorKind::Odometry), time);
            }
        }
        let issues = silences.issues();
        assert_eq!(issues.len(), 1, "{issues:?}");
        assert!(issues[0].to_string().starts_with("right: falls silent 30.0 s before"), "{issues:?}");
    }
}
