//! The key frame policy: which sweeps become key frames, and which only update the map.

use portolan_geometry::{Rigid3, Time};
use portolan_motion::MotionFilter;

use crate::settings::KeyframeSettings;
use crate::settings::constants::keyframes::{DOUBLINGS_AT_REST, MOST_DOUBLINGS};

/// Inputs of the decision about a sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate<'a> {
    pub time: Time,
    pub local_from_tracking: &'a Rigid3,
    pub is_standing: bool,
    /// Whether it becomes a key frame however little it moved.
    pub is_wanted: bool,
    /// Whether it may be left out while the platform stands.
    pub may_be_ignored: bool,
}

/// Decision about a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Decision {
    /// It is a key frame.
    KeyFrame,
    /// It only updates the map.
    MapOnly,
    /// It is redundant.
    Ignored,
}

/// Decides which sweeps are key frames.
#[derive(Clone, Debug)]
pub(crate) struct KeyframePolicy {
    settings: KeyframeSettings,
    filter: MotionFilter,
    last: Option<Time>,
    /// Number of key frames since the platform came to rest.
    standing: i32,
}

impl KeyframePolicy {
    pub fn new(settings: &KeyframeSettings) -> Self {
        let filter = MotionFilter::new(settings.max_time, settings.max_distance, settings.max_angle);
        Self { settings: settings.clone(), filter, last: None, standing: 0 }
    }

    /// Decides about a sweep; the first one is a key frame.
    pub fn decide(&mut self, candidate: &Candidate<'_>) -> Decision {
        let &Candidate { time, local_from_tracking, is_standing, is_wanted, may_be_ignored } = candidate;
        let is_ignored = is_standing && may_be_ignored && self.stood_lately(time);
        let is_keyframe = !is_ignored && (!self.filter.is_similar(time, local_from_tracking) || is_wanted);
        if is_keyframe {
            self.last = Some(time);
        }
        self.standing = if is_standing { self.standing + i32::from(is_keyframe) } else { 0 };
        match (is_keyframe, is_ignored) {
            (true, _) => Decision::KeyFrame,
            (false, false) => Decision::MapOnly,
            (false, true) => Decision::Ignored,
        }
    }

    /// Whether the last key frame is so recent that another one from the same position is redundant: the
    /// longer the platform stands, the longer this interval is.
    fn stood_lately(&self, time: Time) -> bool {
        let settings = &self.settings;
        let doublings = (DOUBLINGS_AT_REST + self.standing).min(MOST_DOUBLINGS);
        let interval = settings.max_time * 2_f64.powi(doublings);
        self.last.is_some_and(|last| time.seconds_since(last) < interval)
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Duration;

    use super::*;

    fn decisions(is_standing: bool, speed: f64) -> Vec<(i32, Decision)> {
        let mut policy = KeyframePolicy::new(&KeyframeSettings::default());
        let mut decide = |i: i32| {
            let t = 0.1 * f64::from(i);
            let candidate = Candidate {
                time: Time::from_ticks(0) + Duration::from_seconds(t),
                local_from_tracking: &Rigid3::translation(speed * t, 0.0, 0.0),
                is_standing,
                is_wanted: false,
                may_be_ignored: true,
            };
            (i, policy.decide(&candidate))
        };
        (0..250).map(&mut decide).collect()
    }

    fn keyframes(decisions: &[(i32, Decision)]) -> Vec<i32> {
        decisions.iter().filter(|(_, d)| *d == Decision::KeyFrame).map(|(i, _)| *i).collect()
    }

    #[test]
    fn key_frames_become_rarer_during_a_standstill() {
        let decisions = decisions(true, 0.0);
        let found = keyframes(&decisions);
        let seconds: Vec<f64> = found.windows(2).map(|w| 0.1 * f64::from(w[1] - w[0])).collect();
        assert!(seconds.windows(2).all(|w| w[1] > 1.5 * w[0]) && found.len() == 3, "{found:?}");
        assert!(decisions.contains(&(10, Decision::Ignored)));
    }

    #[test]
    fn motion_makes_key_frames() {
        let decisions = decisions(false, 0.6);
        assert!(keyframes(&decisions).starts_with(&[0, 2, 4]), "{decisions:?}");
        assert!(decisions.contains(&(1, Decision::MapOnly)));
    }
}
