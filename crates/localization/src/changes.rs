//! Where a recording contradicts the map: cells in which scans of known places end or pass otherwise than the map says.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Point3f, Rigid2, Time, Vector2};
use portolan_matching::{CellIndex, GridError, MapLimits, ProbabilityGrid};

use crate::change_regions::{Region, regions};
use crate::likelihood::LikelihoodField;

/// Edge of the cells in which contradictions are counted, metres.
const CELL: f64 = 0.1;
/// Cells of the map of these probabilities are solid and free, as for the agreement of scans.
const SOLID: f32 = 0.6;
const FREE: f32 = 0.4;
/// So far, metres, what is new lies from all that was solid, and beams go on behind what is gone: scans, walls and their
/// places in the map err together by a third of it ([`CERTAIN_PLACE`] and the 3.5 cm of the map).
pub(crate) const CLEARANCE: f64 = 0.25;
/// A scan counts if the standard deviation of its place is at most this, metres.
pub(crate) const CERTAIN_PLACE: f64 = 0.08;
/// Beams count to this range, metres: headings of maps and matches err by 0.008 rad, a third of the clearance there.
const RANGE: f64 = 10.0;
/// A cell has changed if so many scans say so, this fraction of those that say anything, from two places at least so far
/// apart, metres: somebody who stands for a moment is seen from one place.
const SCANS: u16 = 4;
const FRACTION: f64 = 0.75;
const VIEWPOINTS: f64 = 1.0;
/// Smaller regions are left out, square metres: three cells in a row are an edge that moved with the map's own error.
const LEAST_AREA: f64 = 0.035;

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

/// A region of the plane in which a recording contradicts the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// What changed.
    pub kind: ChangeKind,
    /// Its outline in the map, metres, counter-clockwise, and then its holes, clockwise; the first point is not repeated.
    pub rings: Vec<Vec<[f64; 2]>>,
    /// Of the cells that changed, square metres.
    pub area: f64,
    /// Times of the first and the last scan that say so.
    pub seen: (Time, Time),
    /// So many scans say so of one of its cells.
    pub scans: u32,
}

/// What the map says of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Known {
    Solid,
    /// And nothing solid near.
    Free,
    /// It is not known, or too near to something solid.
    Nothing,
}

/// What scans said of a cell.
#[derive(Clone, Copy, Debug)]
struct Witness {
    first: Time,
    last: Time,
    from: Vector2,
    is_seen_from_two: bool,
}

/// A scan whose place is known.
pub(crate) struct PlacedScan<'a> {
    pub time: Time,
    /// Where its beams begin, in the map.
    pub origin: Vector2,
    pub map_from_local: Rigid2,
    /// Returns in the local map, metres.
    pub returns: &'a [Point3f],
}

/// Counts contradictions of scans whose places are known. Takes no more memory than the map.
pub struct ChangeGrid {
    limits: MapLimits,
    known: Vec<Known>,
    /// Scans with a point in or beside the cell, and scans with beams through it and no point there.
    hits: Vec<u16>,
    passes: Vec<u16>,
    /// Of cells that were contradicted.
    witnesses: BTreeMap<usize, Witness>,
}

impl ChangeGrid {
    /// Of a map, and how near its cells are to something solid.
    pub(crate) fn new(grid: &ProbabilityGrid, field: &LikelihoodField) -> Result<Self, GridError> {
        let fine = grid.limits();
        let factor = (CELL / fine.resolution()).round().max(1.0);
        let resolution = fine.resolution() * factor;
        let count = |cells: u32| cells.div_ceil(factor as u32);
        let limits =
            MapLimits::new(resolution, fine.max(), count(fine.num_x_cells()), count(fine.num_y_cells()))?;
        let known = known(grid, field, &limits, factor as i32);
        let cells = limits.num_cells();
        Ok(Self { limits, known, hits: vec![0; cells], passes: vec![0; cells], witnesses: BTreeMap::new() })
    }

    /// Takes a scan.
    pub(crate) fn add(&mut self, scan: &PlacedScan) {
        let (hit, passed) = self.trace(scan);
        let around: BTreeSet<usize> = hit.iter().flat_map(|cell| self.neighbours(*cell)).collect();
        let free_and_hit = |cell: &&usize| self.known[**cell] == Known::Free;
        let new: Vec<usize> = hit.iter().filter(free_and_hit).copied().collect();
        let gone: Vec<usize> =
            passed.iter().filter(|cell| self.known[**cell] == Known::Solid).copied().collect();
        let gone: Vec<usize> = gone.into_iter().filter(|cell| !around.contains(cell)).collect();
        for cell in &hit {
            self.hits[*cell] = self.hits[*cell].saturating_add(1);
        }
        // A point beside a cell that was solid is of what was there.
        for cell in around.iter().filter(|cell| !hit.contains(cell)) {
            if self.known[*cell] == Known::Solid {
                self.hits[*cell] = self.hits[*cell].saturating_add(1);
            }
        }
        for cell in passed.iter().filter(|cell| !around.contains(cell)) {
            self.passes[*cell] = self.passes[*cell].saturating_add(1);
        }
        for cell in new.into_iter().chain(gone) {
            self.witness(cell, scan);
        }
    }

