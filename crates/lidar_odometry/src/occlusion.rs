//! Detects occluded sweeps: a cover, spray, people close by.
//!
//! Unlike a grid, planes do not represent free space. But unexpected objects make beams shorter, never
//! longer (Thrun, Burgard, Fox: Probabilistic Robotics, 6.3): a sweep with a much shorter reach than those
//! before it that contradicts the map is left out.

use portolan_geometry::Time;
use portolan_sensor::{UsualReach, log_reach};

use crate::issues::Issues;
use crate::pose_status::PoseStatus;
use crate::settings::LossSettings;
use crate::sweep::Sweep;
use crate::tracker::Tracker;

/// Usual reach of sweeps, and the time since which they have been occluded.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Occlusion {
    usual: UsualReach,
    since: Option<Time>,
}

impl Occlusion {
    /// Whether the next sweep is occluded.
    pub fn hides(&mut self, sweep: &Sweep, tracker: &Tracker, settings: &LossSettings) -> bool {
        let Some(reach) = log_reach(sweep.points.iter().map(|point| &point.position)) else { return false };
        let is_short =
            self.usual.log_mean().is_some_and(|usual| reach < usual - settings.occluded_reach.ln());
        if !is_short || !contradicts_map(sweep, tracker) {
            self.since = None;
            self.usual.add(reach);
            return false;
        }
        // A longer occlusion may be the actual surroundings.
        let since = *self.since.get_or_insert(sweep.end);
        sweep.end.seconds_since(since) <= settings.longest_occlusion
    }
}

fn contradicts_map(sweep: &Sweep, tracker: &Tracker) -> bool {
    let registered = tracker.fork().register(None, sweep.clone(), None, &mut Issues::default());
    registered.status != PoseStatus::Confirmed
}
