//! Finds where a recording contradicts a 3D map: cells in which beams of localised scans end or pass
//! contrary to the map.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use portolan_geometry::{Point3f, Rigid3, Time, Vector3, to_f32};
use portolan_grids::{GridError, HybridGrid, VoxelIndex};
use portolan_lidar_odometry::PlaneMap;
use portolan_mapping::{GraphState, Space3d};
use portolan_sensor::voxel_filter_points;

use crate::change_regions::regions;
use crate::changes::{Change, ChangeCounter, ChangeKind};
use crate::finder::LocalScan;
use crate::known_map::KnownMap;
use crate::known_map_3d::KnownMap3d;
use crate::near_cells::NearCells;
use crate::occupancy::{Occupancy, around};
use crate::placed_scan::PlacedScan;
use crate::settings::changes::{
    BEAM_STEP, CHANGE_RANGE_3D, CHANGING_FRACTION, CHANGING_SCANS, COUNTED_VOXEL, KEPT_BEAM,
    KEPT_SWEEP_METRES, KEPT_VOXEL, LEAST_CHANGED_CELLS, LEAST_CHANGED_COLUMNS, STEEP_SINE,
    VIEWPOINT_DISTANCE,
};
use crate::settings::maps::{FREE_BEAM_CLEARANCE, OCCUPANCY_CELL};
use crate::settings::scans::NEW_VIEW_RADIANS;

/// All cells that beams reach, with two cells around, fit into the set of near cells.
const _: () = assert!((CHANGE_RANGE_3D / OCCUPANCY_CELL) as i32 + 1 + 2 <= NearCells::REACH);

/// A scan that is kept until the recording ends, because 3D nodes keep too few points to find changes.
#[derive(Clone, Debug)]
pub struct KeptSweep {
    pub(crate) time: Time,
    /// Pose of the scan in the map.
    pub(crate) map_from_tracking: Rigid3,
    /// Where its beams begin, in the tracking frame.
    origin: Point3f,
    /// Returns in the tracking frame, thinned; longer beams are cut to the range that counts.
    returns: Vec<Point3f>,
}

impl KeptSweep {
    /// From a scan that was localised at this pose in the map.
    pub(crate) fn new(scan: &LocalScan, map_from_tracking: &Rigid3) -> Self {
        let tracking_from_local = to_f32(&scan.local_from_tracking.inverse());
        let origin = tracking_from_local * scan.origin;
        let clipped = scan.returns.points.iter().map(|point| {
            let beam = tracking_from_local * point - origin;
            origin + beam * (KEPT_BEAM / beam.norm().max(KEPT_BEAM))
        });
        let clipped: Vec<Point3f> =
            clipped.filter(|point| point.coords.iter().all(|v| v.is_finite())).collect();
        Self {
            time: scan.time,
            map_from_tracking: *map_from_tracking,
            origin,
            returns: voxel_filter_points(&clipped, KEPT_VOXEL),
        }
    }

    /// Whether another scan at this pose would show the same view.
    pub(crate) fn is_like(&self, map_from_tracking: &Rigid3) -> bool {
        let motion = self.map_from_tracking.translation.vector - map_from_tracking.translation.vector;
        motion.norm() < KEPT_SWEEP_METRES
            && self.map_from_tracking.rotation.angle_to(&map_from_tracking.rotation) < NEW_VIEW_RADIANS
    }

    /// The sweep in the form in which it is compared with the map.
    pub(crate) fn placed(&self) -> PlacedScan<'_> {
        let origin = self.map_from_tracking * self.origin.cast::<f64>();
        PlacedScan {
            time: self.time,
            origin: origin.coords,
            map_from_local: self.map_from_tracking,
            returns: &self.returns,
        }
    }
}

/// A cell and those up to two cells away along each axis: poses of real drives are off by as much.
fn near([x, y, z]: VoxelIndex) -> impl Iterator<Item = VoxelIndex> {
    (-2..=2).flat_map(move |i| (-2..=2).flat_map(move |j| (-2..=2).map(move |k| [x + i, y + j, z + k])))
}

