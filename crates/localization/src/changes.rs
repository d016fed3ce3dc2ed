//! Finds where a recording contradicts the map: cells in which beams of localised scans end or pass contrary
//! to the map.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{NearFrame, Time, Vector2};
use portolan_grids::{CellIndex, MapLimits};

use crate::change_regions::{Region, regions};
use crate::known_cells::{Counts, Known, KnownCells};
use crate::placed_scan::{PlacedScan, around};
use crate::settings::changes::{CHANGING_FRACTION, CHANGING_SCANS, LEAST_CHANGED_AREA, VIEWPOINT_DISTANCE};

/// How a place has changed since the map was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ChangeKind {
    /// Scans end where the map was free.
    Appeared,
    /// Beams pass through what was solid.
    Gone,
}

impl ChangeKind {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Appeared => "appeared",
            Self::Gone => "gone",
        }
    }
}

/// Counts contradictions of localised scans.
pub trait ChangeCounter: Send {
    /// Takes a scan.
    fn add(&mut self, scan: &PlacedScan);
    /// Regions that have changed.
    fn changes(&self) -> Vec<Change>;
}

/// A region in which a recording contradicts the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// What changed.
    pub kind: ChangeKind,
    /// Its outline in the map, metres, counter-clockwise, and then its holes, clockwise; the first point is not repeated.
    pub rings: Vec<Vec<[f64; 2]>>,
    /// Area of the cells that changed, square metres; in 3D seen from above.
    pub area: f64,
    /// Lowest and highest point, metres in the map; none in 2D.
    pub heights: Option<[f64; 2]>,
    /// Times of the first and the last contradicting scan.
    pub seen: (Time, Time),
    /// Number of contradicting scans of the cell that has most.
    pub scans: u32,
}

impl Change {
    /// Converts a change from a frame near the map to the map.
    pub fn in_map(mut self, frame: &NearFrame) -> Self {
        let origin = frame.origin();
        for [x, y] in self.rings.iter_mut().flatten() {
            *x += origin.x;
            *y += origin.y;
        }
        self.heights.iter_mut().flatten().for_each(|height| *height += origin.z);
        self
    }
}

/// When and from where scans contradicted a cell.
#[derive(Clone, Copy, Debug)]
struct CellSightings {
    first: Time,
    last: Time,
    from: Vector2,
    is_seen_from_two: bool,
}

/// Counts contradictions of localised scans. Takes no more memory than the map.
pub struct ChangeGrid {
    map: KnownCells,
    /// Scans with a point in the cell, or beside it if it was solid, and scans with beams through it and no
    /// point in or beside it.
    hits: Counts,
    passes: Counts,
    /// Sightings of cells that were contradicted.
    sightings: BTreeMap<usize, CellSightings>,
}

impl ChangeGrid {
    /// Starts with no contradictions.
    pub(crate) fn new(map: KnownCells) -> Self {
        let cells = map.limits.num_cells();
        Self { map, hits: Counts::new(cells), passes: Counts::new(cells), sightings: BTreeMap::new() }
    }

    /// All cells of the changed regions.
    pub(crate) fn changed_cells(&self) -> ChangedCells {
        let of_kind = |kind| self.changed_regions(kind).into_iter().map(move |region| (kind, region));
        let all = of_kind(ChangeKind::Appeared).chain(of_kind(ChangeKind::Gone));
        let cells = all.flat_map(|(kind, region)| region.cells.into_iter().map(move |cell| (cell, kind)));
        ChangedCells { limits: self.map.limits, kinds: cells.collect() }
    }

    /// Changed regions that are large enough to be reported.
    fn changed_regions(&self, kind: ChangeKind) -> Vec<Region> {
        let changed = |cell: &usize| self.changed(*cell) == Some(kind);
        let cells: BTreeSet<usize> = self.sightings.keys().copied().filter(changed).collect();
        let edge = self.map.limits.resolution();
        let mut regions = regions(&cells, self.map.limits.num_x_cells() as usize);
        regions.retain(|region| region.cells.len() as f64 * edge * edge >= LEAST_CHANGED_AREA);
        regions
    }

    fn record_observation(&mut self, cell: usize, scan: &PlacedScan) {
        let new = CellSightings {
            first: scan.time,
            last: scan.time,
            from: scan.origin.xy(),
            is_seen_from_two: false,
        };
        let sightings = self.sightings.entry(cell).or_insert(new);
        sightings.last = scan.time;
        sightings.is_seen_from_two |= (scan.origin.xy() - sightings.from).norm() >= VIEWPOINT_DISTANCE;
    }

    /// Whether and how a cell has changed.
    fn changed(&self, cell: usize) -> Option<ChangeKind> {
        let sightings = self.sightings.get(&cell)?;
        let (hits, passes) = (self.hits.of(cell), self.passes.of(cell));
        let (kind, for_it) = match self.map.at(cell) {
            Known::Free => (ChangeKind::Appeared, hits),
            Known::Solid => (ChangeKind::Gone, passes),
            Known::Nothing => return None,
        };
        let all = f64::from(hits) + f64::from(passes);
        let is_clear = for_it >= u32::from(CHANGING_SCANS) && f64::from(for_it) >= CHANGING_FRACTION * all;
        (is_clear && sightings.is_seen_from_two).then_some(kind)
    }

