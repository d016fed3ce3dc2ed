//! Options of matching.

use std::path::PathBuf;

use portolan_registration::{
    GlobalMethod, GlobalOptions, IcpMethod, IcpOptions, LoopOptions, ModelScans, RobustKernel,
    SequenceOptions,
};
use portolan_spatial::ClosedForm;

use crate::error::CliError;

/// How two scans are matched.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Matching of a scan with those before it (ICP)")]
pub struct IcpArgs {
    /// Error metric, for point to point with its closed-form solution.
    #[arg(long, value_enum, default_value_t = Method::Quaternion)]
    method: Method,
    /// Maximum distance between the points of a pair, metres.
    #[arg(long, value_name = "METRES", default_value_t = IcpOptions::default().max_distance)]
    pub max_distance: f64,
    /// Maximum number of iterations; large scans are matched with 20000 points first, and again with all.
    #[arg(long, value_name = "N", default_value_t = IcpOptions::default().max_iterations)]
    pub iterations: usize,
    /// Converged if the RMS distance of pairs changes by less than this in each of two iterations, metres.
    #[arg(long, value_name = "METRES", default_value_t = IcpOptions::default().epsilon)]
    epsilon: f64,
    /// Use only mutual nearest neighbours.
    #[arg(long)]
    pub reciprocal: bool,
    /// Fraction of the pairs that is used, the nearest ones, above 0 to 1 (trimmed ICP).
    #[arg(long, value_name = "FRACTION", default_value_t = 1.0)]
    pub keep: f64,
    /// Use only pairs whose surface normals differ by less than this, degrees.
    #[arg(long, value_name = "DEGREES")]
    normals_within: Option<f64>,
    /// Down-weight pairs farther apart than this, metres.
    #[arg(long, value_name = "METRES")]
    robust: Option<f64>,
    /// Robust kernel of the down-weighting.
    #[arg(long, value_enum, default_value_t = Kernel::Cauchy, requires = "robust")]
    kernel: Kernel,
    /// Search a partner only for every N-th point.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub every: usize,
    /// Match each scan with all before it.
    #[arg(long)]
    metascan: bool,
    /// Match each scan with this number of scans before it.
    #[arg(long, value_name = "N", conflicts_with = "metascan")]
    metascan_last: Option<usize>,
    /// Start at the initial pose of each scan as it is, without the correction of the scan before.
    #[arg(long)]
    trust_poses: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Method {
    /// Point to point, by unit quaternions.
    Quaternion,
    /// Point to point, by singular values.
    Svd,
    /// Point to point, by orthonormal matrices.
    Orthonormal,
    /// Point to point, by dual quaternions.
    DualQuaternion,
    /// Point to point, by helical motions.
    Helix,
    /// Point to point, by small angles.
    SmallAngle,
    /// Point to tangent plane.
    PointToPlane,
    /// Generalized ICP: distances weighted by the surfaces of both scans.
    Generalized,
}

/// Scans for whose points surfaces (normals) are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SurfacesOf {
    None,
    AllButLast,
    All,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Kernel {
    /// Linear loss beyond the distance.
    Huber,
    /// Logarithmic loss.
    Cauchy,
    /// Bounded loss.
    #[value(name = "geman-mcclure")]
    GemanMcClure,
}

impl IcpArgs {
    fn icp_method(&self) -> IcpMethod {
        IcpMethod::PointToPoint(match self.method {
            Method::Quaternion => ClosedForm::Quaternion,
            Method::Svd => ClosedForm::Svd,
            Method::Orthonormal => ClosedForm::Orthonormal,
            Method::DualQuaternion => ClosedForm::DualQuaternion,
            Method::Helix => ClosedForm::Helix,
            Method::SmallAngle => ClosedForm::SmallAngle,
            Method::PointToPlane => return IcpMethod::PointToPlane,
            Method::Generalized => return IcpMethod::Generalized,
        })
    }

