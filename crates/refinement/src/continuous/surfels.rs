//! Extracts surfels: planar patches seen in a short window of time, and the clusters of points in them.
//!
//! Within a window the trajectory is accurate enough that a wall is one sheet. Points are sorted into cubic
//! cells of three sizes; the largest planar cell becomes a patch. The later optimisation uses only clusters:
//! the mean of the points of one patch within a few hundredths of a second. The number of clusters depends on
//! the visible surface, not on the number of points.

use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use rayon::prelude::*;

use super::cells::{Cells, Key};
use super::correction::Corrections;
use super::coverage::{Coverage, TimedPoints};
use super::dense_trajectory::{DenseTrajectory, PoseMatrices};
use super::held_out::Selection;
use crate::point_store::StoredPoint;
use portolan_spatial::{Moments, PlaneFit};

/// Edge of the smallest cells, metres. The larger ones have twice and four times that.
pub(crate) const FINEST_CELL: f64 = 0.25;
const LEVELS: usize = 3;
/// Minimum number of points of a patch.
const MIN_POINTS: f64 = 8.0;
/// Number of standard deviations up to which a point belongs to its patch.
const GATE: f64 = 3.0;
/// Minimum standard deviation for that gate, metres.
const LEAST_DEVIATION: f64 = 0.01;
/// Time span of the points of a cluster, seconds.
const CLUSTER_SECONDS: f64 = 0.05;
/// Minimum cosine of the angle of incidence of a patch: at grazing incidence patches are not used.
const LEAST_INCIDENCE: f64 = 0.05;
const NONE: u32 = u32::MAX;

/// A planar patch seen by one sensor during a window. Poses are those of [`DenseTrajectory`]. Times and
/// positions are uncorrected, as in the recording; corrections are applied as to its points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Surfel {
    /// The sensor.
    pub sensor: u8,
    /// Mean time of its points.
    pub seconds: f64,
    /// Mean of its points in the tracking frame at that time.
    pub mean_in_tracking: Vector3,
    /// Normal towards the sensor, in the tracking frame at that time.
    pub normal_in_tracking: Vector3,
    /// Number of points.
    pub count: f64,
    /// Variance across, square metres.
    pub variance: f64,
    /// Index of its first cluster.
    pub first_cluster: u32,
    /// Number of its clusters.
    pub cluster_count: u32,
}

/// The mean of neighbouring points of one patch at nearly one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cluster {
    /// Mean time.
    pub seconds: f64,
    /// Mean in the tracking frame at that time.
    pub in_tracking: [f32; 3],
    /// Number of points.
    pub count: f32,
}

/// Surfels of one sensor in a window.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Window {
    /// Number of the window.
    pub number: usize,
    /// Its surfels.
    pub surfels: std::ops::Range<usize>,
}

/// Surfels of all windows, and their clusters.
#[derive(Clone, Debug, Default)]
pub(crate) struct SurfelMap {
    pub surfels: Vec<Surfel>,
    pub clusters: Vec<Cluster>,
    /// For each window, and in it for each sensor, a range of surfels.
    pub windows: Vec<Window>,
    /// Number of points that were processed, on patches or not.
    pub looked_at: usize,
}

impl SurfelMap {
    /// Fraction of the points on patches, 0 to 1.
    pub fn planar_share(&self) -> f64 {
        self.surfels.iter().map(|s| s.count).sum::<f64>() / self.looked_at.max(1) as f64
    }

    /// Finds the planar patches of every window of about `window` seconds with the current trajectory.
    pub fn extract(
        points: &TimedPoints,
        selection: Selection,
        coverage: &Coverage,
        trajectory: &DenseTrajectory,
        window: f64,
    ) -> Self {
        let matrices = trajectory.matrices();
        let windows = coverage.windows(window);
        let parts: Vec<WindowSurfels> = (0..windows.len() * points.sensors)
            .into_par_iter()
            .map_init(Workspace::default, |workspace, part| {
                let (window, sensor) = (windows[part / points.sensors], part % points.sensors);
                workspace.take(points, points.between(window), sensor, selection);
                workspace.extract(&points.corrections, sensor, trajectory, &matrices)
            })
            .collect();
        let mut map = Self::default();
        for (number, part) in parts.into_iter().enumerate() {
            let number = number / points.sensors;
            let (first_surfel, first_cluster) = (map.surfels.len(), map.clusters.len() as u32);
            map.surfels.extend(part.surfels.into_iter().map(|mut surfel| {
                surfel.first_cluster += first_cluster;
                surfel
            }));
            map.clusters.extend(part.clusters);
            map.looked_at += part.looked_at;
            map.windows.push(Window { number, surfels: first_surfel..map.surfels.len() });
        }
        map
    }
}

