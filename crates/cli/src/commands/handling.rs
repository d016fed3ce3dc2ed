//! Options for the treatment of points, their times and stamps, for all verbs that read points of recordings.

use std::path::PathBuf;

use portolan_ingest::{AzimuthTimes, BeamElevation, IngestOptions, RangeNoise, StampPolicy, read_urdf};

use super::argument::{beam_elevation, range_noise};
use crate::error::CliError;

/// How points and stamps are taken.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct HandlingArgs {
    /// Robot description whose fixed joints say where the sensors are.
    #[arg(long, value_name = "FILE")]
    pub urdf: Option<PathBuf>,
    /// Where the times of the points of clouds come from. On its own: those that were recorded; without any, those of a
    /// spinning lidar follow from the azimuth. Whether the clouds are de-skewed already is found out, and so is how long
    /// laser scans take.
    #[arg(long, alias = "azimuth-times", value_name = "HOW", default_value = "auto")]
    pub point_times: PointTimesArg,
    /// Raise all beams of the lidar: "auto" by the error of their calibration that motion shows, if it is clear; "off" not
    /// at all; or by so many degrees. Beams that point too low bend a straight drive.
    #[arg(long, value_name = "HOW", default_value = "auto", value_parser = beam_elevation, allow_hyphen_values = true)]
    pub beam_elevation: BeamElevation,
    /// Noise of the readings of a planar scanner: "auto" as scans tell, or a standard deviation in metres. Noisier ones than
    /// 0.03 m are smoothed along walls; 0 takes all as they are.
    #[arg(long, value_name = "NOISE", default_value = "auto", value_parser = range_noise)]
    pub range_noise: RangeNoise,
    /// How stamps are taken: a computer that is busy stamps several messages at once, and later than they were
    /// measured.
    #[arg(long, value_name = "HOW", default_value = "auto")]
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

/// How stamps are taken.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StampsArg {
    /// As they are, unless those of a sensor come in bursts, go back, jitter or make sweeps overlap.
    #[default]
    Auto,
    /// As they are.
    AsIs,
    /// From the order of arrival and the usual rate of each sensor.
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

/// Where the times of points come from.
#[derive(clap::ValueEnum, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PointTimesArg {
    /// What fits the clouds.
    #[default]
    Auto,
    /// The times that were recorded, even if the clouds seem to be de-skewed already.
    Recorded,
    /// All points are measured at the stamp: the clouds are de-skewed.
    Off,
    /// The azimuth: sweeps begin at the stamp.
    FromStamp,
    /// The azimuth: the stamp is in the middle of the sweep.
    AroundStamp,
    /// The azimuth: sweeps end at the stamp.
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