/// State of the map in the cells in which contradictions are counted.
pub(crate) struct KnownVoxels {
    occupancy: Arc<Occupancy>,
    planes: Arc<PlaneMap>,
    /// Cells in which scans of the map itself end.
    ends: HybridGrid,
}

impl KnownVoxels {
    /// From a map and the scans that it keeps.
    ///
    /// # Errors
    /// If the grid cannot be made.
    pub fn new(
        occupancy: &Arc<Occupancy>,
        planes: &Arc<PlaneMap>,
        state: &GraphState<Space3d>,
    ) -> Result<Self, GridError> {
        let mut ends = HybridGrid::new(OCCUPANCY_CELL)?;
        for node in state.nodes.values() {
            let pose = to_f32(&node.map_from_tracking);
            for point in KnownMap3d::points_in_tracking(&node.data).points {
                if let Some(cell) = ends.cell_index(&(pose * point)) {
                    ends.set_probability(cell, 0.9);
                }
            }
        }
        Ok(Self { occupancy: Arc::clone(occupancy), planes: Arc::clone(planes), ends })
    }

    /// Whether a cell is free, and no scan of the map ended in it or near it.
    fn is_open(&self, cell: VoxelIndex) -> bool {
        self.occupancy.is_free_cell(cell)
            && !near(cell).any(|cell| self.occupancy.is_solid(cell) || self.ends.is_known(cell))
    }

    /// Whether a beam passes through the surface at a point, and not along it.
    fn is_steep(&self, point: &Point3f, direction: &nalgebra::Vector3<f32>) -> bool {
        self.planes.plane_near(point).is_none_or(|plane| plane.normal.dot(direction).abs() > STEEP_SINE)
    }
}

/// Counts of scans in a cell.
#[derive(Clone, Copy, Debug)]
struct Voxel {
    kind: ChangeKind,
    /// Scans with a point in the cell (near it, too, if it is solid), and scans with beams through it and no
    /// point there.
    hits: u16,
    passes: u16,
    /// Sightings by contradicting scans.
    seen: Option<VoxelSightings>,
}

/// When and from where scans contradicted a voxel.
#[derive(Clone, Copy, Debug)]
struct VoxelSightings {
    first: Time,
    last: Time,
    from: Vector3,
    is_seen_from_two: bool,
}

impl Voxel {
    fn new(kind: ChangeKind) -> Self {
        Self { kind, hits: 0, passes: 0, seen: None }
    }

    fn record_observation(&mut self, scan: &PlacedScan) {
        let new =
            VoxelSightings { first: scan.time, last: scan.time, from: scan.origin, is_seen_from_two: false };
        let seen = self.seen.get_or_insert(new);
        seen.last = scan.time;
        seen.is_seen_from_two |= (scan.origin - seen.from).norm() >= VIEWPOINT_DISTANCE;
    }

    fn contradictions(&self) -> u16 {
        if self.kind == ChangeKind::Appeared { self.hits } else { self.passes }
    }

    fn has_changed(&self) -> bool {
        let all = f64::from(self.hits) + f64::from(self.passes);
        let scans = self.contradictions();
        let is_clear = scans >= CHANGING_SCANS && f64::from(scans) >= CHANGING_FRACTION * all;
        is_clear && self.seen.is_some_and(|seen| seen.is_seen_from_two)
    }
}

/// Counts contradictions of localised scans. Takes no more memory than the map.
pub(crate) struct VoxelChanges {
    map: Arc<KnownVoxels>,
    voxels: BTreeMap<VoxelIndex, Voxel>,
}

impl VoxelChanges {
    /// Starts with no contradictions.
    pub fn new(map: Arc<KnownVoxels>) -> Self {
        Self { map, voxels: BTreeMap::new() }
    }

    /// Cells that have changed, without those of regions that are too small to be reported.
    pub fn changed(&self) -> ChangedVoxels {
        let all = self.regions().into_iter();
        let kinds = all.flat_map(|(kind, cells)| cells.into_iter().map(move |cell| (cell, kind)));
        ChangedVoxels { map: Arc::clone(&self.map), kinds: kinds.collect() }
    }