#[derive(Default)]
struct WindowSurfels {
    surfels: Vec<Surfel>,
    clusters: Vec<Cluster>,
    looked_at: usize,
}

/// A planar cell, possibly joined with a neighbour.
struct Patch {
    fit: PlaneFit,
    moments: Moments,
    level: usize,
    key: Key,
    /// Itself, or the patch it was joined with.
    root: u32,
}

/// Memory that is reused from window to window.
#[derive(Default)]
struct Workspace {
    /// Times, and positions in the tracking frame.
    points: Vec<(f64, [f32; 3])>,
    cells: Cells,
    parents: Cells,
    in_world: Vec<[f64; 3]>,
    cell_of_point: Vec<u32>,
    patch_of_cell: Vec<u32>,
    patch_of_point: Vec<u32>,
    patches: Vec<Patch>,
}

impl Workspace {
    /// Takes the selected points of a sensor.
    fn take(&mut self, points: &TimedPoints, seen: &[StoredPoint], sensor: usize, selection: Selection) {
        self.points.clear();
        let is_wanted =
            |p: &&StoredPoint| p.sensor() == sensor && selection.contains(points.seconds(p), p.in_tracking);
        let own = seen.iter().filter(is_wanted);
        self.points.extend(own.map(|point| points.place(point)));
    }

    fn extract(
        &mut self,
        corrections: &Corrections,
        sensor: usize,
        trajectory: &DenseTrajectory,
        matrices: &PoseMatrices,
    ) -> WindowSurfels {
        let Some(middle) = self.points.get(self.points.len() / 2) else { return WindowSurfels::default() };
        // Near the window, so that squares keep their digits; on the grid, so that cells of all windows
        // coincide.
        let coarsest = FINEST_CELL * f64::from(1 << (LEVELS - 1));
        let place = trajectory.pose(middle.0).translation.vector;
        let origin = place.map(|v| (v / coarsest).round() * coarsest);
        self.fill_cells(matrices, &origin);
        self.find_patches();
        self.join_neighbours();
        self.assign_points();
        let mut found = self.surfels(trajectory, &origin);
        for surfel in &mut found.surfels {
            surfel.sensor = sensor as u8;
            let (seconds, mean) = corrections.uncorrected(sensor, surfel.seconds, &surfel.mean_in_tracking);
            (surfel.seconds, surfel.mean_in_tracking) = (seconds, mean);
            surfel.normal_in_tracking = corrections.uncorrected_direction(sensor, &surfel.normal_in_tracking);
        }
        for cluster in &mut found.clusters {
            let at = Vector3::from(cluster.in_tracking.map(f64::from));
            let (seconds, at) = corrections.uncorrected(sensor, cluster.seconds, &at);
            cluster.seconds = seconds;
            cluster.in_tracking = [at.x as f32, at.y as f32, at.z as f32];
        }
        found
    }

    fn fill_cells(&mut self, matrices: &PoseMatrices, origin: &Vector3) {
        self.cells.clear();
        self.in_world.clear();
        self.cell_of_point.clear();
        for (seconds, in_tracking) in &self.points {
            let world = matrices.to_world(*seconds, *in_tracking);
            let p = Vector3::from(world) - origin;
            let key = [p.x, p.y, p.z].map(|v| (v * (1.0 / FINEST_CELL)).floor() as i32);
            let cell = self.cells.cell(key);
            self.cells.moments[cell].add(&p);
            self.in_world.push([p.x, p.y, p.z]);
            self.cell_of_point.push(cell as u32);
        }
    }

