//! Submaps in 2D (`slam2d.md` §11).

use std::sync::Arc;

use portolan_config::{GridType2d, RangeDataInserterType2d, Submaps2dOptions};
use portolan_geometry::{Point3f, Rigid3, Vector2, to_f32};
use portolan_grids::{
    Grid2d, GridError, InsertReport, InserterOptionError, MapLimits, NormalEstimationOptions,
    ProbabilityGrid, ProbabilityInserter, ProbabilityInserterOptions, SectorInserter, Tsdf2d, TsdfInserter,
    TsdfInserterOptions,
};
use portolan_sensor::RangeData;

use crate::GrowingSubmap;

/// Makes empty submaps and inserts scans into them, by these options.
#[derive(Debug)]
pub enum Inserter2d {
    /// Into grids of probabilities: scan by scan while mapping, and once more when the map is finished.
    Probability(ProbabilityInserter, SectorInserter),
    /// Into grids of signed distances.
    Tsdf(TsdfInserter, TsdfInserterOptions),
}

impl Inserter2d {
    /// By the options of the grid and of its inserter. `join_surfaces`: in grids of probabilities the
    /// surface between neighbouring returns is inserted, too.
    ///
    /// # Errors
    /// If a probability, length or weight is outside of its range.
    pub fn new(options: &Submaps2dOptions, join_surfaces: bool) -> Result<Self, InserterOptionError> {
        let inserter = &options.range_data_inserter;
        match (options.grid_options_2d.grid_type, inserter.range_data_inserter_type) {
            (GridType2d::Tsdf, _) | (_, RangeDataInserterType2d::Tsdf) => {
                let o = &inserter.tsdf_range_data_inserter;
                let options = TsdfInserterOptions {
                    truncation_distance: o.truncation_distance,
                    maximum_weight: o.maximum_weight,
                    update_free_space: o.update_free_space,
                    normal_estimation: NormalEstimationOptions {
                        num_normal_samples: o.normal_estimation_options.num_normal_samples,
                        sample_radius: f64::from(o.normal_estimation_options.sample_radius),
                    },
                    project_sdf_distance_to_scan_normal: o.project_sdf_distance_to_scan_normal,
                    update_weight_range_exponent: o.update_weight_range_exponent,
                    update_weight_angle_scan_normal_to_ray_kernel_bandwidth: o
                        .update_weight_angle_scan_normal_to_ray_kernel_bandwidth,
                    update_weight_distance_cell_to_hit_kernel_bandwidth: o
                        .update_weight_distance_cell_to_hit_kernel_bandwidth,
                    ..TsdfInserterOptions::default()
                };
                Ok(Self::Tsdf(TsdfInserter::new(&options)?, options))
            }
            _ => {
                let o = &inserter.probability_grid_range_data_inserter;
                let options = ProbabilityInserterOptions {
                    hit_probability: o.hit_probability,
                    miss_probability: o.miss_probability,
                    insert_free_space: o.insert_free_space,
                    join_surfaces,
                    ..ProbabilityInserterOptions::default()
                };
                Ok(Self::Probability(ProbabilityInserter::new(&options)?, SectorInserter::new(&options)?))
            }
        }
    }

    fn empty_grid(&self, limits: MapLimits) -> Result<Grid2d, GridError> {
        Ok(match self {
            Self::Probability(..) => Grid2d::Probability(ProbabilityGrid::new(limits)),
            Self::Tsdf(_, options) => Grid2d::Tsdf(Tsdf2d::new(
                limits,
                options.truncation_distance as f32,
                options.maximum_weight as f32,
            )?),
        })
    }

    fn insert(&self, scan: &RangeData, grid: &mut Grid2d) -> Result<InsertReport, GridError> {
        match (self, grid) {
            (Self::Probability(inserter, _), Grid2d::Probability(grid)) => inserter.insert(scan, grid),
            (Self::Tsdf(inserter, _), Grid2d::Tsdf(grid)) => inserter.insert(scan, grid),
            _ => Ok(InsertReport::default()),
        }
    }

    /// Inserts a scan whose beams represent sectors, `beam_spacing` radians wide. Grids of signed distances
    /// support rays only.
    fn insert_sectors(
        &self,
        scan: &RangeData,
        beam_spacing: f32,
        grid: &mut Grid2d,
    ) -> Result<InsertReport, GridError> {
        match (self, grid) {
            (Self::Probability(_, inserter), Grid2d::Probability(grid)) => {
                inserter.insert(scan, beam_spacing, grid)
            }
            (_, grid) => self.insert(scan, grid),
        }
    }
}

/// A grid with its pose in the local map. Its cells are aligned with the axes of the local map: the pose is a
/// mere translation, to the origin of the first scan.
#[derive(Clone, Debug)]
pub struct Submap2d {
    /// Pose in the local map.
    pub local_from_submap: Rigid3,
    /// Scans inserted.
    pub num_range_data: u32,
    /// Whether no scan will be inserted any more.
    pub insertion_finished: bool,
    /// The cells, addressed in the local map.
    pub grid: Grid2d,
    /// Scans that could not be inserted because the grid would have become too large.
    pub refused_scans: u32,
    inserter: Option<Arc<Inserter2d>>,
}