    /// Regions of changed cells of one kind that touch each other, at corners at least.
    fn regions(&self) -> Vec<(ChangeKind, BTreeSet<VoxelIndex>)> {
        let mut found = Vec::new();
        for kind in [ChangeKind::Appeared, ChangeKind::Gone] {
            let changed = self.voxels.iter().filter(|(_, voxel)| voxel.kind == kind && voxel.has_changed());
            let mut left: BTreeSet<VoxelIndex> = changed.map(|(cell, _)| *cell).collect();
            while let Some(first) = left.pop_first() {
                let (mut region, mut open) = (BTreeSet::from([first]), vec![first]);
                while let Some(cell) = open.pop() {
                    for beside in around(cell).filter(|beside| left.remove(beside)).collect::<Vec<_>>() {
                        region.insert(beside);
                        open.push(beside);
                    }
                }
                let columns: BTreeSet<(i32, i32)> = region.iter().map(|[x, y, _]| (*x, *y)).collect();
                if region.len() >= LEAST_CHANGED_CELLS && columns.len() >= LEAST_CHANGED_COLUMNS {
                    found.push((kind, region));
                }
            }
        }
        found
    }

    /// Converts a region for the report: its outlines from above, and its heights.
    fn change_of(&self, kind: ChangeKind, cells: &BTreeSet<VoxelIndex>) -> Vec<Change> {
        let from_to = |of: fn(&VoxelIndex) -> i32| {
            let along = || cells.iter().map(of);
            (along().min().unwrap_or(0), along().max().unwrap_or(0))
        };
        let ((left, right), (bottom, _)) = (from_to(|[x, ..]| *x), from_to(|[_, y, _]| *y));
        let (lowest, highest) = from_to(|[.., z]| *z);
        let columns = (right - left + 1).max(1) as usize;
        let flat = |[x, y, _]: &VoxelIndex| (y - bottom) as usize * columns + (x - left) as usize;
        let edge = f64::from(OCCUPANCY_CELL);
        let low = self.map.occupancy.middle([left, bottom, lowest]).coords.map(|v| f64::from(v) - 0.5 * edge);
        let heights = Some([low.z, low.z + f64::from(highest - lowest + 1) * edge]);
        let corner = |[x, y]: &[i64; 2]| [low.x + *x as f64 * edge, low.y + *y as f64 * edge];
        let voxels = cells.iter().filter_map(|cell| self.voxels.get(cell));
        let seen = voxels.clone().filter_map(|voxel| voxel.seen);
        let (first, last) = (seen.clone().map(|s| s.first).min(), seen.map(|s| s.last).max());
        let scans = voxels.map(Voxel::contradictions).max().unwrap_or(0);
        let outlines = regions(&cells.iter().map(flat).collect(), columns).into_iter();
        let change = |region: crate::change_regions::Region| Change {
            kind,
            rings: region.rings.iter().map(|ring| ring.iter().map(corner).collect()).collect(),
            area: region.cells.len() as f64 * edge * edge,
            heights,
            seen: (first.unwrap_or_default(), last.unwrap_or_default()),
            scans: u32::from(scans),
        };
        outlines.map(change).collect()
    }
}

impl VoxelChanges {
    /// Counts the ends of beams; returns the cells in which passing beams then no longer count.
    fn count_ends(&mut self, scan: &PlacedScan, ends: &NearCells) -> NearCells {
        let map = Arc::clone(&self.map);
        for cell in ends.iter().filter(|cell| map.is_open(*cell)) {
            let voxel = self.voxels.entry(cell).or_insert(Voxel::new(ChangeKind::Appeared));
            voxel.hits = voxel.hits.saturating_add(1);
            voxel.record_observation(scan);
        }
        // A point near a cell that was solid counts as a hit of this cell.
        let beside = ends.dilated_by_two();
        for cell in beside.iter().filter(|cell| map.occupancy.is_solid(*cell)) {
            let voxel = self.voxels.entry(cell).or_insert(Voxel::new(ChangeKind::Gone));
            voxel.hits = voxel.hits.saturating_add(1);
        }
        beside
    }

