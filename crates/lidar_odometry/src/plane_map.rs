//! The planar voxel map: voxels of three sizes, of which the largest planar one is used.
//!
//! Octrees of three levels (Yuan et al. 2022, section III): every hit is counted in the voxel of each size
//! around it, until a voxel is settled as a plane.

mod look_up;
mod records;

pub use records::PlaneRecord;

use nalgebra as na;
use portolan_geometry::Point3f;

use crate::plane_fit::{PlaneCell, PlaneFit};
use crate::settings::PlaneFitSettings;
use crate::settings::constants::plane_map::{MAX_HITS, VOXEL_OFFSET};
use crate::voxel_tree::{LEVELS, SMALLEST_IN_ALL, SMALLEST_IN_LARGEST, Smallest, VoxelTree};

/// A planar patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// A point on it, metres.
    pub point: na::Vector3<f32>,
    /// Unit length; on the side from which the plane was seen, if that is known.
    pub normal: na::Vector3<f32>,
    /// Mean square distance of the hits from it, m².
    pub variance: f32,
    /// Variance of the normal by the noise of the hits, rad².
    pub normal_variance: f32,
    /// Reason why it may be an artefact of the scan pattern: beams that hit uneven ground always at the
    /// same distance, now higher and now lower, make planes that move with the scanner.
    pub unreliable: Option<Unreliable>,
}

/// Reason why a plane may be an artefact of the scan pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unreliable {
    /// Its hits were seen at grazing incidence: they are in the cone that a beam sweeps, whatever surface
    /// it hits.
    GrazingIncidence,
    /// It is level, and was seen from below.
    DownwardNormal,
}

/// Planes near the origin of a frame.
#[derive(Clone, Debug)]
pub struct PlaneMap {
    edge: f32,
    smallest_per_metre: f32,
    settings: PlaneFitSettings,
    voxels: VoxelTree,
    cells: Vec<PlaneCell>,
    /// The fit of each cell.
    fits: Vec<PlaneFit>,
}

/// Number that marks a missing voxel.
const NO_VOXEL: usize = usize::MAX;
/// Number of hits that are inserted at once. (The numbers of new voxels, and with them the order of
/// planes, follow from it.)
pub(crate) const BATCH: usize = 32;

/// A hit to be inserted.
#[derive(Clone, Copy, Default)]
struct Hit {
    point: Point3f,
    /// Unit vector to the origin of the beam, or zero.
    toward: na::Vector3<f32>,
    /// None for a hit that is not finite or too far away.
    smallest: Option<Smallest>,
}

/// A hit to be inserted into voxels of the next size, too.
#[derive(Clone, Copy, Default)]
struct Open {
    /// Its index among the hits.
    hit: u8,
    smallest: Smallest,
    /// Number of the surrounding voxel of the previous size.
    larger: u32,
}

impl Hit {
    #[inline]
    fn new(map: &PlaneMap, point: &Point3f, toward: na::Vector3<f32>) -> Self {
        Self { point: *point, toward, smallest: Smallest::around(&map.scaled(point)) }
    }
}

impl PlaneMap {
    /// An empty map whose largest voxels have an edge of `edge` metres (at least a millimetre).
    pub fn new(edge: f32) -> Self {
        Self::with_settings(edge, PlaneFitSettings::default())
    }

    /// Settings of the plane fit.
    pub(crate) fn settings(&self) -> &PlaneFitSettings {
        &self.settings
    }

    /// An empty map with other settings of the fit than the defaults.
    pub fn with_settings(edge: f32, settings: PlaneFitSettings) -> Self {
        let edge = if edge.is_finite() { edge.max(1e-3) } else { 1.0 };
        Self {
            edge,
            settings,
            smallest_per_metre: SMALLEST_IN_LARGEST / edge,
            voxels: VoxelTree::with_capacity(0),
            cells: Vec::new(),
            fits: Vec::new(),
        }
    }

    /// Edge of the largest voxels, metres.
    pub fn edge(&self) -> f32 {
        self.edge
    }

