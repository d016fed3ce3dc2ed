//! Reads scans, initial poses and links from files.

use std::path::{Path, PathBuf};

use portolan::job::register::{PointLimits, ScanSource, Scans};
use portolan::trajectory_file::TrajectoryFile;
use portolan_geometry::{Quaternion, Rigid3};
use portolan_pointcloud::CloudError;
use portolan_registration::{Link, ScanCloud, links_of_text};
use portolan_spatial::{VoxelRepresentative, reduce};

use super::options::SurfacesOf;
use crate::clouds::read_cloud_from;
use crate::commands::evaluate::input::read_trajectory;
use crate::error::CliError;
use crate::input::read_bytes;
use crate::output::counted;
use crate::progress::print_line;

/// Number of neighbours from which a normal is computed.
const NORMAL_NEIGHBOURS: usize = 12;
/// Largest coordinate that is stored without an offset, metres: beyond it single precision resolves only about a
/// millimetre.
const SINGLE_PRECISION_REACH: f64 = 8192.0;
/// Maximum number of points of a scan that are kept in memory.
const MOST_POINTS: usize = 50_000_000;
/// Reading of points.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Points")]
pub struct InputArgs {
    /// Keep one point in each voxel of this edge, metres.
    #[arg(long, value_name = "METRES")]
    reduce: Option<f64>,
    /// Point that is kept in each voxel.
    #[arg(long, value_enum, default_value_t = ReduceTo::Random, requires = "reduce")]
    reduce_to: ReduceTo,
    /// Leave out points nearer than this to the origin of their scan, metres.
    #[arg(long, value_name = "METRES", default_value_t = 0.0)]
    min_range: f64,
    /// Leave out points farther than this from the origin of their scan, metres. Default: none.
    #[arg(long, value_name = "METRES")]
    max_range: Option<f64>,
    /// Multiply all coordinates by this factor, for files that are not in metres: 0.001 for millimetres.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scale: f64,
    /// Start uos scans at the poses of an earlier registration (.frames) instead of at their initial poses
    /// (.pose).
    #[arg(long = "continue")]
    continues: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum ReduceTo {
    /// A measured point, chosen at random but reproducibly.
    Random,
    /// The mean of all its points.
    Mean,
    /// The centre of the voxel.
    Centre,
}

impl InputArgs {
    fn check(&self) -> Result<(), CliError> {
        let positive = |name: &str, value: f64| match value > 0.0 && value < 1e9 {
            true => Ok(()),
            false => Err(CliError::Usage(format!("{name} must be above 0, but is {value}"))),
        };
        positive("--scale", self.scale)?;
        self.reduce.map_or(Ok(()), |edge| positive("--reduce", edge))?;
        self.max_range.map_or(Ok(()), |range| positive("--max-range", range))?;
        match self.min_range >= 0.0 && self.min_range < self.max_range.unwrap_or(f64::INFINITY) {
            true => Ok(()),
            false => Err(CliError::Usage("--min-range must be at least 0 and below --max-range".to_owned())),
        }
    }