    /// From the largest cells to the smallest: a planar cell that is not yet part of a patch becomes one.
    fn find_patches(&mut self) {
        self.patches.clear();
        self.patch_of_cell.clear();
        self.patch_of_cell.resize(self.cells.keys.len(), NONE);
        let mut parent_of_cell = Vec::with_capacity(self.cells.keys.len());
        for level in (0..LEVELS).rev() {
            self.parents.clear();
            parent_of_cell.clear();
            for (cell, key) in self.cells.keys.iter().enumerate() {
                let parent = self.parents.cell(key.map(|k| k >> level));
                if self.patch_of_cell[cell] == NONE {
                    self.parents.moments[parent].merge(&self.cells.moments[cell]);
                }
                parent_of_cell.push(parent);
            }
            let patch_of_parent: Vec<u32> = (0..self.parents.keys.len())
                .map(|parent| {
                    let moments = self.parents.moments[parent];
                    let Some(fit) = planar(&moments, level) else { return NONE };
                    let root = self.patches.len() as u32;
                    let key = self.parents.keys[parent];
                    self.patches.push(Patch { fit, moments, level, key, root });
                    root
                })
                .collect();
            for (cell, parent) in parent_of_cell.iter().enumerate() {
                if self.patch_of_cell[cell] == NONE {
                    self.patch_of_cell[cell] = patch_of_parent[*parent];
                }
            }
        }
    }

    /// Joins patches across the border of two cells: a wall on the border is half in each cell, and each half
    /// would have a mean and a thickness of its own.
    fn join_neighbours(&mut self) {
        for i in 0..self.patches.len() {
            let Patch { level, key, root, .. } = self.patches[i];
            let normal = self.patches[i].fit.normal;
            let axis = normal.iamax();
            let mut beside = key.map(|k| k << level);
            beside[axis] += 1 << level;
            let Some(other) = self.patch_near(&beside, level, axis) else { continue };
            if other == root || self.patches[other as usize].fit.normal.dot(&normal).abs() < 0.95 {
                continue;
            }
            let mut moments = self.patches[root as usize].moments;
            moments.merge(&self.patches[other as usize].moments);
            if let Some(fit) = planar(&moments, level) {
                let (low, high) = (root.min(other), root.max(other));
                self.patches[low as usize].moments = moments;
                self.patches[low as usize].fit = fit;
                for patch in &mut self.patches {
                    if patch.root == high {
                        patch.root = low;
                    }
                }
            }
        }
    }

    /// A patch of the same level in the cell whose lowest finest cell is `key`.
    fn patch_near(&self, key: &Key, level: usize, axis: usize) -> Option<u32> {
        let side = 1 << level;
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        // Only the layer next to the border is searched.
        for a in 0..side {
            for b in 0..side {
                let mut cell = *key;
                cell[u] += a;
                cell[v] += b;
                let patch = self.cells.find(&cell).map_or(NONE, |c| self.patch_of_cell[c]);
                if patch != NONE && self.patches[patch as usize].level == level {
                    return Some(self.patches[patch as usize].root);
                }
            }
        }
        None
    }

    /// Assigns each point to the patch of its cell, or to that of the cell beyond the nearest border, if it
    /// is within the thickness of that patch.
    fn assign_points(&mut self) {
        self.patch_of_point.clear();
        for (p, cell) in self.in_world.iter().zip(&self.cell_of_point) {
            let point = Vector3::from(*p);
            let own = self.belonging(self.patch_of_cell[*cell as usize], &point);
            let patch = own.or_else(|| {
                let key = self.cells.keys[*cell as usize];
                (0..3).find_map(|axis| {
                    let within = p[axis] - f64::from(key[axis]) * FINEST_CELL;
                    let step = if within < 0.25 * FINEST_CELL {
                        -1
                    } else if within > 0.75 * FINEST_CELL {
                        1
                    } else {
                        return None;
                    };
                    let mut beside = key;
                    beside[axis] += step;
                    let patch = self.patch_of_cell[self.cells.find(&beside)?];
                    let found = self.belonging(patch, &point)?;
                    // Only across the patch: beyond its edges a patch does not continue.
                    (self.patches[found as usize].fit.normal.iamax() == axis).then_some(found)
                })
            });
            self.patch_of_point.push(patch.unwrap_or(NONE));
        }
    }

    fn belonging(&self, patch: u32, point: &Vector3) -> Option<u32> {
        let root = self.patches.get(patch as usize)?.root;
        let fit = &self.patches[root as usize].fit;
        let gate = GATE * fit.variances[0].sqrt().max(LEAST_DEVIATION);
        (fit.normal.dot(&(point - fit.mean)).abs() < gate).then_some(root)
    }