    /// Regions that have changed.
    pub(crate) fn changes(&self) -> Vec<Change> {
        let of_kind = |kind| {
            let changed = |cell: &usize| self.changed(*cell) == Some(kind);
            let cells: BTreeSet<usize> = self.witnesses.keys().copied().filter(changed).collect();
            regions(&cells, self.limits.num_x_cells() as usize)
                .into_iter()
                .map(move |r| self.change(kind, &r))
        };
        let all = of_kind(ChangeKind::Appeared).chain(of_kind(ChangeKind::Gone));
        all.filter(|change| change.area >= LEAST_AREA).collect()
    }

    /// The cells in which beams end, and those through which they pass well before their ends.
    fn trace(&self, scan: &PlacedScan) -> (BTreeSet<usize>, BTreeSet<usize>) {
        let (mut hit, mut passed) = (BTreeSet::new(), BTreeSet::new());
        let cell_at = |p: &Vector2| self.limits.flat_index(self.limits.cell_index(p.cast::<f32>()));
        let step = 0.5 * self.limits.resolution();
        for point in scan.returns {
            let end =
                scan.map_from_local.transform_point(&Vector2::new(f64::from(point.x), f64::from(point.y)));
            let beam = end - scan.origin;
            let length = beam.norm();
            if !length.is_finite() || length <= 0.0 {
                continue;
            }
            if length <= RANGE {
                hit.extend(cell_at(&end));
            }
            let steps = ((length - CLEARANCE).min(RANGE) / step).max(0.0) as u32;
            passed.extend(
                (1..steps).filter_map(|i| cell_at(&(scan.origin + beam * (f64::from(i) * step / length)))),
            );
        }
        (hit, passed)
    }

    /// A cell and those around it.
    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> + use<'_> {
        let columns = self.limits.num_x_cells() as usize;
        let (x, y) = ((cell % columns) as i32, (cell / columns) as i32);
        let around = (-1..=1).flat_map(move |j| (-1..=1).map(move |i| CellIndex::new(x + i, y + j)));
        around.filter_map(|cell| self.limits.flat_index(cell))
    }

    fn witness(&mut self, cell: usize, scan: &PlacedScan) {
        let new = Witness { first: scan.time, last: scan.time, from: scan.origin, is_seen_from_two: false };
        let witness = self.witnesses.entry(cell).or_insert(new);
        witness.last = scan.time;
        witness.is_seen_from_two |= (scan.origin - witness.from).norm() >= VIEWPOINTS;
    }

    /// What has become of a cell.
    fn changed(&self, cell: usize) -> Option<ChangeKind> {
        let witness = self.witnesses.get(&cell)?;
        let (hits, passes) = (self.hits[cell], self.passes[cell]);
        let (kind, for_it) = match self.known[cell] {
            Known::Free => (ChangeKind::Appeared, hits),
            Known::Solid => (ChangeKind::Gone, passes),
            Known::Nothing => return None,
        };
        let all = f64::from(hits) + f64::from(passes);
        let is_clear = for_it >= SCANS && f64::from(for_it) >= FRACTION * all;
        (is_clear && witness.is_seen_from_two).then_some(kind)
    }

    fn change(&self, kind: ChangeKind, region: &Region) -> Change {
        let edge = self.limits.resolution();
        let max = self.limits.max();
        // Columns run against y, rows against x: a mirror image.
        let corner = |[x, y]: &[i64; 2]| [max.x - *y as f64 * edge, max.y - *x as f64 * edge];
        let rings = region.rings.iter().map(|ring| ring.iter().rev().map(corner).collect()).collect();
        let seen = region.cells.iter().filter_map(|cell| self.witnesses.get(cell));
        let (first, last) = (seen.clone().map(|w| w.first).min(), seen.map(|w| w.last).max());
        let count = |cell: &usize| match kind {
            ChangeKind::Appeared => self.hits[*cell],
            ChangeKind::Gone => self.passes[*cell],
        };
        let scans = region.cells.iter().map(count).max().unwrap_or(0);
        Change {
            kind,
            rings,
            area: region.cells.len() as f64 * edge * edge,
            seen: (first.unwrap_or_default(), last.unwrap_or_default()),
            scans: u32::from(scans),
        }
    }
}

/// What the map says of larger cells.
fn known(grid: &ProbabilityGrid, field: &LikelihoodField, limits: &MapLimits, factor: i32) -> Vec<Known> {
    let nearest = LikelihoodField::at_distance(CLEARANCE);
    let says = |cell: CellIndex| {
        let inner = (0..factor).flat_map(|y| (0..factor).map(move |x| (x, y)));
        let fine = inner.map(|(x, y)| CellIndex::new(factor * cell.x + x, factor * cell.y + y));
        let known: Vec<CellIndex> = fine.clone().filter(|cell| grid.is_known(*cell)).collect();
        let is_free = |cell: &CellIndex| {
            grid.probability(*cell) < FREE && field.at(&grid.limits().cell_center(*cell)) < nearest
        };
        if known.iter().any(|cell| grid.probability(*cell) > SOLID) {
            Known::Solid
        } else if known.len() == (factor * factor) as usize && known.iter().all(is_free) {
            Known::Free
        } else {
            Known::Nothing
        }
    };
    let (columns, rows) = (limits.num_x_cells() as i32, limits.num_y_cells() as i32);
    (0..rows).flat_map(|y| (0..columns).map(move |x| CellIndex::new(x, y))).map(says).collect()
}
