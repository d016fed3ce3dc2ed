//! Compares two places by the recent scans: counts the cells that only one of them explains.

use std::collections::BTreeMap;

use portolan_geometry::to_f32;
use portolan_grids::BeamEnd;

use crate::hypothesis::Hypothesis;
use crate::known_map::KnownMap;
use crate::recent::RecentScans;
use crate::settings::scans::{PAIRED_CELL, PAIRED_MAJORITY};

/// Number of cells of the recent scans that the map explains at one of two places and contradicts at the
/// other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Discordant {
    pub at_first: u32,
    pub at_second: u32,
}

impl Discordant {
    /// Compares two places.
    pub fn between<M: KnownMap>(
        map: &M,
        recent: &RecentScans<M::Scan>,
        [first, second]: [&Hypothesis; 2],
    ) -> Self {
        let mut cells: BTreeMap<[i32; 3], Cell> = BTreeMap::new();
        for ((kept, first), second) in recent.iter().rev().zip(first.found()).zip(second.found()) {
            let local_from_scan = to_f32(&kept.local_from_scan);
            let ends = map.beam_ends(&kept.scan, first).zip(map.beam_ends(&kept.scan, second));
            for ((point, at_first), (_, at_second)) in ends {
                let point = local_from_scan * point;
                let cell = [point.x, point.y, point.z].map(|v| (v / PAIRED_CELL).floor() as i32);
                cells.entry(cell).or_default().add(at_first, at_second);
            }
        }
        let count = |counts: fn(&Cell) -> bool| cells.values().filter(|cell| counts(cell)).count() as u32;
        Self { at_first: count(Cell::is_for_first), at_second: count(Cell::is_for_second) }
    }

    /// Evidence for the first place in standard deviations, under the hypothesis that both places are as
    /// likely to explain a cell (McNemar, "Note on the sampling error of the difference between correlated
    /// proportions or percentages", 1947).
    pub fn deviations(self) -> f64 {
        let [first, second] = [self.at_first, self.at_second].map(f64::from);
        (first - second) / (first + second).max(1.0).sqrt()
    }
}

/// Agreement of the points in a cell with the map at two places.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    points: u32,
    explained: [u32; 2],
    unknown: [u32; 2],
}

impl Cell {
    fn add(&mut self, at_first: BeamEnd, at_second: BeamEnd) {
        self.points += 1;
        for (place, end) in [at_first, at_second].into_iter().enumerate() {
            let counts = match end {
                BeamEnd::AtSolid => &mut self.explained,
                BeamEnd::Unknown => &mut self.unknown,
                BeamEnd::InFree | BeamEnd::BehindSolid => continue,
            };
            counts.iter_mut().skip(place).take(1).for_each(|count| *count += 1);
        }
    }

    fn is_for_first(&self) -> bool {
        let ([first, second], [_, unknown]) = (self.explained, self.unknown);
        self.is_most(first.saturating_sub(second)) && !self.is_most(unknown)
    }

    fn is_for_second(&self) -> bool {
        let ([first, second], [unknown, _]) = (self.explained, self.unknown);
        self.is_most(second.saturating_sub(first)) && !self.is_most(unknown)
    }

    fn is_most(&self, points: u32) -> bool {
        points as f32 > PAIRED_MAJORITY * self.points as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use BeamEnd::{AtSolid, InFree, Unknown};

    fn cell(points: &[(BeamEnd, BeamEnd)]) -> (bool, bool) {
        let mut cell = Cell::default();
        points.iter().for_each(|(first, second)| cell.add(*first, *second));
        (cell.is_for_first(), cell.is_for_second())
    }

    #[test]
    fn a_cell_counts_for_a_place_that_explains_it_if_the_map_contradicts_it_at_the_other() {
        assert_eq!(cell(&[(AtSolid, InFree); 3]), (true, false));
        assert_eq!(cell(&[(InFree, AtSolid), (InFree, AtSolid), (AtSolid, AtSolid)]), (false, true));
        assert_eq!(cell(&[(AtSolid, InFree), (AtSolid, AtSolid)]), (false, false), "half of it");
        assert_eq!(cell(&[(AtSolid, Unknown); 3]), (false, false), "of which nothing is known at the other");
    }

    #[test]
    fn cells_explained_by_both_places_do_not_count() {
        let deviations = |at_first, at_second| Discordant { at_first, at_second }.deviations();
        assert_eq!((deviations(0, 0), deviations(9, 0), deviations(0, 4)), (0.0, 3.0, -2.0));
        assert!((deviations(12, 4) - 2.0).abs() < 1e-12);
    }
}