    /// Memory taken, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.voxels.memory_bytes()
            + self.cells.capacity() * size_of::<PlaneCell>()
            + self.fits.capacity() * size_of::<PlaneFit>()
    }

    /// Adds a hit (metres, in the frame of the map) with unknown origin of its beam. A hit that is not
    /// finite or too far away changes nothing.
    pub fn insert(&mut self, point: &Point3f) {
        self.insert_hits(&[Hit::new(self, point, na::Vector3::zeros())]);
    }

    /// Adds hits as [`Self::insert`] does.
    pub fn insert_unseen(&mut self, points: &[Point3f]) {
        for points in points.chunks(BATCH) {
            let hits: Vec<Hit> = points.iter().map(|p| Hit::new(self, p, na::Vector3::zeros())).collect();
            self.insert_hits(&hits);
        }
    }

    /// Adds a hit of a beam from `origin` (both metres, in the frame of the map).
    pub fn insert_seen_from(&mut self, point: &Point3f, origin: &Point3f) {
        self.insert_all(std::iter::once(*point), origin);
    }

    /// Adds hits of beams from `origin` (all metres, in the frame of the map).
    pub fn insert_all(&mut self, points: impl Iterator<Item = Point3f>, origin: &Point3f) {
        let mut hits = [Hit::default(); BATCH];
        let mut filled = 0;
        // An explicit loop: chains of iterators are not always compiled into one.
        for point in points {
            let toward = origin - point;
            let distance = toward.norm();
            let toward = if distance > 1e-6 { toward * (1.0 / distance) } else { na::Vector3::zeros() };
            hits[filled] = Hit::new(self, &point, toward);
            filled += 1;
            if filled == BATCH {
                self.insert_hits(&hits);
                filled = 0;
            }
        }
        self.insert_hits(&hits[..filled]);
    }

    /// A position in units of the smallest voxels, from the corner of the whole map.
    #[inline]
    fn scaled(&self, place: &Point3f) -> na::Vector3<f32> {
        let to_corner = VOXEL_OFFSET * SMALLEST_IN_LARGEST + 0.5 * SMALLEST_IN_ALL;
        place.coords * self.smallest_per_metre + na::Vector3::repeat(to_corner)
    }

    /// Adds at most [`BATCH`] hits, one voxel size after the other. All voxels of a size are looked up and
    /// read before the first of them is changed, so that their reads overlap: most of the time is memory
    /// latency.
    fn insert_hits(&mut self, hits: &[Hit]) {
        let mut open = [Open::default(); BATCH];
        let mut num_open = 0;
        for (i, smallest) in hits.iter().take(BATCH).enumerate().filter_map(|(i, h)| Some((i, h.smallest?))) {
            open[num_open] = Open { hit: i as u8, smallest, larger: 0 };
            num_open += 1;
        }
        for level in 0..LEVELS {
            let mut numbers = [NO_VOXEL; BATCH];
            for (number, open) in numbers.iter_mut().zip(&open[..num_open]) {
                *number = self.number_of(open, level).unwrap_or(NO_VOXEL);
            }
            // A loop without branches, so that all these reads are in flight at once.
            let mut counts = [0; BATCH];
            for (count, number) in counts.iter_mut().zip(&numbers[..num_open]) {
                *count = self.cells.get(*number).map_or(0, |cell| cell.count);
            }
            let mut known = [None; BATCH];
            for k in (0..num_open).filter(|k| counts[*k] >= MAX_HITS) {
                known[k] = Some(self.passes_to_smaller(numbers[k], &hits[usize::from(open[k].hit)]));
            }
            let mut still_open = 0;
            for k in 0..num_open {
                let number = match numbers[k] {
                    NO_VOXEL => self.number_or_new(&open[k], level),
                    number => number,
                };
                let hit = &hits[usize::from(open[k].hit)];
                let continues = known[k].unwrap_or_else(|| self.add_hit(number, level, hit));
                if continues && level + 1 < LEVELS && open[k].smallest.is_in_reach(level + 1) {
                    open[still_open] = Open { larger: number as u32, ..open[k] };
                    still_open += 1;
                }
            }
            num_open = still_open;
        }
    }

    /// Whether a hit in a voxel that no longer changes is also inserted into smaller ones.
    #[inline]
    fn passes_to_smaller(&self, number: usize, hit: &Hit) -> bool {
        let cell = &self.cells[number];
        !cell.is_settled(&self.settings) || cell.shows_other_side(&hit.toward, &self.settings)
    }

    /// Adds a hit to a voxel of a size. Gives whether it is also inserted into smaller ones.
    #[inline]
    fn add_hit(&mut self, number: usize, level: u32, hit: &Hit) -> bool {
        let cell = &mut self.cells[number];
        let is_settled = cell.is_settled(&self.settings);
        // The other side of a floor or of a wall is a surface of its own.
        if is_settled && cell.shows_other_side(&hit.toward, &self.settings) {
            return true;
        }
        let edge = self.edge / (1 << level) as f32;
        cell.add(&hit.point, &hit.toward, edge, &self.settings, &mut self.fits[number]);
        !is_settled
    }

    /// The number of the voxel of a size around a hit, if it exists.
    #[inline]
    fn number_of(&self, open: &Open, level: u32) -> Option<usize> {
        match level {
            0 => self.voxels.largest(open.smallest),
            _ => self.voxels.child(open.larger as usize, open.smallest, level),
        }
    }

    /// The same; the voxel is created if it does not exist.
    fn number_or_new(&mut self, open: &Open, level: u32) -> usize {
        self.number_of(open, level).unwrap_or_else(|| {
            self.cells.push(PlaneCell::new());
            self.fits.push(PlaneFit::default());
            match level {
                0 => self.voxels.add_largest(open.smallest),
                _ => self.voxels.add_child(open.larger as usize, open.smallest, level),
            }
        })
    }

    /// The plane near a position: that of the largest planar voxel around it, or of the neighbour across
    /// the nearest side of the largest voxel.
    pub fn plane_near(&self, place: &Point3f) -> Option<Plane> {
        self.plane_seen(place, &na::Vector3::zeros())
    }

    /// The plane near a position as [`Self::plane_near`] chooses it, among those that are not seen from
    /// the side opposite to the direction `toward` (unit length).
    #[inline]
    pub fn plane_seen(&self, place: &Point3f, toward: &na::Vector3<f32>) -> Option<Plane> {
        let scaled = self.scaled(place);
        self.plane_around(&scaled, toward)
            .or_else(|| self.plane_around(&across_nearest_side(&scaled), toward))
    }

    /// `scaled` is a position as [`Self::scaled`] gives it.
    #[inline]
    fn plane_around(&self, scaled: &na::Vector3<f32>, toward: &na::Vector3<f32>) -> Option<Plane> {
        let smallest = Smallest::around(scaled)?;
        let mut number = self.voxels.largest(smallest)?;
        for level in 0..LEVELS {
            if level > 0 {
                number =
                    self.voxels.child(number, smallest, level).filter(|_| smallest.is_in_reach(level))?;
            }
            let cell = &self.cells[number];
            if cell.is_plane && !cell.shows_other_side(toward, &self.settings) {
                return Some(cell.plane(&self.fits[number]));
            }
        }
        None
    }

    /// The map reduced to its planes, to which nothing more is added. Planes in larger voxels that are not
    /// planes are left out.
    #[must_use]
    pub fn compacted(&self) -> Self {
        let (voxels, kept) = self.voxels.filtered(|number| self.cells[number].is_plane);
        Self {
            settings: self.settings.clone(),
            cells: kept.iter().map(|number| self.cells[*number]).collect(),
            fits: kept.iter().map(|number| self.fits[*number]).collect(),
            voxels,
            ..*self
        }
    }

    /// All planes that are used, with their number of hits, in the order in which their voxels were first
    /// hit.
    pub fn planes(&self) -> impl Iterator<Item = (Plane, u32)> + '_ {
        let planes = self.cells.iter().zip(&self.fits).filter(|(cell, _)| cell.is_plane);
        planes.map(|(cell, fit)| (cell.plane(fit), u32::from(cell.count)))
    }
}

