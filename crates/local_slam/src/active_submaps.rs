//! Active submaps (`slam2d.md` §11.1): scans are matched against the older one and inserted into both, so
//! that every place is in two submaps.

use std::sync::Arc;

use portolan_geometry::Point3f;
use portolan_issue::{IssueKind, IssueLog};
use portolan_submaps::GrowingSubmap;

use crate::{InsertionSubmap, LocalSlamSpace};

/// None, one or two submaps that are being filled, oldest first.
pub struct ActiveSubmaps<S: LocalSlamSpace> {
    submaps: Vec<ActiveSubmap<S>>,
    next_index: u32,
    scans_per_half: u32,
    /// Distance travelled after which a submap of sparse scans is half full, too, metres.
    distance_per_half: f64,
    last_origin: Option<Point3f>,
    refused: u64,
    without_submap: u64,
}

/// Mean distance between scans above which they are sparse, metres.
const SPARSE_STEP: f64 = 0.25;

/// A submap that is being filled.
struct ActiveSubmap<S: LocalSlamSpace> {
    index: u32,
    submap: S::Submap,
    /// Distance travelled since its first scan, metres.
    distance: f64,
}

impl<S: LocalSlamSpace> ActiveSubmap<S>
where
    S::Submap: GrowingSubmap,
{
    fn is_sparse(&self) -> bool {
        self.distance > SPARSE_STEP * f64::from(self.submap.num_range_data())
    }
}

impl<S: LocalSlamSpace> ActiveSubmaps<S>
where
    S::Submap: GrowingSubmap,
{
    /// Starts a new submap every `scans_per_half` scans; each receives twice as many.
    pub fn new(scans_per_half: u32) -> Self {
        Self {
            submaps: Vec::new(),
            next_index: 0,
            scans_per_half: scans_per_half.max(1),
            distance_per_half: f64::INFINITY,
            last_origin: None,
            refused: 0,
            without_submap: 0,
        }
    }

    /// Submaps of sparse scans are full after this distance travelled, too, metres; 0 counts only scans.
    #[must_use]
    pub fn with_length(self, metres: f64) -> Self {
        Self { distance_per_half: if metres > 0.0 { 0.5 * metres } else { f64::INFINITY }, ..self }
    }

    fn has_halves(&self, active: &ActiveSubmap<S>, halves: u32) -> bool {
        active.submap.num_range_data() >= halves * self.scans_per_half
            || active.is_sparse() && active.distance >= f64::from(halves) * self.distance_per_half
    }

    /// The submap to match against.
    pub fn matching_submap(&self) -> Option<&S::Submap> {
        self.submaps.first().map(|active| &active.submap)
    }

    /// The submap to match against, mutable.
    pub fn matching_submap_mut(&mut self) -> Option<&mut S::Submap> {
        self.submaps.first_mut().map(|active| &mut active.submap)
    }

    /// All of them, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &S::Submap)> {
        self.submaps.iter().map(|active| (active.index, &active.submap))
    }

    /// All of them, mutable, oldest first.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut S::Submap> {
        self.submaps.iter_mut().map(|active| &mut active.submap)
    }

    /// Inserts a scan. `create` makes a new submap at an origin in the local map, or none where that is
    /// impossible. Returns the submaps that the scan was inserted into, oldest first; a completed submap
    /// is returned with its grid and no longer active.
    pub fn insert(
        &mut self,
        scan: &<S::Submap as GrowingSubmap>::Scan,
        create: impl FnOnce(Point3f) -> Option<S::Submap>,
    ) -> Vec<InsertionSubmap<S>> {
        let origin = S::Submap::scan_origin_in_local(scan);
        let step = self.last_origin.replace(origin).map_or(0.0, |last| f64::from((origin - last).norm()));
        let newest_is_half_full = self.submaps.last().is_none_or(|newest| self.has_halves(newest, 1));
        if newest_is_half_full && let Some(submap) = create(origin) {
            self.submaps.push(ActiveSubmap { index: self.next_index, submap, distance: 0.0 });
            self.next_index += 1;
        }
        for active in &mut self.submaps {
            let step = if active.submap.num_range_data() > 0 { step } else { 0.0 };
            active.distance += step;
            self.refused += u64::from(!active.submap.insert(scan));
        }
        self.without_submap += u64::from(self.submaps.is_empty());
        let mut inserted: Vec<InsertionSubmap<S>> = self
            .submaps
            .iter()
            .map(|active| InsertionSubmap {
                index: active.index,
                local_from_submap: active.submap.local_from_submap(),
                finished: None,
            })
            .collect();
        // The next submap has to be half full before it is matched against.
        let oldest_is_full = self.submaps.len() > 1 || self.distance_per_half.is_infinite();
        if oldest_is_full
            && self.submaps.first().is_some_and(|oldest| self.has_halves(oldest, 2))
            && let Some(inserted_into_oldest) = inserted.first_mut()
        {
            let mut full = self.submaps.remove(0).submap;
            full.finish();
            inserted_into_oldest.finished = Some(Arc::new(full));
        }
        inserted
    }

    /// Adds the scans that could not be inserted to `issues`.
    pub fn count_into(&self, issues: &mut IssueLog) {
        issues.count(IssueKind::GridTooLarge, self.refused);
        issues.count(IssueKind::NoSubmapPossible, self.without_submap);
    }

    /// Ends the trajectory: finishes the active submaps and returns them.
    pub fn finish(&mut self) -> Vec<InsertionSubmap<S>> {
        std::mem::take(&mut self.submaps)
            .into_iter()
            .map(|ActiveSubmap { index, mut submap, .. }| {
                submap.finish();
                let local_from_submap = submap.local_from_submap();
                InsertionSubmap { index, local_from_submap, finished: Some(Arc::new(submap)) }
            })
            .collect()
    }
}