    fn limits(&self) -> PointLimits {
        let max_range = self.max_range.unwrap_or(f64::INFINITY);
        PointLimits { scale: self.scale, min_range: self.min_range, max_range }
    }
}

fn failed(error: CloudError) -> CliError {
    CliError::Failed(error.to_string())
}

/// Reads all scans; suspicious units are reported.
pub fn read_scans(
    paths: &[PathBuf],
    input: &InputArgs,
    surfaces: SurfacesOf,
    quiet: bool,
) -> Result<Scans, CliError> {
    input.check()?;
    let sources = ScanSource::all_of(paths).map_err(failed)?;
    let mut scans = Scans {
        names: sources.iter().map(|s| s.path().display().to_string()).collect(),
        guesses: sources
            .iter()
            .map(|s| match s {
                ScanSource::Uos(scan) if input.continues => scan.world_from_scan(),
                ScanSource::Uos(scan) => scan.guess.unwrap_or_default(),
                ScanSource::File(_) => Rigid3::identity(),
            })
            .collect(),
        clouds: Vec::with_capacity(sources.len()),
        sources,
        limits: input.limits(),
        lost_data: false,
        from_origin: Rigid3::identity(),
        from_first: Rigid3::identity(),
    };
    let mut origin = None;
    for (index, source) in scans.sources.iter().enumerate() {
        let has_surfaces = match surfaces {
            SurfacesOf::All => true,
            SurfacesOf::AllButLast => index + 1 < scans.sources.len(),
            SurfacesOf::None => false,
        };
        let (cloud, lost) = read_scan(source, input, has_surfaces, quiet, &mut origin)?;
        scans.lost_data |= lost;
        scans.clouds.push(cloud);
    }
    scans.from_origin = Rigid3::from_parts(origin.unwrap_or([0.0; 3]).into(), Quaternion::identity());
    if !quiet {
        scans.suspect_units().into_iter().for_each(|line| print_line(&line));
    }
    Ok(scans)
}

/// Reads a scan; returns also whether data were lost. If the first point of the first scan is too far from the origin for
/// single precision, all points are stored relative to it.
fn read_scan(
    source: &ScanSource,
    input: &InputArgs,
    surfaces: bool,
    quiet: bool,
    origin: &mut Option<[f64; 3]>,
) -> Result<(ScanCloud, bool), CliError> {
    let path = source.path();
    let read = read_cloud_from(source.open().map_err(failed)?, path, MOST_POINTS, quiet)?;
    if read.total > read.points.len() as u64 && !quiet {
        print_line(&format!(
            "{}: only {} of {} points are used",
            path.display(),
            read.points.len(),
            read.total
        ));
    }
    let limits = input.limits();
    let mut points: Vec<[f32; 3]> = Vec::with_capacity(read.points.len());
    for position in read.points.iter().filter_map(|p| limits.point(*p)) {
        let far = position.iter().any(|v| v.abs() > SINGLE_PRECISION_REACH);
        let origin = origin.get_or_insert(if far { position } else { [0.0; 3] });
        points.push(std::array::from_fn(|k| (position[k] - origin[k]) as f32));
    }
    if let Some(edge) = input.reduce {
        let representative = match input.reduce_to {
            ReduceTo::Random => VoxelRepresentative::Random(1),
            ReduceTo::Mean => VoxelRepresentative::Mean,
            ReduceTo::Centre => VoxelRepresentative::Centre,
        };
        points = reduce(&points, edge as f32, representative);
    }
    if points.len() < 4 {
        let kept = counted(points.len() as u64, "point", "points");
        let reason =
            format!("{kept} of {} left after reduction and range limits; at least 4 are needed", read.total);
        return Err(CliError::in_file(path, reason));
    }
    if points.iter().all(|p| *p == points[0]) {
        return Err(CliError::in_file(path, "all its points are at the same position"));
    }
    let cloud = match surfaces {
        // The scanner is at the origin of its scan.
        true => ScanCloud::with_surfaces(points, NORMAL_NEIGHBOURS, f32::INFINITY)
            .with_normals_towards(origin.unwrap_or([0.0; 3]).map(|v| -v as f32)),
        false => ScanCloud::new(points),
    };
    Ok((cloud, read.lost_data()))
}

/// Reads the initial poses, in the order of the scans.
pub fn read_poses(path: &Path, count: usize) -> Result<Vec<Rigid3>, CliError> {
    let trajectory = read_trajectory(TrajectoryFile { path, trajectory_id: None, times: None }, false)?;
    if trajectory.len() != count {
        return Err(CliError::in_file(
            path,
            format!("it has {} poses at different times, but there are {count} scans", trajectory.len()),
        ));
    }
    Ok(trajectory.poses().iter().map(|p| p.map_from_tracking).collect())
}

/// Reads links from a file.
pub fn read_links(path: &Path, count: usize) -> Result<Vec<Link>, CliError> {
    links_of_text(&String::from_utf8_lossy(&read_bytes(path)?), count)
        .map_err(|error| CliError::in_file(path, error))
}
