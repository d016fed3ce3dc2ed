//! Draws X-rays of a map in 3D from three sides, and a coloured section.

use std::path::PathBuf;

use portolan_export::{CloudSample, Extent, TrajectoryLine, XrayPicture, XrayView, write_picture};
use portolan_geometry::{Rigid3, Time};
use portolan_ingest::SensorPlan;
use portolan_pointcloud::{CloudError, OccupiedVoxels, ThinnedCloud};
use portolan_reprojection::{KeptScans, SmoothMotion};

use super::error::JobError;
use super::event::{Event, Observer};
use super::output_folder::OutputFolder;
use crate::pipeline::Preparation;

/// Approximate number of voxels along the longest edge.
const VOXELS_ALONG: f64 = 1500.0;
/// Bounds of the edge of a voxel, metres.
const VOXEL_SIZES: std::ops::RangeInclusive<f64> = 0.03..=0.5;
/// Largest edge of a picture, pixels.
const MAX_EDGE: usize = 2400;
/// Thickness of the section, metres.
const SECTION: f64 = 1.5;
/// Fraction of the points that may be outside of a picture, on either side: reflections in glass, far trees.
const OUTLIERS: f64 = 0.001;
/// The same for the section.
const OUTLIERS_OF_SECTION: f64 = 0.01;
/// Width of the strips from which the section is chosen, metres: the one with most of the trajectory.
const STRIP: f64 = 0.5;

/// Edge of the cubes, in voxels, of which one point each determines the extent and the axes of the map.
const SAMPLED: f64 = 4.0;
/// Stride of the points of each scan that are used for that.
const EVERY_SAMPLED: usize = 5;

/// Source of the points that are drawn.
pub(super) enum Points<'a> {
    /// Scans that mapping kept, and the motion by the final trajectory.
    Kept(&'a KeptScans, &'a SmoothMotion),
    /// One point for each voxel of a second reading.
    Thinned(ThinnedCloud),
}

/// Reasons why there are no pictures.
pub(super) enum NotDrawn {
    /// The points could not be read.
    Points(CloudError),
    /// The scans that were kept could not be read.
    Kept(std::io::Error),
    /// The user interrupted the drawing.
    Interrupted,
    /// The pictures could not be made or written.
    Failed(JobError),
}

impl From<CloudError> for NotDrawn {
    fn from(error: CloudError) -> Self {
        Self::Points(error)
    }
}

impl Points<'_> {
    /// Visits all points with their times, seconds since 1970, or every `every`-th if there are scans. May be
    /// called again.
    fn for_each(
        &mut self,
        every: usize,
        observe: &mut Observer,
        mut visit: impl FnMut([f64; 3], f64),
    ) -> Result<(), NotDrawn> {
        match self {
            Self::Kept(scans, motion) => {
                let reprojected = scans.reproject(motion, every, &mut |points| {
                    points.iter().for_each(|p| visit(p.position, p.time));
                    observe(&Event::Drawing).is_continue()
                });
                let reprojected = reprojected.map_err(NotDrawn::Kept)?;
                if reprojected.interrupted { Err(NotDrawn::Interrupted) } else { Ok(()) }
            }
            Self::Thinned(cloud) => Ok(cloud.for_each(&mut |voxel| {
                visit(voxel.position, voxel.time);
                Ok(())
            })?),
        }
    }
}

/// Trajectory and resolution of the pictures.
pub(super) struct Request {
    path: Vec<(Time, [f64; 3])>,
    /// Size of the voxels to gather points in, metres.
    pub voxel_size: f64,
}

/// Directions of the views, and the place of the section.
struct Views {
    views: [(&'static str, &'static str, XrayView); 3],
    /// Direction of the depth of the section.
    depth: XrayView,
    /// Middle of the section in its depth.
    middle: f64,
}

impl Request {
    /// For a trajectory and the sensors that measured the map.
    pub fn new(poses: &[(Time, Rigid3)], plan: &SensorPlan, preparation: &Preparation) -> Self {
        let path: Vec<(Time, [f64; 3])> =
            poses.iter().map(|(time, pose)| (*time, pose.translation.vector.into())).collect();
        let reach = plan.range.iter().map(|r| r.statistics.p95_range).fold(0.0, f64::max);
        let most = f64::from(preparation.options.trajectory_builder.trajectory_builder_3d.max_range);
        let longest = (0..2).map(|axis| spread(path.iter().map(|(_, p)| p[axis]))).fold(0.0, f64::max);
        let size = (longest + 2.0 * reach.min(most)) / VOXELS_ALONG;
        Self { path, voxel_size: size.clamp(*VOXEL_SIZES.start(), *VOXEL_SIZES.end()) }
    }

    /// Draws all pictures; returns the files. None where there are no points.
    pub fn draw(
        &self,
        points: &mut Points,
        folder: &OutputFolder,
        observe: &mut Observer,
    ) -> Result<Vec<PathBuf>, NotDrawn> {
        let sample = self.sample(points, observe)?;
        let views = self.views(&sample);
        let mut pictures = Vec::new();
        for (name, title, view) in &views.views {
            let (Some(right), Some(up)) = self.extents(&sample, view) else { return Ok(Vec::new()) };
            pictures.push((*name, *title, *view, self.picture(right, up, false)));
        }
        let front = views.views[1].2;
        let (Some(right), Some(up)) = views.extents_of_section(&sample) else { return Ok(Vec::new()) };
        let mut section = self.picture(right, up, true);
        let (first, last) = self.times();
        let mut occupied = OccupiedVoxels::new(self.voxel_size)?;
        points.for_each(1, observe, |position, time| {
            if !occupied.add(position) {
                return;
            }
            pictures.iter_mut().for_each(|(.., view, picture)| picture.add(view.project(position), 0.0));
            if views.is_cut(position) {
                section.add(front.project(position), (time - first) / (last - first).max(1e-3));
            }
        })?;
        let mut files = Vec::new();
        for (name, title, view, picture) in &pictures {
            if observe(&Event::Drawing).is_break() {
                return Err(NotDrawn::Interrupted);
            }
            let line = self.line(|p| Some(view.project(p)));
            files.push(write(picture, line, title, folder, name)?);
        }
        let line = self.line(|p| views.is_cut(p).then(|| front.project(p)));
        let title = format!("section, {SECTION} m thick, first seen early: blue, late: red");
        files.push(write(&section, line, &title, folder, "map_section.png")?);
        Ok(files)
    }

