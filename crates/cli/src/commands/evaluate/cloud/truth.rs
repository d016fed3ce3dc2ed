//! Reads the true surfaces that clouds are compared with.

use std::path::{Path, PathBuf};

use portolan_evaluation::cloud::{ReferenceCloud, TrueSurfaces, is_mesh, read_boxes, read_mesh};
use portolan_geometry::{Rigid3, nalgebra as na};

use crate::GlobalArgs;
use crate::clouds::read_cloud;
use crate::error::CliError;
use crate::input::read_bytes;
use crate::output::counted;
use crate::progress::print_line;

/// Maximum number of points of a reference cloud; they take about 1 GB with the search tree.
const REFERENCE_POINTS: usize = 30_000_000;

/// The truth that clouds are compared with.
#[derive(clap::Args)]
#[command(next_help_heading = "Truth")]
pub struct TruthArgs {
    /// True surfaces: solid boxes, one per line, `x0,y0,z0,x1,y1,z1` in metres; or a mesh (PLY, OBJ, STL).
    #[arg(long, value_name = "FILE", conflicts_with = "reference")]
    surfaces: Option<PathBuf>,
    /// Reference cloud of higher accuracy as the truth, for example from a terrestrial scanner.
    #[arg(long, value_name = "CLOUD")]
    reference: Option<PathBuf>,
    /// Leave out points farther than this from every true surface, metres: they are on objects that the truth
    /// does not contain. Their number is reported. Default: all points count.
    #[arg(long, value_name = "METRES")]
    beyond: Option<f64>,
    /// Align each cloud with the true surfaces first: rigidly, minimising distances.
    #[arg(long, conflicts_with = "truth")]
    fit: bool,
    /// True trajectory. Each trajectory is aligned with it (rigidly, by least squares over its positions)
    /// before its points are compared with the surfaces. Without it, and without --fit, the frames must be
    /// the same.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
}

/// True surfaces, and how clouds are compared with them.
pub struct Truth {
    surfaces: TrueSurfaces,
    fit: bool,
    /// Distance from the surfaces beyond which points are left out, metres.
    pub beyond: f64,
    /// Whether some of the surfaces could not be read.
    pub lost_data: bool,
}

impl TruthArgs {
    /// Path of the true trajectory.
    pub fn trajectory(&self) -> Option<&Path> {
        self.truth.as_deref()
    }

    /// Reads the surfaces; none if no surfaces were given.
    pub fn read(&self, global: &GlobalArgs) -> Result<Option<Truth>, CliError> {
        let beyond = self.beyond.unwrap_or(f64::INFINITY);
        if beyond.is_nan() || beyond <= 0.0 {
            return Err(CliError::Usage(format!("--beyond must be above 0 m, but is {beyond}")));
        }
        let (surfaces, lost_data) = match (&self.surfaces, &self.reference) {
            (Some(path), _) => surfaces(path, global.quiet)?,
            (None, Some(path)) => reference(path, global.quiet)?,
            (None, None) if self.beyond.is_some() || self.fit || self.truth.is_some() => {
                return Err(CliError::Usage(
                    "--beyond, --fit and --truth need --surfaces or --reference to compare with".to_owned(),
                ));
            }
            (None, None) => return Ok(None),
        };
        Ok(Some(Truth { surfaces, fit: self.fit, beyond, lost_data }))
    }
}

/// Reads surfaces; returns also whether some of them could not be read.
fn surfaces(path: &Path, quiet: bool) -> Result<(TrueSurfaces, bool), CliError> {
    let bytes = read_bytes(path)?;
    let none = || CliError::in_file(path, "there are no surfaces in it");
    if !is_mesh(&bytes) {
        let boxes = read_boxes(&*bytes).map_err(|error| CliError::in_file(path, error))?;
        return TrueSurfaces::boxes(boxes).map(|surfaces| (surfaces, false)).ok_or_else(none);
    }
    let mesh = read_mesh(&bytes).map_err(|error| {
        CliError::in_file(path, format!("{error} (a cloud as the truth is given with --reference)"))
    })?;
    if mesh.left_out > 0 && !quiet {
        let faces = counted(mesh.left_out as u64, "face", "faces");
        print_line(&format!("{}: {faces} with missing corners were left out", path.display()));
    }
    let lost_data = mesh.left_out > 0;
    TrueSurfaces::triangles(mesh.triangles).map(|surfaces| (surfaces, lost_data)).ok_or_else(none)
}

fn reference(path: &Path, quiet: bool) -> Result<(TrueSurfaces, bool), CliError> {
    let cloud = read_cloud(path, REFERENCE_POINTS, quiet)?;
    let reference = ReferenceCloud::new(&cloud.points);
    reference
        .map(|reference| (TrueSurfaces::cloud(reference), cloud.lost_data()))
        .ok_or_else(|| CliError::in_file(path, "it has fewer than three points"))
}

impl Truth {
    /// Distance of each point to the nearest surface, metres. The cloud is aligned with the truth first: by the given
    /// transform, else by a fit if requested.
    pub fn distances(&self, points: &[[f64; 3]], truth_from_cloud: Option<&Rigid3>) -> Vec<f64> {
        let fitted = self.fit.then(|| self.surfaces.fit(points));
        match truth_from_cloud.copied().or(fitted) {
            Some(pose) => {
                let place = |p: &[f64; 3]| (pose * na::Point3::from(*p)).coords.into();
                self.surfaces.distances(&points.iter().map(place).collect::<Vec<_>>())
            }
            None => self.surfaces.distances(points),
        }
    }
}
