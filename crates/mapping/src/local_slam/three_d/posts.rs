//! What stands around, by the last sweeps, where nothing measures how the scanner goes.

use std::collections::VecDeque;

use portolan_geometry::{Point3f, Rigid3, Time, to_f32};
use portolan_lidar_odometry::{Going, PostMap, PostPoint, StraightPieces, SweptPoint, Way};

use super::first_sweeps::TimedSweep;

/// Seconds for which points are kept. With one second one of twelve walks among trees was 3.5 m off, with three one 4.3.
const KEPT: f64 = 2.0;

/// Points of what stood around in the last sweeps.
#[derive(Default)]
pub(super) struct RecentPosts(VecDeque<SweepOfPosts>);

struct SweepOfPosts {
    end: Time,
    local_from_tracking: Rigid3,
    /// As seen from the end of the sweep.
    points: Vec<Point3f>,
}

/// What stands in a sweep, and what stood in those before, in the frame of a submap.
pub(super) struct PostsToMatch {
    pub map: PostMap,
    pub points: Vec<PostPoint>,
}

impl PostsToMatch {
    pub fn seen_from_end(&self, to_end: &StraightPieces) -> Vec<Point3f> {
        self.points.iter().map(|p| to_end.moved(&p.swept.position, p.swept.offset)).collect()
    }
}

impl RecentPosts {
    /// What to match if nothing measures how a sweep goes or turns. With wheels it would help among trees, too, but in a
    /// bare tunnel, where some points of the walls seem to stand alone, it holds back what wheels tell rightly.
    pub fn to_match(
        &self,
        sweep: &TimedSweep,
        way: &Way,
        submap_from_local: &Rigid3,
    ) -> Option<PostsToMatch> {
        if way.going != Going::AsBefore || way.turn_is_measured {
            return None;
        }
        let swept = sweep.points.iter().map(|p| SweptPoint { offset: p.offset, position: p.position });
        let points = PostPoint::of_sweep(swept, &way.bent_to_end(&Default::default()), &way.end().rotation);
        let in_submap = self.0.iter().rev().flat_map(|sweep| {
            let there = to_f32(&(submap_from_local * sweep.local_from_tracking));
            sweep.points.iter().map(move |p| there * p)
        });
        Some(PostsToMatch { map: PostMap::new(in_submap), points })
    }

    /// Keeps those of a sweep that was matched, as seen from its end.
    pub fn add(&mut self, end: Time, local_from_tracking: Rigid3, points: Vec<Point3f>) {
        self.0.push_back(SweepOfPosts { end, local_from_tracking, points });
        while self.0.front().is_some_and(|first| end.seconds_since(first.end) > KEPT) {
            self.0.pop_front();
        }
    }
}
