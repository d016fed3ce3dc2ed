//! Describes when nothing constrained the pose of the scanner, for users.

use portolan_geometry::Time;
use portolan_mapping::Space;

use crate::pipeline::MappedRecording;

/// Maximum number of losses that are described one by one.
const NAMED: usize = 5;

impl<S: Space> MappedRecording<S> {
    /// Describes the losses of the pose; empty if there were none.
    pub fn losses_in_words(&self) -> String {
        let Some(start) = self.trajectory().first().map(|(time, _)| *time) else { return String::new() };
        let recorded = |time: Time| self.recorded_times.get(&time).copied().unwrap_or(time);
        let without_pose = self.scans_without_pose();
        let lines = self.losses.iter().zip(without_pose).take(NAMED).map(|(loss, without_pose)| {
            let outcome = if self.is_tied_by_odometry_alone(loss) {
                "the trajectory after it is placed by odometry alone, and no scan confirms it"
            } else if loss.piece.is_none() {
                "the trajectory ends there"
            } else if self.is_apart(loss) {
                "the trajectory after it is not connected to the rest of the map, so that the two overlap at an arbitrary relative pose"
            } else {
                "the trajectory after it was localised in the map again"
            };
            let [since, until] = [loss.since, loss.until].map(|t| recorded(t).seconds_since(start));
            let when = match until - since < 0.05 {
                true => format!("at {since:.1} s"),
                false => format!("from {since:.1} to {until:.1} s"),
            };
            let what = match loss.is_gap {
                true => format!("no usable scans {when}"),
                false => match without_pose {
                    0 => format!("lost {when}: scans no longer fit the map"),
                    n => format!(
                        "lost {when}: scans no longer fit the map, and {n} of them have no pose"
                    ),
                },
            };
            format!("{what}; {outcome}\n")
        });
        let mut text: String = lines.collect();
        if self.losses.len() > NAMED {
            let apart = self.losses.iter().filter(|loss| self.is_apart(loss)).count();
            text += &format!(
                "lost {} times in all, {apart} of them without a connection to the map before (see report.json)\n",
                self.losses.len()
            );
        }
        text
    }
}
