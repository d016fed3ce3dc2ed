//! Submaps in 3D: a fine and a coarse grid, and a histogram of wall directions (`slam3d.md` §5).

use std::borrow::BorrowMut;
use std::sync::Arc;

use portolan_config::Submaps3dOptions;
use portolan_geometry::{Point3f, Quaternion, Rigid3, to_f32, yaw};
use portolan_grids::{
    GridError, HybridGrid, HybridInserter, HybridInserterOptions, InserterOptionError, IntensityGrid,
};
use portolan_lidar_odometry::{Later, PlaneMap, both};
use portolan_matching::rotate_histogram;
use portolan_sensor::RangeData;

use crate::GrowingSubmap;

/// Makes empty submaps and inserts scans into them, by these options.
#[derive(Debug)]
pub struct Inserter3d {
    inserter: HybridInserter,
    high_resolution: f32,
    high_resolution_max_range: f32,
    low_resolution: f32,
    histogram_size: usize,
    use_intensities: bool,
    draws_late: bool,
}

impl Inserter3d {
    /// By these options; histograms have `histogram_size` buckets.
    ///
    /// # Errors
    /// If a probability is on the wrong side of one half.
    pub fn new(
        options: &Submaps3dOptions,
        histogram_size: usize,
        use_intensities: bool,
    ) -> Result<Self, InserterOptionError> {
        let o = &options.range_data_inserter;
        let inserter = HybridInserter::new(&HybridInserterOptions {
            hit_probability: o.hit_probability,
            miss_probability: o.miss_probability,
            num_free_space_voxels: u32::try_from(o.num_free_space_voxels).unwrap_or(u32::MAX),
            intensity_threshold: o.intensity_threshold,
        })?;
        Ok(Self {
            inserter,
            high_resolution: options.high_resolution as f32,
            high_resolution_max_range: options.high_resolution_max_range as f32,
            low_resolution: options.low_resolution as f32,
            histogram_size,
            use_intensities,
            draws_late: false,
        })
    }

    /// Delays inserting into growing grids until they are needed: nothing reads them while sweeps are
    /// registered to planes.
    #[must_use]
    pub fn drawing_late(self) -> Self {
        Self { draws_late: true, ..self }
    }

    /// Inserts scans, given in the frame of a submap, into its fine and its coarse grid.
    fn draw<G: BorrowMut<HybridGrid> + Send>(&self, scans: &[RangeData], grids: &mut [G; 2]) {
        let points = scans.iter().map(|scan| scan.returns.len()).sum();
        let [high, low] = grids;
        both(
            points,
            || self.inserter.insert_all(scans, self.high_resolution_max_range, high.borrow_mut()),
            || self.inserter.insert_all(scans, f32::INFINITY, low.borrow_mut()),
        );
    }
}

/// A scan as it is inserted into submaps.
#[derive(Clone, Debug)]
pub struct Scan3d {
    /// In the local map.
    pub range_data_in_local: RangeData,
    /// Directions of walls in the gravity-aligned frame of the node.
    pub rotational_histogram: Vec<f32>,
    /// Rotation from that frame to the local map.
    pub local_from_gravity_aligned: Quaternion,
}

/// Planes made of the points of nodes and the cells of grids.
#[derive(Clone, Debug)]
pub struct MadePlanes {
    /// In the frame of the submap.
    pub planes: PlaneMap,
    /// Fractions of scans that they explain, where there are enough scans to determine them.
    pub explained: Option<ExplainedByPlanes>,
}

/// Medians of the fraction of the points of scans that are on planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExplainedByPlanes {
    /// Of scans that are not part of the planes, at their poses.
    pub where_taken: f32,
    /// Of scans at wrong places.
    pub by_chance: f32,
}

