//! Sweeps in which something hides the place: a cover, spray, people close by.
//!
//! Planes do not tell where nothing is, as a grid does. But unexpected things make beams shorter, never longer (Thrun, Burgard, Fox:
//! Probabilistic Robotics, 6.3): a sweep that sees much less far than those before it, and contradicts the map, is as good
//! as none.

use portolan_geometry::Time;
use portolan_sensor::{UsualReach, log_reach};

use crate::belief::PoseBelief;
use crate::issues::Issues;
use crate::settings::LossSettings;
use crate::sweep::Sweep;
use crate::tracker::Tracker;

/// How far sweeps usually see, and since when they have seen nothing of the place.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Occlusion {
    usual: UsualReach,
    since: Option<Time>,
}

impl Occlusion {
    /// Whether something hides the place from the sweep whose turn it is.
    pub fn hides(&mut self, sweep: &Sweep, tracker: &Tracker, settings: &LossSettings) -> bool {
        let Some(reach) = log_reach(sweep.points.iter().map(|point| &point.position)) else { return false };
        let is_short =
            self.usual.log_mean().is_some_and(|usual| reach < usual - settings.occluded_reach.ln());
        if !is_short || !contradicts_map(sweep, tracker) {
            self.since = None;
            self.usual.add(reach);
            return false;
        }
        // What hides the place for longer may be the place.
        let since = *self.since.get_or_insert(sweep.end);
        sweep.end.seconds_since(since) <= settings.longest_occlusion
    }
}

fn contradicts_map(sweep: &Sweep, tracker: &Tracker) -> bool {
    let registered = tracker.fork().register(None, sweep.clone(), None, &mut Issues::default());
    registered.belief != PoseBelief::Sure
}
