//! Options for the map as a cloud and as X-ray pictures, and the summary of the cloud.

use std::path::PathBuf;

use portolan::job::CloudRequest;
use portolan::reprojection::Reprojected;

use crate::output::counted;

/// Export of the map as a cloud and as pictures.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Cloud (a second pass over the recording)")]
pub struct CloudArgs {
    /// Also write the map as a cloud of all raw points, each placed by the final trajectory at its own time:
    /// .ply, .pcd, .las, .laz, .e57 or .xyz. A name without a folder is written into the folder of the
    /// results.
    #[arg(long, value_name = "FILE")]
    pub cloud: Option<PathBuf>,
    /// Keep one point per voxel of this size: the mean of its points. 0.05 is a good start. Memory does not
    /// grow with the recording, with or without this option.
    #[arg(long, value_name = "METRES", requires = "cloud")]
    pub cloud_voxel: Option<f64>,
    /// Draw no X-ray pictures of 3D maps.
    #[arg(long)]
    pub no_xray: bool,
}

impl CloudArgs {
    /// The options as the job takes them.
    pub fn request(&self) -> CloudRequest {
        CloudRequest {
            file: self.cloud.clone(),
            voxel_size_metres: self.cloud_voxel,
            with_xrays: !self.no_xray,
        }
    }
}

/// Number of points in the cloud, and of points that were left out by reason.
pub fn summary(points: u64, reprojected: &Reprojected) -> String {
    let mut text = format!("cloud: {} of {}", counted(points, "point", "points"), reprojected.points);
    let left_out = [
        (reprojected.outside_range, "nearer or farther than the range limits of mapping"),
        (reprojected.outside_trajectory, "at times without a pose"),
    ];
    for (count, why) in left_out.iter().filter(|(count, _)| *count > 0) {
        text += &format!("; {count} left out, {why}");
    }
    text
}