/// Grids in 3D with their pose in the local map. The frame of a submap is level; its origin is the position
/// of its first scan.
#[derive(Clone, Debug)]
pub struct Submap3d {
    /// Pose in the local map.
    pub local_from_submap: Rigid3,
    /// Scans inserted.
    pub num_range_data: u32,
    /// Whether no scan will be inserted any more.
    pub insertion_finished: bool,
    /// Fine cells near the positions of the scans.
    pub high_resolution_grid: HybridGrid,
    /// Coarse cells of everything seen.
    pub low_resolution_grid: HybridGrid,
    /// Intensities of the fine cells, while the submap grows and if they are used.
    pub intensity_grid: Option<IntensityGrid>,
    /// Directions of walls in the frame of the submap, summed over all scans.
    pub rotational_histogram: Vec<f32>,
    /// Planes of a complete submap, if sweeps are registered to planes.
    pub planes: Option<PlaneMap>,
    /// Planes made of the contents of a file, if it does not keep the planes that sweeps were registered to.
    pub made_planes: Option<MadePlanes>,
    /// Scans that could not be inserted because they were too far from the origin of the submap.
    pub refused_scans: u32,
    inserter: Option<Arc<Inserter3d>>,
    /// Scans that are not in the grids yet, in the frame of the submap. Inserting many at once takes less
    /// time, because each place in memory is then visited once.
    waiting: Vec<RangeData>,
    /// The fine and the coarse grid while another thread inserts into them; empty ones are in their place.
    drawing: Option<Later<[HybridGrid; 2]>>,
}

/// Maximum number of points that wait in memory; then they are inserted at once.
const MOST_WAITING_POINTS: usize = 120_000;

impl Submap3d {
    /// The planes that scans are registered to: those that sweeps were registered to, or else those made of
    /// the contents of a file.
    pub fn planes_to_match(&self) -> Option<&PlaneMap> {
        self.planes.as_ref().or(self.made_planes.as_ref().map(|made| &made.planes))
    }

    /// An empty submap at an origin in the local map, with the axes of a scan's gravity-aligned frame.
    ///
    /// # Errors
    /// If a resolution is not positive and finite.
    pub fn new(
        origin_in_local: Point3f,
        local_from_gravity_aligned: Quaternion,
        inserter: &Arc<Inserter3d>,
    ) -> Result<Self, GridError> {
        let intensity_grid =
            inserter.use_intensities.then(|| IntensityGrid::new(inserter.high_resolution)).transpose()?;
        let origin = origin_in_local.coords.cast::<f64>();
        Ok(Self {
            local_from_submap: Rigid3::from_parts(origin.into(), local_from_gravity_aligned),
            num_range_data: 0,
            insertion_finished: false,
            high_resolution_grid: HybridGrid::new(inserter.high_resolution)?,
            low_resolution_grid: HybridGrid::new(inserter.low_resolution)?,
            intensity_grid,
            rotational_histogram: vec![0.0; inserter.histogram_size],
            planes: None,
            made_planes: None,
            refused_scans: 0,
            inserter: Some(Arc::clone(inserter)),
            waiting: Vec::new(),
            drawing: None,
        })
    }

    /// Inserts a scan, given in the frame of the submap, into the grids; or keeps it until they are needed,
    /// or another thread has time. False if that is impossible.
    fn insert_into_grids(&mut self, scan: RangeData, inserter: &Arc<Inserter3d>) -> bool {
        let grids = [&self.high_resolution_grid, &self.low_resolution_grid];
        if grids.iter().any(|grid| grid.cell_index(&scan.origin).is_none()) {
            return false;
        }
        if let Some(intensities) = &mut self.intensity_grid {
            inserter.inserter.insert_intensities(&scan, inserter.high_resolution_max_range, intensities);
        }
        self.waiting.push(scan);
        let waiting_points: usize = self.waiting.iter().map(|scan| scan.returns.len()).sum();
        if !inserter.draws_late {
            self.draw_grids();
        } else if waiting_points >= MOST_WAITING_POINTS {
            self.draw_grids_in_background(inserter);
        }
        true
    }

    /// Lets another thread insert the waiting scans into the grids.
    fn draw_grids_in_background(&mut self, inserter: &Arc<Inserter3d>) {
        let (scans, inserter) = (std::mem::take(&mut self.waiting), Arc::clone(inserter));
        let grids = || {
            let grids = [&mut self.high_resolution_grid, &mut self.low_resolution_grid];
            Later::new(grids.map(|grid| std::mem::replace(grid, grid.emptied())))
        };
        self.drawing.get_or_insert_with(grids).change(move |grids| inserter.draw(&scans, grids));
    }

    /// Inserts the waiting scans into the grids.
    pub fn draw_grids(&mut self) {
        let mut grids = [&mut self.high_resolution_grid, &mut self.low_resolution_grid];
        if let Some(drawing) = self.drawing.take() {
            for (grid, drawn) in grids.iter_mut().zip(drawing.now().iter_mut()) {
                std::mem::swap(*grid, drawn);
            }
        }
        let scans = std::mem::take(&mut self.waiting);
        if let Some(inserter) = &self.inserter {
            inserter.draw(&scans, &mut grids);
        }
    }