    /// Cells through which beams pass, each once, with the kind of change that this contradicts or supports.
    /// `decided` cells are skipped.
    fn passed(
        &self,
        points: &[Point3f],
        origin: &Point3f,
        decided: NearCells,
    ) -> Vec<(VoxelIndex, ChangeKind)> {
        let (map, mut decided, mut passed) = (&self.map, decided, Vec::new());
        for point in points {
            let beam = point - origin;
            let length = beam.norm();
            let direction = beam / length.max(BEAM_STEP);
            let steps = ((length - FREE_BEAM_CLEARANCE).min(CHANGE_RANGE_3D) / BEAM_STEP).max(0.0) as u32;
            for at in (2..steps).map(|i| origin + direction * (i as f32 * BEAM_STEP)) {
                let Some(cell) = map.occupancy.cell(&at).filter(|cell| !decided.contains(*cell)) else {
                    continue;
                };
                if map.occupancy.is_solid(cell) {
                    // Another beam may meet it more steeply.
                    if !map.is_steep(&at, &direction) {
                        continue;
                    }
                    passed.push((cell, ChangeKind::Gone));
                } else if self.voxels.get(&cell).is_some_and(|voxel| voxel.kind == ChangeKind::Appeared) {
                    passed.push((cell, ChangeKind::Appeared));
                }
                decided.insert(cell);
            }
        }
        passed
    }
}

impl ChangeCounter for VoxelChanges {
    fn add(&mut self, scan: &PlacedScan) {
        let (pose, origin) = (to_f32(&scan.map_from_local), Point3f::from(scan.origin.cast::<f32>()));
        let Some(place) = self.map.occupancy.cell(&origin) else { return };
        let points: Vec<Point3f> =
            voxel_filter_points(scan.returns, COUNTED_VOXEL).into_iter().map(|point| pose * point).collect();
        let counted = points.iter().filter(|point| (*point - origin).norm() <= CHANGE_RANGE_3D);
        let mut ends = NearCells::around(place);
        counted.filter_map(|point| self.map.occupancy.cell(point)).for_each(|cell| ends.insert(cell));
        let beside = self.count_ends(scan, &ends);
        for (cell, kind) in self.passed(&points, &origin, beside) {
            let voxel = self.voxels.entry(cell).or_insert(Voxel::new(kind));
            voxel.passes = voxel.passes.saturating_add(1);
            if kind == ChangeKind::Gone {
                voxel.record_observation(scan);
            }
        }
    }

    fn changes(&self) -> Vec<Change> {
        self.regions().iter().flat_map(|(kind, cells)| self.change_of(*kind, cells)).collect()
    }
}

/// Cells of the map that have changed.
pub(crate) struct ChangedVoxels {
    map: Arc<KnownVoxels>,
    kinds: BTreeMap<VoxelIndex, ChangeKind>,
}

impl ChangedVoxels {
    /// Whether nothing has changed.
    pub fn is_empty(&self) -> bool {
        self.kinds.is_empty()
    }

    /// Kind of change at a point of the map.
    pub fn at(&self, point: &Point3f) -> Option<ChangeKind> {
        self.kinds.get(&self.map.occupancy.cell(point)?).copied()
    }

    /// Whether an object is gone at a point of the map, or right beside it if its own cell is not solid.
    pub fn is_gone(&self, point: &Point3f) -> bool {
        let is_gone = |cell: VoxelIndex| self.kinds.get(&cell) == Some(&ChangeKind::Gone);
        let Some(cell) = self.map.occupancy.cell(point) else { return false };
        is_gone(cell) || (!self.map.occupancy.is_solid(cell) && around(cell).any(is_gone))
    }

    /// Area of the changes of a kind, seen from above, square metres.
    pub fn area(&self, kind: ChangeKind) -> f64 {
        let cells = self.kinds.iter().filter(|(_, of_cell)| **of_cell == kind);
        let columns: BTreeSet<(i32, i32)> = cells.map(|([x, y, _], _)| (*x, *y)).collect();
        columns.len() as f64 * f64::from(OCCUPANCY_CELL * OCCUPANCY_CELL)
    }
}
