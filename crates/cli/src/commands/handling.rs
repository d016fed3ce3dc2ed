//! Options for the treatment of points, their times and stamps, for all verbs that read points of recordings.

use std::path::PathBuf;

use portolan_ingest::{AzimuthTimes, BeamElevation, IngestOptions, RangeNoise, StampPolicy, read_urdf};

use super::argument::{beam_elevation, range_noise};
use crate::error::CliError;

/// Handling of points and stamps.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct HandlingArgs {
    /// Robot description (URDF) whose fixed joints give the poses of the sensors.
    #[arg(long, value_name = "FILE")]
    pub urdf: Option<PathBuf>,
    /// Source of the times of the points of a cloud. By default: the recorded times; if there are none, those
    /// of a spinning lidar follow from the azimuth. Whether clouds are de-skewed already, and how long a
    /// laser scan takes, is estimated from the data.
    #[arg(long, alias = "azimuth-times", value_name = "SOURCE", default_value = "auto")]
    pub point_times: PointTimesArg,
    /// Raise all beams of the lidar: `auto` by their calibration error as estimated from motion, if it is
    /// significant; `off` not at all; or by this angle, degrees. Beams that point too low bend the trajectory
    /// of a straight drive.
    #[arg(long, value_name = "auto|off|DEGREES", default_value = "auto", value_parser = beam_elevation, allow_hyphen_values = true)]
    pub beam_elevation: BeamElevation,
    /// Range noise of a planar scanner: `auto` estimates it from scans; or its standard deviation, metres.
    /// Above 0.03 m, readings are smoothed along walls; 0 leaves all unchanged.
    #[arg(long, value_name = "auto|METRES", default_value = "auto", value_parser = range_noise)]
    pub range_noise: RangeNoise,
    /// Handling of stamps. A busy computer stamps several messages at once, later than they were measured.
    #[arg(long, value_name = "POLICY", default_value = "auto")]
    pub stamps: StampsArg,
}

impl HandlingArgs {
    /// Sets the options of ingestion.
    ///
    /// # Errors
    /// Fails if the robot description cannot be read.
    pub fn configure(&self, ingest: &mut IngestOptions) -> Result<(), CliError> {
        ingest.azimuth_times = self.point_times.into();
        ingest.beam_elevation = self.beam_elevation;
        ingest.range_noise = self.range_noise;
        ingest.stamps = self.stamps.into();
        if let Some(path) = &self.urdf {
            ingest.description = Some(read_urdf(path)?);
        }
        Ok(())
    }
}

/// Handling of stamps.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StampsArg {
    /// Keep stamps, unless those of a sensor come in bursts, go back, jitter or make sweeps overlap.
    #[default]
    Auto,
    /// Keep stamps.
    AsIs,
    /// Compute stamps from the order of arrival and the usual rate of each sensor.
    Regular,
}

impl From<StampsArg> for StampPolicy {
    fn from(how: StampsArg) -> Self {
        match how {
            StampsArg::Auto => Self::Auto,
            StampsArg::AsIs => Self::AsIs,
            StampsArg::Regular => Self::Regular,
        }
    }
}

/// Source of the times of points.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PointTimesArg {
    /// Chosen from the clouds.
    #[default]
    Auto,
    /// Recorded times, even if the clouds seem to be de-skewed already.
    Recorded,
    /// The stamp, for all points: the clouds are de-skewed.
    Off,
    /// Azimuth; sweeps begin at the stamp.
    FromStamp,
    /// Azimuth; the stamp is in the middle of the sweep.
    AroundStamp,
    /// Azimuth; sweeps end at the stamp.
    UntilStamp,
}

impl From<PointTimesArg> for AzimuthTimes {
    fn from(how: PointTimesArg) -> Self {
        match how {
            PointTimesArg::Auto => Self::Auto,
            PointTimesArg::Recorded => Self::Recorded,
            PointTimesArg::Off => Self::Off,
            PointTimesArg::FromStamp => Self::FromStamp,
            PointTimesArg::AroundStamp => Self::AroundStamp,
            PointTimesArg::UntilStamp => Self::UntilStamp,
        }
    }
}