    /// A submap from a file.
    pub fn from_parts(
        local_from_submap: Rigid3,
        num_range_data: u32,
        finished: bool,
        [high_resolution_grid, low_resolution_grid]: [HybridGrid; 2],
        rotational_histogram: Vec<f32>,
    ) -> Self {
        Self {
            local_from_submap,
            num_range_data,
            insertion_finished: finished,
            high_resolution_grid,
            low_resolution_grid,
            intensity_grid: None,
            rotational_histogram,
            planes: None,
            made_planes: None,
            refused_scans: 0,
            inserter: None,
            waiting: Vec::new(),
            drawing: None,
        }
    }
}

impl GrowingSubmap for Submap3d {
    type Scan = Scan3d;

    fn local_from_submap(&self) -> Rigid3 {
        self.local_from_submap
    }

    fn num_range_data(&self) -> u32 {
        self.num_range_data
    }

    fn scan_origin_in_local(scan: &Scan3d) -> Point3f {
        scan.range_data_in_local.origin
    }

    fn insert(&mut self, scan: &Scan3d) -> bool {
        let Some(inserter) = self.inserter.clone() else { return true };
        let submap_from_local = self.local_from_submap.inverse();
        let data = scan.range_data_in_local.transformed(&to_f32(&submap_from_local));
        let drawn = self.insert_into_grids(data, &inserter);
        self.refused_scans += u32::from(!drawn);
        let turn = yaw(&(submap_from_local.rotation * scan.local_from_gravity_aligned)) as f32;
        let turned = rotate_histogram(&scan.rotational_histogram, turn);
        self.rotational_histogram.iter_mut().zip(turned).for_each(|(sum, value)| *sum += value);
        self.num_range_data += 1;
        drawn
    }

    fn finish(&mut self) {
        self.draw_grids();
        self.high_resolution_grid = self.high_resolution_grid.compacted();
        self.low_resolution_grid = self.low_resolution_grid.compacted();
        self.intensity_grid = None;
        self.insertion_finished = true;
        self.inserter = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::rotation_from_roll_pitch_yaw;
    use portolan_sensor::PointCloud;

    #[test]
    fn scans_are_drawn_in_the_frame_of_the_submap() {
        let options = Submaps3dOptions { high_resolution_max_range: 4.0, ..Default::default() };
        let inserter = Arc::new(Inserter3d::new(&options, 4, true).unwrap());
        let turn = rotation_from_roll_pitch_yaw(0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let mut submap = Submap3d::new(Point3f::new(10.0, 0.0, 1.0), turn, &inserter).unwrap();
        let scan = Scan3d {
            range_data_in_local: RangeData {
                origin: Point3f::new(10.0, 0.0, 1.0),
                returns: PointCloud {
                    points: vec![Point3f::new(10.0, 3.0, 1.0), Point3f::new(10.0, -9.0, 1.0)],
                    intensities: vec![7.0, 8.0],
                },
                misses: PointCloud::default(),
            },
            rotational_histogram: vec![1.0, 2.0, 3.0, 4.0],
            local_from_gravity_aligned: Quaternion::identity(),
        };
        submap.insert(&scan);
        submap.insert(&scan);
        submap.draw_grids();
        assert_eq!((submap.num_range_data, submap.refused_scans), (2, 0));
        assert!(submap.high_resolution_grid.probability([30, 0, 0]) > 0.55);
        assert!(!submap.high_resolution_grid.is_known([-90, 0, 0]), "too far");
        assert!(submap.low_resolution_grid.probability([-20, 0, 0]) > 0.55);
        assert_eq!(submap.intensity_grid.as_ref().unwrap().intensity([30, 0, 0]), 7.0);
        // Rotated back by a quarter of a turn: two of four buckets over half a turn.
        let expected = [6.0, 8.0, 2.0, 4.0];
        assert!(submap.rotational_histogram.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4));
        let before = submap.high_resolution_grid.clone();
        submap.finish();
        assert!(submap.insertion_finished && submap.intensity_grid.is_none());
        assert_eq!(submap.high_resolution_grid, before);
        submap.insert(&scan);
        assert_eq!(submap.num_range_data, 2, "finished");
    }
}