    fn change(&self, kind: ChangeKind, region: &Region) -> Change {
        let edge = self.map.limits.resolution();
        let max = self.map.limits.max();
        // Columns run against y, rows against x: a mirror image.
        let corner = |[x, y]: &[i64; 2]| [max.x - *y as f64 * edge, max.y - *x as f64 * edge];
        let rings = region.rings.iter().map(|ring| ring.iter().rev().map(corner).collect()).collect();
        let seen = region.cells.iter().filter_map(|cell| self.sightings.get(cell));
        let (first, last) = (seen.clone().map(|w| w.first).min(), seen.map(|w| w.last).max());
        let count = |cell: &usize| match kind {
            ChangeKind::Appeared => self.hits.of(*cell),
            ChangeKind::Gone => self.passes.of(*cell),
        };
        let scans = region.cells.iter().map(count).max().unwrap_or(0);
        Change {
            kind,
            rings,
            area: region.cells.len() as f64 * edge * edge,
            heights: None,
            seen: (first.unwrap_or_default(), last.unwrap_or_default()),
            scans,
        }
    }
}

impl ChangeCounter for ChangeGrid {
    fn add(&mut self, scan: &PlacedScan) {
        let limits = &self.map.limits;
        let hit: BTreeSet<usize> = scan.ends(limits).collect();
        let passed: BTreeSet<usize> = scan.passed(limits).collect();
        let around = around(limits, &hit);
        let free_and_hit = |cell: &&usize| self.map.at(**cell) == Known::Free;
        let new: Vec<usize> = hit.iter().filter(free_and_hit).copied().collect();
        let gone: Vec<usize> =
            passed.iter().filter(|cell| self.map.at(**cell) == Known::Solid).copied().collect();
        let gone: Vec<usize> = gone.into_iter().filter(|cell| !around.contains(cell)).collect();
        hit.iter().for_each(|cell| self.hits.count(*cell));
        // A point beside a cell that was solid counts as a hit of this cell.
        for cell in around.iter().filter(|cell| !hit.contains(cell)) {
            if self.map.at(*cell) == Known::Solid {
                self.hits.count(*cell);
            }
        }
        for cell in passed.iter().filter(|cell| !around.contains(cell)) {
            self.passes.count(*cell);
        }
        for cell in new.into_iter().chain(gone) {
            self.record_observation(cell, scan);
        }
    }

    fn changes(&self) -> Vec<Change> {
        let of_kind = |kind| self.changed_regions(kind).into_iter().map(move |r| self.change(kind, &r));
        of_kind(ChangeKind::Appeared).chain(of_kind(ChangeKind::Gone)).collect()
    }
}

/// Cells of the map that have changed.
#[derive(Clone, Debug)]
pub(crate) struct ChangedCells {
    limits: MapLimits,
    kinds: BTreeMap<usize, ChangeKind>,
}

impl ChangedCells {
    /// The changed cell at a point of the map.
    pub(crate) fn at(&self, point: &Vector2) -> Option<usize> {
        let cell = self.limits.flat_index(self.limits.cell_index(point.cast::<f32>()))?;
        self.kinds.contains_key(&cell).then_some(cell)
    }

    /// Whether nothing has changed.
    pub(crate) fn is_empty(&self) -> bool {
        self.kinds.is_empty()
    }

    /// The cells within this distance, metres along each axis, of changed cells of the given kinds.
    pub(crate) fn around(&self, metres: f64, is_kind: impl Fn(ChangeKind) -> bool) -> CellSet {
        let reach = (metres / self.limits.resolution()).round() as i32;
        let columns = (self.limits.num_x_cells() as usize).max(1);
        let mut is_in = vec![false; self.limits.num_cells()];
        for (cell, _) in self.kinds.iter().filter(|(_, kind)| is_kind(**kind)) {
            let (x, y) = ((cell % columns) as i32, (cell / columns) as i32);
            let around = (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| (x + i, y + j)));
            for index in around.filter_map(|(x, y)| self.limits.flat_index(CellIndex::new(x, y))) {
                if let Some(is_in) = is_in.get_mut(index) {
                    *is_in = true;
                }
            }
        }
        CellSet { limits: self.limits, is_in }
    }

    /// Area of the changes of a kind, square metres.
    pub(crate) fn area(&self, kind: ChangeKind) -> f64 {
        let edge = self.limits.resolution();
        self.kinds.values().filter(|of_cell| **of_cell == kind).count() as f64 * edge * edge
    }
}

/// A set of cells.
#[derive(Clone, Debug)]
pub(crate) struct CellSet {
    limits: MapLimits,
    is_in: Vec<bool>,
}

impl CellSet {
    /// Whether the cell at a point of the map is in it.
    pub(crate) fn contains(&self, point: &Vector2) -> bool {
        let cell = self.limits.flat_index(self.limits.cell_index(point.cast::<f32>()));
        cell.and_then(|cell| self.is_in.get(cell)).is_some_and(|is_in| *is_in)
    }
}
