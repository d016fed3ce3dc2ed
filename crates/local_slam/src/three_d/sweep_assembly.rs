//! Assembles messages to sweeps.

use portolan_config::TrajectoryBuilder3dOptions;
use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_sensor::SynchronizedRanges;

use super::deskew::Gathered;
use crate::{MOST_GATHERED_POINTS, first_point_time};

/// Voxel size for down-sampling messages, as a fraction of that for sweeps.
const VOXEL_FRACTION: f32 = 0.5;
/// Fraction of the wanted duration that suffices for a sweep, since time stamps jitter.
const ENOUGH: f64 = 0.9;
/// Fraction of the wanted duration from which on a single message is a whole sweep, even if it begins
/// before the last one ended: revolutions differ, and time stamps more so.
const WHOLE: f64 = 0.75;

/// Assembles messages to sweeps.
pub(super) struct SweepAssembly {
    voxel_size: f32,
    messages: usize,
    /// Minimum duration of a sweep, approximately, seconds.
    min_duration: f64,
    /// Messages received since the last sweep.
    gathered: Vec<Gathered>,
    /// End time of the last sweep.
    since: Option<Time>,
}

impl SweepAssembly {
    pub fn new(options: &TrajectoryBuilder3dOptions, min_duration: f64) -> Self {
        Self {
            voxel_size: VOXEL_FRACTION * options.voxel_filter_size,
            messages: options.num_accumulated_range_data,
            min_duration,
            gathered: Vec::new(),
            since: None,
        }
    }

    /// Takes a message. Gives the messages of a sweep if it completes one.
    pub fn add(&mut self, ranges: &SynchronizedRanges, issues: &mut IssueLog) -> Option<Vec<Gathered>> {
        self.gathered.push(Gathered::new(ranges, self.voxel_size));
        let begin = *self.since.get_or_insert_with(|| first_point_time(ranges));
        let is_whole = ranges.time.seconds_since(first_point_time(ranges)) >= WHOLE * self.min_duration;
        let is_long_enough = is_whole || ranges.time.seconds_since(begin) >= ENOUGH * self.min_duration;
        if self.gathered.len() < self.messages || !is_long_enough {
            if self.gathered.iter().map(Gathered::len).sum::<usize>() < MOST_GATHERED_POINTS {
                return None;
            }
            issues.add(Issue::new(IssueKind::ScanCutShort).at(ranges.time));
        }
        self.since = Some(ranges.time);
        Some(std::mem::take(&mut self.gathered))
    }
}
