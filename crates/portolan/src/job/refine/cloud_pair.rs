//! Gives the positions of all points before and after a refinement.

use portolan_refinement::continuous::{BeforeAndAfter, DenseTrajectory, PoseMatrices, Refined};
use portolan_refinement::{PointStore, StoredPoint};
use portolan_spatial::spread_sample;
use rayon::prelude::*;

/// The points of a recording placed by the trajectory before and after refinement.
pub struct CloudPair<'a> {
    points: &'a [StoredPoint],
    /// Seconds from the start of the trajectory to that of the points.
    offset: f64,
    trajectory: &'a DenseTrajectory,
    gaps: &'a [[f64; 2]],
    clouds: BeforeAndAfter<'a>,
    after: PoseMatrices,
}

/// One point in both clouds.
#[derive(Clone, Copy)]
pub struct PairedPoint {
    /// Seconds since the start of the trajectory.
    pub seconds: f64,
    /// Position in the world before, metres.
    pub before: [f64; 3],
    /// Position in the world after, metres.
    pub after: [f64; 3],
    /// Height above the tracking frame at the time of the point, after, metres.
    pub above_tracking: f64,
}

impl<'a> CloudPair<'a> {
    pub fn new(store: &'a PointStore, refined: &'a Refined) -> Self {
        let trajectory = &refined.trajectory;
        Self {
            points: store.points(),
            offset: store.start().seconds_since(trajectory.start()),
            trajectory,
            gaps: &refined.report.gaps,
            clouds: BeforeAndAfter::new(store, refined),
            after: trajectory.matrices(),
        }
    }

    /// Time of a point, if the trajectory covers it.
    fn covered(&self, point: &StoredPoint) -> Option<f64> {
        let seconds = point.seconds() + self.offset;
        let is_covered = (0.0..=self.trajectory.duration()).contains(&seconds)
            && !self.gaps.iter().any(|[from, to]| (*from..*to).contains(&seconds));
        is_covered.then_some(seconds)
    }

    fn pair(&self, point: &StoredPoint) -> Option<PairedPoint> {
        let seconds = self.covered(point)?;
        let placed = self.clouds.place(point);
        let above_tracking = placed.after[2] - self.after.at(seconds)[11];
        Some(PairedPoint { seconds, before: placed.before, after: placed.after, above_tracking })
    }

    /// All covered points of the refined cloud in order of time: seconds since the start of the points, and
    /// position.
    pub fn refined(&self) -> impl Iterator<Item = (f64, [f64; 3])> + '_ {
        self.points.iter().filter_map(|point| {
            self.covered(point)?;
            Some((point.seconds(), self.clouds.place(point).after))
        })
    }

    /// Up to `count` points, spread evenly, in order of time.
    pub fn sample(&self, count: usize) -> Vec<PairedPoint> {
        let chosen = spread_sample(self.points.len(), count);
        let found: Vec<_> = chosen.par_iter().map(|i| self.pair(&self.points[*i as usize])).collect();
        found.into_iter().flatten().collect()
    }

    /// About `count` points at equal steps, in order of time.
    pub fn each(&self, count: usize) -> impl Iterator<Item = PairedPoint> + '_ {
        self.points.iter().step_by(self.stride(count)).filter_map(|point| self.pair(point))
    }

    fn stride(&self, count: usize) -> usize {
        self.points.len().div_ceil(count.max(1)).max(1)
    }

    /// Sums over about `count` points, one part on each thread; the result must not depend on the number of
    /// parts.
    pub fn sum<T: Send>(
        &self,
        count: usize,
        empty: impl Fn() -> T + Sync,
        add: impl Fn(&mut T, &PairedPoint) + Sync,
        merge: impl Fn(T, T) -> T + Sync,
    ) -> T {
        let stride = self.stride(count);
        let part = self.points.len().div_ceil(rayon::current_num_threads().max(1)).max(1);
        let parts = self.points.par_chunks(part.next_multiple_of(stride));
        let summed = parts.map(|points| {
            let mut sum = empty();
            points.iter().step_by(stride).filter_map(|p| self.pair(p)).for_each(|p| add(&mut sum, &p));
            sum
        });
        summed.reduce_with(&merge).unwrap_or_else(&empty)
    }
}
