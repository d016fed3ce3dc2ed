//! `portolan register`: scans brought together.

use std::path::{Path, PathBuf};

use portolan_geometry::{Quaternion, Rigid3, nalgebra as na, rotation_from_roll_pitch_yaw};
use portolan_pointcloud::PointCloud;
use portolan_refinement::neighbours::{VoxelRepresentative, reduce};
use portolan_refinement::registration::{
    ClosedForm, GlobalMethod, GlobalOptions, IcpMethod, IcpOptions, IcpResult, RobustKernel, ScanCloud, icp,
    links_by_overlap, register_globally,
};
use serde::Serialize;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, print, print_json};
use crate::progress::say;

/// Neighbours that tell a normal.
const NORMAL_NEIGHBOURS: usize = 12;
/// Coordinates beyond this are good to less than a millimetre in single precision, metres.
const SINGLE_PRECISION_REACH: f64 = 8192.0;

/// Bring scans together: where each scan lies in the frame of the first.
///
/// Scans are files of points (PLY, PCD, text, LAS, LAZ, E57), metres. Each scan is matched with the one before it
/// (--metascan: with all before it), beginning where that one was moved to; with --global all of them are then
/// matched at once.
#[derive(clap::Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    portolan register scan000.ply scan001.ply\n  \
    portolan register a.pcd b.pcd c.pcd --method point-to-plane --reduce 0.1 --global\n  \
    portolan register map.ply scan.ply --guess 10,2,0,0,0,1.57 --json")]