/// The position across the nearest side of the largest voxel, both as [`PlaneMap::scaled`] gives them.
#[inline]
fn across_nearest_side(scaled: &na::Vector3<f32>) -> na::Vector3<f32> {
    let to_side = (scaled / SMALLEST_IN_LARGEST).map(|v| v - (v as u32) as f32 - 0.5);
    let axis = to_side.iamax();
    let mut across = *scaled;
    across[axis] += to_side[axis].signum() * (0.51 - to_side[axis].abs()) * SMALLEST_IN_LARGEST;
    across
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hits on a floor at `height` and a wall at x = 2.
    fn room(height: f32) -> PlaneMap {
        let mut map = PlaneMap::new(1.0);
        for i in 0..80 {
            for j in 0..80 {
                let (u, v) = (0.05 * i as f32 - 2.0, 0.05 * j as f32 - 2.0);
                let noise = 0.01 * (((i * 7 + j * 3) % 5) as f32 - 2.0);
                map.insert(&Point3f::new(u, v, height + noise));
                map.insert(&Point3f::new(2.0 + noise, u, height + 2.0 + v));
            }
        }
        map
    }

    #[test]
    fn floors_and_walls_are_planes() {
        let map = room(-1.2);
        let floor = map.plane_near(&Point3f::new(0.3, 0.4, -1.1)).unwrap();
        assert!(floor.normal.z.abs() > 0.999 && (floor.point.z + 1.2).abs() < 0.005, "{floor:?}");
        let wall = map.plane_near(&Point3f::new(2.05, 0.4, 0.5)).unwrap();
        assert!(wall.normal.x.abs() > 0.999 && (wall.point.x - 2.0).abs() < 0.005, "{wall:?}");
        assert_eq!(map.plane_near(&Point3f::new(-1.0, 0.0, 0.8)), None);
        assert_eq!(map.plane_near(&Point3f::new(f32::NAN, 0.0, 1e30)), None);
        let compacted = map.compacted();
        assert!(compacted.cells.len() < map.cells.len());
        assert_eq!(compacted.plane_near(&Point3f::new(0.3, 0.4, -1.1)), Some(floor));
    }

    #[test]
    fn the_corner_is_made_of_smaller_planes() {
        let map = room(-1.2);
        let near = map.plane_near(&Point3f::new(1.7, 0.4, -1.19)).unwrap();
        assert!(near.normal.z.abs() > 0.9, "{near:?}");
    }

    #[test]
    fn floor_and_ceiling_below_it_are_two_surfaces() {
        let mut map = PlaneMap::new(1.0);
        let mut add = |height: f32, origin: f32| {
            for i in 0..400 {
                let (u, v) = (0.05 * (i % 20) as f32, 0.05 * (i / 20) as f32);
                map.insert_seen_from(&Point3f::new(u, v, height), &Point3f::new(0.5, 0.5, origin));
            }
        };
        // The ceiling is seen from below first, then the floor above it.
        add(0.0, -2.0);
        add(0.25, 2.0);
        let place = Point3f::new(0.3, 0.3, 0.2);
        let up = na::Vector3::z();
        let floor = map.plane_seen(&place, &up).unwrap();
        assert!((floor.point.z - 0.25).abs() < 0.01 && floor.normal.z > 0.99, "{floor:?}");
        let ceiling = map.plane_seen(&place, &-up).unwrap();
        assert!(ceiling.point.z.abs() < 0.01 && ceiling.normal.z < -0.99, "{ceiling:?}");
    }

    #[test]
    fn ground_with_a_downward_normal_is_unreliable() {
        // A piece of ground 10 m away that falls away from the scanner with slope 0.25, seen from a height
        // of `eye`.
        let seen_from = |eye: f32| {
            let mut map = PlaneMap::new(1.0);
            let origin = Point3f::new(0.0, 0.0, eye);
            for i in 0..400 {
                let (u, v) = (0.05 * (i % 20) as f32 - 0.5, 0.05 * (i / 20) as f32 - 0.5);
                map.insert_seen_from(&Point3f::new(10.1 + u, 0.1 + v, -0.25 * u), &origin);
            }
            map.plane_near(&Point3f::new(10.1, 0.1, 0.0)).unwrap()
        };
        // From 1 m above, the beams come from below the ground; from 5 m they come from above.
        let (from_below, from_above) = (seen_from(1.0), seen_from(5.0));
        assert!(
            from_below.normal.z < -0.9 && from_below.unreliable == Some(Unreliable::DownwardNormal),
            "{from_below:?}"
        );
        assert!(from_above.normal.z > 0.9 && from_above.unreliable.is_none(), "{from_above:?}");
        // A surface above the scanner rightly has a downward normal.
        assert_eq!(seen_from(-5.0).unreliable, None);
    }

    #[test]
    fn distant_and_non_finite_points_are_dropped() {
        let mut map = PlaneMap::new(f32::NAN);
        for v in [f32::NAN, f32::INFINITY, 1e30, -1e7] {
            map.insert(&Point3f::new(v, 0.0, 0.0));
        }
        assert_eq!(map.planes().count(), 0);
        assert!(map.cells.is_empty() && map.edge() == 1.0);
    }
}