    /// A sample of points that covers the whole cloud.
    fn sample(&self, points: &mut Points, observe: &mut Observer) -> Result<CloudSample, NotDrawn> {
        let mut sample = CloudSample::default();
        let mut occupied = OccupiedVoxels::new(SAMPLED * self.voxel_size)?;
        points.for_each(EVERY_SAMPLED, observe, |position, _| {
            if occupied.add(position) {
                sample.add(position);
            }
        })?;
        Ok(sample)
    }

    /// Views along the walls, if there are any; the front is the longer side.
    fn views(&self, sample: &CloudSample) -> Views {
        let walls = sample.wall_direction().unwrap_or(0.0);
        let length = |view: &XrayView| {
            sample.extent(OUTLIERS, |p| view.project(p)[0]).map_or(0.0, |extent| extent.to - extent.from)
        };
        let across = walls + std::f64::consts::FRAC_PI_2;
        let (along, side) = (XrayView::level(walls), XrayView::level(across));
        let (front, side) = if length(&along) >= length(&side) { (along, side) } else { (side, along) };
        let depth = side;
        Views {
            views: [
                ("map_xray_top.png", "from above", XrayView::top(walls)),
                ("map_xray_front.png", "from the front", front),
                ("map_xray_side.png", "from the side", side),
            ],
            depth,
            middle: busiest(self.path.iter().map(|(_, p)| depth.project(*p)[0])),
        }
    }

    /// Extent of a picture: the cloud and the trajectory.
    fn extents(&self, sample: &CloudSample, view: &XrayView) -> (Option<Extent>, Option<Extent>) {
        let along = |axis: usize| {
            let extent = sample.extent(OUTLIERS, |p| view.project(p)[axis])?;
            let path = self.path.iter().map(|(_, p)| view.project(*p)[axis]).filter(|v| v.is_finite());
            Some(path.fold(extent, |e, v| Extent { from: e.from.min(v), to: e.to.max(v) }))
        };
        (along(0), along(1))
    }

    fn picture(&self, right: Extent, up: Extent, is_coloured: bool) -> XrayPicture {
        XrayPicture::new([right.from, up.from], [right.to, up.to], self.voxel_size, MAX_EDGE, is_coloured)
    }

    /// The trajectory as a line; a point for which `project` gives none interrupts it.
    fn line(&self, project: impl Fn([f64; 3]) -> Option<[f64; 2]>) -> TrajectoryLine {
        let points = self.path.iter().map(|(_, p)| project(*p).unwrap_or([f64::NAN; 2]));
        TrajectoryLine { index: 0, points: points.collect() }
    }

    /// First and last time, seconds since 1970.
    fn times(&self) -> (f64, f64) {
        let time = |pose: Option<&(Time, [f64; 3])>| pose.map_or(0.0, |(time, _)| time.unix_seconds());
        (time(self.path.first()), time(self.path.last()))
    }
}

impl Views {
    fn is_cut(&self, position: [f64; 3]) -> bool {
        (self.depth.project(position)[0] - self.middle).abs() < 0.5 * SECTION
    }

    /// Extent of most of the points in the section.
    fn extents_of_section(&self, sample: &CloudSample) -> (Option<Extent>, Option<Extent>) {
        let front = self.views[1].2;
        let along =
            |axis: usize| {
                sample.extent(OUTLIERS_OF_SECTION, |p| {
                    if self.is_cut(p) { front.project(p)[axis] } else { f64::NAN }
                })
            };
        (along(0), along(1))
    }
}

fn write(
    picture: &XrayPicture,
    line: TrajectoryLine,
    title: &str,
    folder: &OutputFolder,
    name: &str,
) -> Result<PathBuf, NotDrawn> {
    let picture = picture.finish(&[line], title);
    let picture = picture.map_err(|e| NotDrawn::Failed(e.into()))?;
    let path = folder.file(name).map_err(NotDrawn::Failed)?;
    write_picture(&path, &picture)
        .map_err(|e| NotDrawn::Failed(JobError::File { path: e.path, source: e.source }))?;
    Ok(path)
}

fn spread(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) =
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if high >= low { high - low } else { 0.0 }
}

/// The middle of the strip with most values.
fn busiest(values: impl Iterator<Item = f64>) -> f64 {
    let mut strips: Vec<i64> = values.map(|v| (v / STRIP).floor() as i64).collect();
    strips.sort_unstable();
    let most = strips.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
    most.and_then(|same| same.first()).map_or(0.0, |strip| (*strip as f64 + 0.5) * STRIP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_section_is_where_most_of_the_path_is() {
        let path = (0..100).map(f64::from).chain((0..40).map(|_| 12.3));
        assert_eq!(busiest(path), 12.25);
        assert_eq!(busiest(std::iter::empty()), 0.0);
        assert_eq!((spread([2.0, -1.0, 4.0].into_iter()), spread(std::iter::empty())), (5.0, 0.0));
    }
}