pub struct RegisterArgs {
    /// Files of scans; the first stays where it is.
    #[arg(required = true, num_args = 2.., value_name = "SCAN")]
    scans: Vec<PathBuf>,
    /// What is minimised.
    #[arg(long, value_enum, default_value_t = Method::Quaternion)]
    method: Method,
    /// Where the second scan lies in the first to begin with: x,y,z (metres), roll,pitch,yaw (radians).
    #[arg(long, value_name = "X,Y,Z,R,P,Y", value_parser = pose, allow_hyphen_values = true)]
    guess: Option<Rigid3>,
    /// Pairs farther apart do not count, metres.
    #[arg(long, value_name = "METRES", default_value_t = IcpOptions::default().max_distance)]
    max_distance: f64,
    /// Most iterations.
    #[arg(long, value_name = "N", default_value_t = IcpOptions::default().max_iterations)]
    iterations: usize,
    /// Keep one point in each voxel of this edge, metres.
    #[arg(long, value_name = "METRES")]
    reduce: Option<f64>,
    /// Only pairs each of which is the nearest of the other.
    #[arg(long)]
    reciprocal: bool,
    /// Share of the nearest pairs that is used.
    #[arg(long, value_name = "SHARE", default_value_t = 1.0)]
    keep: f64,
    /// Pairs lose weight beyond this distance (Cauchy), metres.
    #[arg(long, value_name = "METRES")]
    robust: Option<f64>,
    /// Match each scan with all before it.
    #[arg(long)]
    metascan: bool,
    /// Then match all scans at once.
    #[arg(long)]
    global: bool,
    /// Parametrisation of the matching of all scans.
    #[arg(long, value_enum, default_value_t = GlobalName::Se3)]
    global_method: GlobalName,
    /// Scans with more pairs than this are compared in it.
    #[arg(long, value_name = "N", default_value_t = 400)]
    min_pairs: usize,
    /// Print JSON.
    #[arg(long)]
    json: bool,
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

impl Method {
    fn icp(self) -> IcpMethod {
        IcpMethod::PointToPoint(match self {
            Self::Quaternion => ClosedForm::Quaternion,
            Self::Svd => ClosedForm::Svd,
            Self::Orthonormal => ClosedForm::Orthonormal,
            Self::DualQuaternion => ClosedForm::DualQuaternion,
            Self::Helix => ClosedForm::Helix,
            Self::SmallAngle => ClosedForm::SmallAngle,
            Self::PointToPlane => return IcpMethod::PointToPlane,
            Self::Generalized => return IcpMethod::Generalized,
        })
    }
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

impl GlobalName {
    fn method(self) -> GlobalMethod {
        match self {
            Self::Se3 => GlobalMethod::Se3,
            Self::Euler => GlobalMethod::Euler,
            Self::Quaternion => GlobalMethod::Quaternion,
            Self::Helix => GlobalMethod::Helix,
            Self::SmallAngle => GlobalMethod::SmallAngle,
        }
    }
}

/// A registered scan.
#[derive(Serialize)]
struct Registered {
    file: String,
    points: usize,
    /// In the frame of the first scan: x y z (m), qx qy qz qw.
    pose: [f64; 7],
    iterations: usize,
    converged: bool,
    pairs: u64,
    rms: f64,
    /// Standard deviations of turn (rad) and shift (m); none for the first scan.
    deviations: Option<[f64; 6]>,
}

pub fn run(args: &RegisterArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    check(args)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(global.thread_count())
        .build()
        .map_err(|error| CliError::Failed(error.to_string()))?;
    let registered = pool.install(|| register(args))?;
    if args.json {
        print_json(&registered)?
    } else {
        print(&text(&registered))?
    }
    Ok(Outcome::Done)
}

fn check(args: &RegisterArgs) -> Result<(), CliError> {
    let positive = |name: &str, value: f64| match value > 0.0 && value < 1e6 {
        true => Ok(()),
        false => Err(CliError::Usage(format!("{name} must be above 0, but is {value}"))),
    };
    positive("--max-distance", args.max_distance)?;
    positive("--keep", args.keep)?;
    args.reduce.map_or(Ok(()), |edge| positive("--reduce", edge))?;
    args.robust.map_or(Ok(()), |scale| positive("--robust", scale))
}

fn register(args: &RegisterArgs) -> Result<Vec<Registered>, CliError> {
    let mut origin = None;
    let scans: Vec<ScanCloud> =
        args.scans.iter().map(|path| scan(path, args, &mut origin)).collect::<Result<_, _>>()?;
    let from_origin = Rigid3::from_parts(origin.unwrap_or([0.0; 3]).into(), Quaternion::identity());
    let options = IcpOptions {
        method: args.method.icp(),
        max_distance: args.max_distance,
        max_iterations: args.iterations,
        reciprocal: args.reciprocal,
        keep: args.keep,
        kernel: args.robust.map_or(RobustKernel::None, RobustKernel::Cauchy),
        ..IcpOptions::default()
    };
    let mut poses = vec![Rigid3::identity()];
    let mut results: Vec<Option<IcpResult>> = vec![None];
    let guess = args.guess.unwrap_or_else(Rigid3::identity);
    let mut step = from_origin.inverse() * guess * from_origin;
    for index in 1..scans.len() {
        let previous = poses[index - 1];
        let result = if args.metascan {
            let model = metascan(&scans[..index], &poses);
            icp(&model, &scans[index], &(previous * step), &options)
        } else {
            icp(&scans[index - 1], &scans[index], &step, &options)
                .map(|found| IcpResult { model_from_data: previous * found.model_from_data, ..found })
        };
        let Some(result) = result else {
            return Err(CliError::in_file(
                &args.scans[index],
                "too few points near the scan before it; give a better --guess or a larger --max-distance",
            ));
        };
        poses.push(result.model_from_data);
        results.push(Some(result));
        step = Rigid3::identity();
    }
    if args.global {
        let global = GlobalOptions {
            method: args.global_method.method(),
            max_distance: args.max_distance,
            max_iterations: args.iterations,
            ..GlobalOptions::default()
        };
        let links = links_by_overlap(&scans, &poses, args.min_pairs, args.max_distance);
        register_globally(&scans, &mut poses, &links, &global)
            .map_err(|error| CliError::Failed(error.to_string()))?;
    }
    Ok(args
        .scans
        .iter()
        .zip(&scans)
        .zip(poses.iter().zip(&results))
        .map(|((path, scan), (pose, result))| {
            let pose = from_origin * pose * from_origin.inverse();
            describe(path, scan, &pose, result.as_ref())
        })
        .collect())
}

fn describe(path: &Path, scan: &ScanCloud, pose: &Rigid3, result: Option<&IcpResult>) -> Registered {
    let (t, q) = (pose.translation, pose.rotation.quaternion());
    Registered {
        file: path.display().to_string(),
        points: scan.points().len(),
        pose: [t.x, t.y, t.z, q.i, q.j, q.k, q.w],
        iterations: result.map_or(0, |r| r.iterations),
        converged: result.is_none_or(|r| r.converged),
        pairs: result.map_or(0, |r| r.pairs),
        rms: result.map_or(0.0, |r| r.rms),
        deviations: result
            .and_then(|r| r.covariance)
            .map(|c| std::array::from_fn(|k| c[(k, k)].max(0.0).sqrt())),
    }
}

/// All scans so far as one.
fn metascan(scans: &[ScanCloud], poses: &[Rigid3]) -> ScanCloud {
    let mut points = Vec::new();
    for (scan, pose) in scans.iter().zip(poses) {
        points.extend(scan.points().iter().map(|p| {
            let x = pose * na::Point3::from(p.map(f64::from));
            [x.x as f32, x.y as f32, x.z as f32]
        }));
    }
    ScanCloud::with_surfaces(points, NORMAL_NEIGHBOURS, f32::INFINITY)
}

/// Reads a scan, relative to the first point of the first one where coordinates are too large for single precision.
fn scan(path: &Path, args: &RegisterArgs, origin: &mut Option<[f64; 3]>) -> Result<ScanCloud, CliError> {
    let failed = |error: portolan_pointcloud::CloudError| CliError::in_file(path, error);
    let mut reader = portolan_pointcloud::open(path).map_err(failed)?;
    let (mut points, mut batch) = (Vec::new(), PointCloud::default());
    while reader.next_batch(&mut batch).map_err(failed)? {
        for position in (0..batch.len()).map(|i| batch.position(i)) {
            let far = position.iter().any(|v| v.abs() > SINGLE_PRECISION_REACH);
            let origin = origin.get_or_insert(if far { position } else { [0.0; 3] });
            points.push(std::array::from_fn(|k| (position[k] - origin[k]) as f32));
        }
    }
    for repair in reader.repairs() {
        say(&format!("{}: {} ({})", path.display(), repair.what, counted(repair.count, "time", "times")));
    }
    if let Some(edge) = args.reduce {
        points = reduce(&points, edge as f32, VoxelRepresentative::Random(1));
    }
    if points.len() < 4 {
        return Err(CliError::in_file(path, "the scan has fewer than four points"));
    }
    Ok(match args.method {
        Method::PointToPlane | Method::Generalized => {
            ScanCloud::with_surfaces(points, NORMAL_NEIGHBOURS, f32::INFINITY)
        }
        _ => ScanCloud::new(points),
    })
}

fn text(registered: &[Registered]) -> String {
    let mut text = String::new();
    for scan in registered {
        let [x, y, z, qx, qy, qz, qw] = scan.pose;
        let rotation = Quaternion::new_normalize(na::Quaternion::new(qw, qx, qy, qz));
        let (roll, pitch, yaw) = rotation.euler_angles();
        text += &format!(
            "{}: x {x:.4} y {y:.4} z {z:.4} m, roll {:.3} pitch {:.3} yaw {:.3} deg",
            scan.file,
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees()
        );
        if scan.iterations > 0 {
            text += &format!(
                "; {} within {:.4} m rms, {}{}",
                counted(scan.pairs, "pair", "pairs"),
                scan.rms,
                counted(scan.iterations as u64, "iteration", "iterations"),
                if scan.converged { "" } else { ", not converged" }
            );
        }
        text += "\n";
    }
    text
}

/// `x,y,z,roll,pitch,yaw`.
fn pose(text: &str) -> Result<Rigid3, String> {
    let values: Vec<f64> = text.split(',').filter_map(|v| v.trim().parse().ok()).collect();
    match values.as_slice() {
        [x, y, z, roll, pitch, yaw] if values.iter().all(|v| v.is_finite()) => Ok(Rigid3::from_parts(
            na::Translation3::new(*x, *y, *z),
            rotation_from_roll_pitch_yaw(*roll, *pitch, *yaw),
        )),
        _ => Err("expected six numbers: x,y,z in metres and roll,pitch,yaw in radians".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::pose;

    #[test]
    fn poses_have_six_numbers() {
        let found = pose("1,2,-3, 0,0,1.5").unwrap();
        assert!(found.translation.z == -3.0 && (found.rotation.angle() - 1.5).abs() < 1e-12);
        assert!(pose("1,2,3").is_err() && pose("1,2,3,4,5,x").is_err());
    }
}
