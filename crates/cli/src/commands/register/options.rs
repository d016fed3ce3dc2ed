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
    /// What is minimised.
    #[arg(long, value_enum, default_value_t = Method::Quaternion)]
    method: Method,
    /// Pairs farther apart do not count, metres.
    #[arg(long, value_name = "METRES", default_value_t = IcpOptions::default().max_distance)]
    pub max_distance: f64,
    /// Most iterations; of large scans with 20000 points first, and again with all.
    #[arg(long, value_name = "N", default_value_t = IcpOptions::default().max_iterations)]
    pub iterations: usize,
    /// It ends when the distance of pairs changes by less in each of two iterations, metres.
    #[arg(long, value_name = "METRES", default_value_t = IcpOptions::default().epsilon)]
    epsilon: f64,
    /// Only pairs each of which is the nearest of the other.
    #[arg(long)]
    pub reciprocal: bool,
    /// Fraction of the nearest pairs that is used, above 0 to 1 (trimming).
    #[arg(long, value_name = "FRACTION", default_value_t = 1.0)]
    pub keep: f64,
    /// Only pairs whose surfaces are rotated against each other by less than this, degrees.
    #[arg(long, value_name = "DEGREES")]
    normals_within: Option<f64>,
    /// Pairs lose weight beyond this distance, metres.
    #[arg(long, value_name = "METRES")]
    robust: Option<f64>,
    /// How they lose it.
    #[arg(long, value_enum, default_value_t = Kernel::Cauchy, requires = "robust")]
    kernel: Kernel,
    /// Only every N-th point looks for a partner.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub every: usize,
    /// Match each scan with all before it.
    #[arg(long)]
    metascan: bool,
    /// Match each scan with so many before it.
    #[arg(long, value_name = "N", conflicts_with = "metascan")]
    metascan_last: Option<usize>,
    /// Begin at the first pose of each scan as it is, without the correction of the scan before.
    #[arg(long)]
    trust_poses: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Method {
    /// Distances of points, by unit quaternions.
    Quaternion,
    /// By singular values.
    Svd,
    /// By orthonormal matrices.
    Orthonormal,
    /// By dual quaternions.
    DualQuaternion,
    /// By helical motions.
    Helix,
    /// By small angles.
    SmallAngle,
    /// Distances from tangent planes.
    PointToPlane,
    /// Distances weighted by the surfaces of both scans.
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
    /// Linear beyond the distance.
    Huber,
    /// Logarithmic.
    Cauchy,
    /// Bounded.
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

/// When loops are closed.
#[derive(clap::Args, Clone, Debug)]
#[command(next_help_heading = "Loops")]
pub struct LoopArgs {
    /// Where the trajectory comes back, match the scans of both ends and distribute the error over the loop.
    #[arg(long)]
    close_loops: bool,
    /// The trajectory comes back where two scans are nearer than this, metres.
    #[arg(long, value_name = "METRES", default_value_t = LoopOptions::default().distance, requires = "close_loops")]
    loop_distance: f64,
    /// Scans that lie at least between them.
    #[arg(long, value_name = "N", default_value_t = LoopOptions::default().least_scans, requires = "close_loops")]
    loop_scans: usize,
    /// Farthest points of a pair when both ends are matched, metres.
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
    /// Then match all scans at once.
    #[arg(long)]
    pub global: bool,
    /// Parametrisation of the poses.
    #[arg(long, value_enum, default_value_t = GlobalName::Se3, requires = "global")]
    global_method: GlobalName,
    /// Pairs farther apart do not count, metres. Default: as --max-distance.
    #[arg(long, value_name = "METRES", requires = "global")]
    global_distance: Option<f64>,
    /// Match once more with this smaller distance, metres.
    #[arg(long, value_name = "METRES", requires = "global")]
    pub last_distance: Option<f64>,
    /// Most iterations. Default: as --iterations.
    #[arg(long, value_name = "N", requires = "global")]
    global_iterations: Option<usize>,
    /// It ends when scans move by less than this on average, metres.
    #[arg(long, value_name = "METRES", default_value_t = GlobalOptions::default().epsilon, requires = "global")]
    global_epsilon: f64,
    /// Only distances across surfaces count, and only where both surfaces face the same way (se3 and euler).
    #[arg(long, requires = "global")]
    global_planes: bool,
    /// Which scans are compared.
    #[arg(long, value_enum, default_value_t = LinksName::Overlap, requires = "global")]
    pub links: LinksName,
    /// Compare the scans that a file names: number of scans, number of links, then two scans a line, from 0.
    #[arg(long, value_name = "FILE", requires = "global")]
    pub links_file: Option<PathBuf>,
    /// By overlap: scans with more pairs than this are compared.
    #[arg(long, value_name = "N", default_value_t = 400, requires = "global")]
    pub min_pairs: usize,
    /// By distance: scans nearer than this are compared, metres.
    #[arg(long, value_name = "METRES", default_value_t = 5.0, requires = "global")]
    pub link_distance: f64,
    /// By distance: scans that lie at least between them; neighbours are always compared.
    #[arg(long, value_name = "N", default_value_t = 20, requires = "global")]
    pub link_gap: usize,
}

/// Which scans are compared.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum LinksName {
    /// Those with enough points near each other.
    Overlap,
    /// Neighbours, and those that were taken near each other.
    Distance,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum GlobalName {
    /// Twists: no singularity.
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