    fn surfels(&mut self, trajectory: &DenseTrajectory, origin: &Vector3) -> WindowSurfels {
        let mut moments = vec![Moments::default(); self.patches.len()];
        let mut seconds = vec![0.0; self.patches.len()];
        for (i, patch) in self.patch_of_point.iter().enumerate().filter(|(_, p)| **p != NONE) {
            moments[*patch as usize].add(&Vector3::from(self.in_world[i]));
            seconds[*patch as usize] += self.points[i].0;
        }
        let mut result = WindowSurfels { looked_at: self.points.len(), ..WindowSurfels::default() };
        let mut surfel_of_patch = vec![NONE; self.patches.len()];
        for (i, (moments, seconds)) in moments.iter().zip(&seconds).enumerate() {
            let Some(fit) = planar(moments, self.patches[i].level) else { continue };
            let seconds = seconds / moments.count;
            let world_from_tracking = trajectory.pose(seconds);
            let mean = fit.mean + origin;
            let to_sensor = world_from_tracking.translation.vector - mean;
            let incidence = fit.normal.dot(&to_sensor) / to_sensor.norm().max(1e-9);
            if incidence.abs() < LEAST_INCIDENCE {
                continue;
            }
            surfel_of_patch[i] = result.surfels.len() as u32;
            let tracking_from_world = world_from_tracking.inverse();
            result.surfels.push(Surfel {
                sensor: 0,
                seconds,
                mean_in_tracking: (tracking_from_world * na::Point3::from(mean)).coords,
                normal_in_tracking: tracking_from_world.rotation * (fit.normal * incidence.signum()),
                count: moments.count,
                variance: fit.variances[0],
                first_cluster: 0,
                cluster_count: 0,
            });
        }
        for patch in &mut self.patch_of_point {
            *patch = surfel_of_patch.get(*patch as usize).copied().unwrap_or(NONE);
        }
        self.clusters(trajectory, origin, &mut result);
        result
    }

    /// Clusters, in order of surfel and time.
    fn clusters(&self, trajectory: &DenseTrajectory, origin: &Vector3, result: &mut WindowSurfels) {
        #[derive(Clone, Copy)]
        struct Open {
            bin: i64,
            sum: [f64; 3],
            seconds: f64,
            count: f64,
        }
        let mut open =
            vec![Open { bin: i64::MIN, sum: [0.0; 3], seconds: 0.0, count: 0.0 }; result.surfels.len()];
        let mut closed: Vec<(u32, Cluster)> = Vec::new();
        let mut close = |surfel: u32, o: &Open| {
            let seconds = o.seconds / o.count;
            let mean = Vector3::from(o.sum) / o.count + origin;
            let world_from_tracking: Rigid3 = trajectory.pose(seconds);
            let local = world_from_tracking.inverse_transform_point(&na::Point3::from(mean));
            let in_tracking = [local.x as f32, local.y as f32, local.z as f32];
            closed.push((surfel, Cluster { seconds, in_tracking, count: o.count as f32 }));
        };
        for (i, surfel) in self.patch_of_point.iter().enumerate().filter(|(_, s)| **s != NONE) {
            let seconds = self.points[i].0;
            let bin = (seconds / CLUSTER_SECONDS).floor() as i64;
            let o = &mut open[*surfel as usize];
            if o.bin != bin {
                if o.count > 0.0 {
                    close(*surfel, o);
                }
                *o = Open { bin, sum: [0.0; 3], seconds: 0.0, count: 0.0 };
            }
            for (sum, v) in o.sum.iter_mut().zip(self.in_world[i]) {
                *sum += v;
            }
            o.seconds += seconds;
            o.count += 1.0;
        }
        for (surfel, o) in open.iter().enumerate().filter(|(_, o)| o.count > 0.0) {
            close(surfel as u32, o);
        }
        closed.sort_by_key(|(surfel, _)| *surfel);
        for (i, (surfel, cluster)) in closed.into_iter().enumerate() {
            let surfel = &mut result.surfels[surfel as usize];
            if surfel.cluster_count == 0 {
                surfel.first_cluster = i as u32;
            }
            surfel.cluster_count += 1;
            result.clusters.push(cluster);
        }
    }
}

/// The plane of a cell of a level, if its points extend in two directions and are thin in the third.
fn planar(moments: &Moments, level: usize) -> Option<PlaneFit> {
    if moments.count < MIN_POINTS {
        return None;
    }
    let edge = FINEST_CELL * f64::from(1 << level);
    let thickest = (0.08 * edge).clamp(0.04, 0.06);
    let fit = moments.plane()?;
    let [across, middle, _] = fit.variances;
    (across < thickest * thickest && middle > (0.1 * edge).powi(2) && across < 0.15 * middle).then_some(fit)
}