    /// Scans that need surfaces. For point-to-plane matching the last scan needs none, because no scan is matched to it.
    pub fn surfaces(&self) -> SurfacesOf {
        match self.method {
            _ if self.normals_within.is_some() => SurfacesOf::All,
            Method::Generalized => SurfacesOf::All,
            Method::PointToPlane => SurfacesOf::AllButLast,
            _ => SurfacesOf::None,
        }
    }

    /// All options of the sequential registration.
    pub fn sequence(&self, loops: &LoopArgs) -> Result<SequenceOptions, CliError> {
        positive("--max-distance", self.max_distance)?;
        positive("--epsilon", self.epsilon)?;
        positive("--keep", self.keep)?;
        if self.keep > 1.0 {
            return Err(CliError::Usage(format!("--keep is a fraction, at most 1, but is {}", self.keep)));
        }
        if self.every == 0 || self.metascan_last == Some(0) || self.iterations == 0 {
            return Err(CliError::Usage(
                "--every, --metascan-last and --iterations must be at least 1".to_owned(),
            ));
        }
        if let Some(degrees) = self.normals_within.filter(|d| !(0.0..=90.0).contains(d)) {
            return Err(CliError::Usage(format!(
                "--normals-within must be 0 to 90 degrees, but is {degrees}"
            )));
        }
        let kernel = match self.robust {
            Some(scale) => {
                positive("--robust", scale)?;
                match self.kernel {
                    Kernel::Huber => RobustKernel::Huber(scale),
                    Kernel::Cauchy => RobustKernel::Cauchy(scale),
                    Kernel::GemanMcClure => RobustKernel::GemanMcClure(scale),
                }
            }
            None => RobustKernel::None,
        };
        let icp = IcpOptions {
            method: self.icp_method(),
            max_distance: self.max_distance,
            max_iterations: self.iterations,
            epsilon: self.epsilon,
            reciprocal: self.reciprocal,
            keep: self.keep,
            least_cosine: self.normals_within.map_or(-1.0, |degrees| degrees.to_radians().cos()),
            kernel,
            every: self.every,
            ..IcpOptions::default()
        };
        let model = match self.metascan_last {
            Some(count) => ModelScans::Last(count),
            None if self.metascan => ModelScans::All,
            None => ModelScans::Previous,
        };
        Ok(SequenceOptions { icp, model, trust_poses: self.trust_poses, loops: loops.options()? })
    }
}

/// Checks that an option is above 0.
fn positive(name: &str, value: f64) -> Result<(), CliError> {
    match value > 0.0 && value < 1e6 {
        true => Ok(()),
        false => Err(CliError::Usage(format!("{name} must be above 0, but is {value}"))),
    }
}

/// Closing of loops.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Loops")]
pub struct LoopArgs {
    /// Where the trajectory returns to an earlier place, match the scans of both ends and distribute the
    /// error over the loop.
    #[arg(long)]
    close_loops: bool,
    /// Close a loop where two scans are nearer than this, metres.
    #[arg(long, value_name = "METRES", default_value_t = LoopOptions::default().distance, requires = "close_loops")]
    loop_distance: f64,
    /// Minimum difference of the indices of these two scans.
    #[arg(long, value_name = "N", default_value_t = LoopOptions::default().least_scans, requires = "close_loops")]
    loop_scans: usize,
    /// Maximum distance between the points of a pair when both ends are matched, metres.
    #[arg(long, value_name = "METRES", default_value_t = LoopOptions::default().max_distance, requires = "close_loops")]
    loop_max_distance: f64,
}

impl LoopArgs {
    fn options(&self) -> Result<Option<LoopOptions>, CliError> {
        positive("--loop-distance", self.loop_distance)?;
        positive("--loop-max-distance", self.loop_max_distance)?;
        Ok(self.close_loops.then(|| LoopOptions {
            distance: self.loop_distance,
            least_scans: self.loop_scans,
            max_distance: self.loop_max_distance,
            ..LoopOptions::default()
        }))
    }
}

/// How all scans are matched at once.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Matching of all scans at once")]
pub struct GlobalMatchingArgs {
    /// Match all scans at once afterwards.
    #[arg(long)]
    pub global: bool,
    /// Parametrisation of the poses.
    #[arg(long, value_enum, default_value_t = GlobalName::Se3, requires = "global")]
    global_method: GlobalName,
    /// Maximum distance between the points of a pair, metres. Default: that of --max-distance.
    #[arg(long, value_name = "METRES", requires = "global")]
    global_distance: Option<f64>,
    /// Match once more with this smaller maximum distance, metres.
    #[arg(long, value_name = "METRES", requires = "global")]
    pub last_distance: Option<f64>,
    /// Maximum number of iterations. Default: that of --iterations.
    #[arg(long, value_name = "N", requires = "global")]
    global_iterations: Option<usize>,
    /// Converged if scans move by less than this on average, metres.
    #[arg(long, value_name = "METRES", default_value_t = GlobalOptions::default().epsilon, requires = "global")]
    global_epsilon: f64,
    /// Use point-to-plane distances, and only pairs whose surfaces face the same direction (se3 and euler).
    #[arg(long, requires = "global")]
    global_planes: bool,
    /// Which pairs of scans are matched.
    #[arg(long, value_enum, default_value_t = LinksName::Overlap, requires = "global")]
    pub links: LinksName,
    /// Match the pairs of scans in a file: number of scans, number of pairs, then two indices per line, from
    /// 0.
    #[arg(long, value_name = "FILE", requires = "global")]
    pub links_file: Option<PathBuf>,
    /// With `overlap`: match scans with more point pairs than this.
    #[arg(long, value_name = "N", default_value_t = 400, requires = "global")]
    pub min_pairs: usize,
    /// With `distance`: match scans nearer than this, metres.
    #[arg(long, value_name = "METRES", default_value_t = 5.0, requires = "global")]
    pub link_distance: f64,
    /// With `distance`: minimum number of scans between them; neighbours are always matched.
    #[arg(long, value_name = "N", default_value_t = 20, requires = "global")]
    pub link_gap: usize,
}

/// Pairs of scans that are matched.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum LinksName {
    /// Scans with enough points near each other.
    Overlap,
    /// Neighbours in the sequence, and scans that were taken near each other.
    Distance,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum GlobalName {
    /// Twists, without singularities.
    Se3,
    /// Euler angles.
    Euler,
    /// Quaternions.
    Quaternion,
    /// Helical motions.
    Helix,
    /// Small angles.
    SmallAngle,
}

impl GlobalMatchingArgs {
    /// Whether global matching needs surfaces.
    pub fn planes(&self) -> bool {
        self.global && self.global_planes
    }