impl Submap2d {
    /// An empty submap at an origin in the local map.
    ///
    /// # Errors
    /// If the origin or the resolution is not finite, or the resolution not positive.
    pub fn new(
        origin_in_local: Point3f,
        resolution: f64,
        inserter: &Arc<Inserter2d>,
    ) -> Result<Self, GridError> {
        let (x, y) = (f64::from(origin_in_local.x), f64::from(origin_in_local.y));
        Ok(Self {
            local_from_submap: Rigid3::translation(x, y, 0.0),
            num_range_data: 0,
            insertion_finished: false,
            grid: inserter.empty_grid(MapLimits::around(resolution, Vector2::new(x, y))?)?,
            refused_scans: 0,
            inserter: Some(Arc::clone(inserter)),
        })
    }

    /// A submap from a file.
    pub fn from_parts(local_from_submap: Rigid3, num_range_data: u32, finished: bool, grid: Grid2d) -> Self {
        Self {
            local_from_submap,
            num_range_data,
            insertion_finished: finished,
            grid,
            refused_scans: 0,
            inserter: None,
        }
    }

    /// The submap made again from scans in the local map, each with the spacing of its beams in radians; none
    /// if it came from a file, or the grid would become too large.
    pub fn drawn_from(&self, scans: Vec<(RangeData, f32)>) -> Option<Self> {
        let inserter = self.inserter.as_ref()?;
        let origin = to_f32(&self.local_from_submap).translation.vector;
        let mut redrawn = Self::new(origin.into(), self.grid.limits().resolution(), inserter).ok()?;
        for (scan, beam_spacing) in &scans {
            inserter.insert_sectors(scan, *beam_spacing, &mut redrawn.grid).ok()?;
            redrawn.num_range_data += 1;
        }
        if self.insertion_finished {
            redrawn.finish();
        }
        Some(redrawn)
    }
}

impl GrowingSubmap for Submap2d {
    type Scan = RangeData;

    fn local_from_submap(&self) -> Rigid3 {
        self.local_from_submap
    }

    fn num_range_data(&self) -> u32 {
        self.num_range_data
    }

    fn scan_origin_in_local(scan: &RangeData) -> Point3f {
        scan.origin
    }

    fn insert(&mut self, scan: &RangeData) -> bool {
        let drawn = self.inserter.as_ref().is_none_or(|i| i.insert(scan, &mut self.grid).is_ok());
        self.refused_scans += u32::from(!drawn);
        self.num_range_data += 1;
        drawn
    }

    fn finish(&mut self) {
        self.grid = self.grid.cropped();
        self.insertion_finished = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_config::Options;
    use portolan_geometry::Rigid3f;
    use portolan_sensor::PointCloud;

    /// Scan at x in a room of 4 m by 2 m.
    fn scan(x: f32) -> RangeData {
        let ray = |i: u16| {
            let (sin, cos) = f32::from(i).to_radians().sin_cos();
            let along = if cos > 0.0 { (4.0 - x) / cos } else { -x / cos };
            let range = along.min(1.0 / sin.abs());
            Point3f::new(x + range * cos, range * sin, 0.0)
        };
        let returns = PointCloud::new((0..360).map(ray).collect());
        RangeData { origin: Point3f::new(x, 0.0, 0.0), returns, misses: PointCloud::default() }
    }

    fn submap(scans: &[RangeData]) -> Submap2d {
        let options = &Options::default().trajectory_builder.trajectory_builder_2d.submaps;
        let inserter = Arc::new(Inserter2d::new(options, false).unwrap());
        let mut submap = Submap2d::new(Point3f::new(1.0, 0.0, 0.0), 0.05, &inserter).unwrap();
        scans.iter().for_each(|scan| assert!(submap.insert(scan)));
        submap.finish();
        submap
    }

    #[test]
    fn a_submap_is_redrawn_at_the_final_poses_of_its_scans() {
        let right = [scan(1.0), scan(2.0)];
        let wrong = [scan(1.0), scan(2.0).transformed(&Rigid3f::translation(0.3, 0.0, 0.0))];
        let wrong = submap(&wrong);
        let spaced = |scans: &[RangeData]| scans.iter().map(|s| (s.clone(), 0.0)).collect::<Vec<_>>();
        let redrawn = wrong.drawn_from(spaced(&right)).unwrap();
        assert_ne!(wrong.grid, redrawn.grid);
        assert_eq!(redrawn.grid, submap(&right).grid);
        assert_eq!(redrawn.local_from_submap, wrong.local_from_submap);
        assert_eq!(wrong.drawn_from(spaced(&right[..1])).unwrap().num_range_data, 1);
        let loaded = Submap2d::from_parts(Rigid3::identity(), 2, true, redrawn.grid);
        assert!(loaded.drawn_from(spaced(&right)).is_none(), "it came from a file");
    }
}