    /// Refuses invalid values.
    pub fn check(&self) -> Result<(), CliError> {
        let optional = |name, value: Option<f64>| value.map_or(Ok(()), |v| positive(name, v));
        optional("--global-distance", self.global_distance)?;
        optional("--last-distance", self.last_distance)?;
        positive("--global-epsilon", self.global_epsilon)?;
        positive("--link-distance", self.link_distance)?;
        let weighted = matches!(self.global_method, GlobalName::Se3 | GlobalName::Euler);
        if self.global_planes && !weighted {
            return Err(CliError::Usage(
                "--global-planes goes with --global-method se3 or euler: the other published methods compare points"
                    .to_owned(),
            ));
        }
        Ok(())
    }

    /// Options of the global matching.
    pub fn options(&self, icp: &IcpArgs) -> GlobalOptions {
        GlobalOptions {
            method: match self.global_method {
                GlobalName::Se3 => GlobalMethod::Se3,
                GlobalName::Euler => GlobalMethod::Euler,
                GlobalName::Quaternion => GlobalMethod::Quaternion,
                GlobalName::Helix => GlobalMethod::Helix,
                GlobalName::SmallAngle => GlobalMethod::SmallAngle,
            },
            max_distance: self.global_distance.unwrap_or(icp.max_distance),
            max_iterations: self.global_iterations.unwrap_or(icp.iterations).max(1),
            epsilon: self.global_epsilon,
            planes: self.global_planes,
            ..GlobalOptions::default()
        }
    }
}
