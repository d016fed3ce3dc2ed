//! `portolan evaluate cloud`: measures the sharpness of clouds and their distance from true surfaces.

mod input;
mod truth;

use std::path::PathBuf;

use portolan_evaluation::cloud::{
    CloudQuality, CloudToJudge, PairedComparison, PassOptions, QualityOptions, SharpnessOptions,
    SurfaceErrors, cloud_quality, compare_places, place_of,
};
use serde::Serialize;

use crate::GlobalArgs;
use crate::commands::refine::points::PointArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print, print_json};
use crate::progress::print_line;
use input::{Clouds, JudgedCloud, read_clouds};
use truth::{Truth, TruthArgs};

/// Edge of the cells in which clouds are compared, metres.
const PLACE: f64 = 2.0;
/// Ratio of densities above which two clouds are reported as not comparable; dimensionless.
const LIKE_DENSITY: f64 = 1.1;

/// Evaluate a cloud: how sharp it is, and with the truth how far its points are from the true surfaces.
///
/// A cloud is a file of points (PLY, PCD, text, LAS, LAZ, E57, a folder of uos scans), or the raw points of a
/// recording, each placed by a trajectory at its own time. Of several clouds, each is compared with the
/// first, place by place.
///
/// Without truth, the report has: mean map entropy and mean plane variance (Razlaw et al. 2015), the mutual
/// orthogonality metric (Kornilova and Ferrer 2021), the thickness of walls, and for points with times the
/// distance between passes. Lower is sharper. These figures are comparable only between clouds of one
/// density, measured with the same radius.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    portolan evaluate cloud walk_refined/refined.ply\n  \
    portolan evaluate cloud before.las after.las --json\n  \
    portolan evaluate cloud scan.e57 --reference survey.laz --beyond 0.5\n  \
    portolan evaluate cloud walk.bag walk.tum walk_refined/refined.tum\n  \
    portolan evaluate cloud walk.bag refined.tum --surfaces walk.surfaces.csv --truth walk.truth.tum")]
pub struct CloudArgs {
    /// Clouds; or a recording and the trajectories (TUM, a map, or a table) that place its points.
    #[arg(required = true, value_name = "CLOUD | RECORDING TRAJECTORY")]
    inputs: Vec<PathBuf>,
    #[command(flatten)]
    points: PointArgs,
    #[command(flatten)]
    truth: TruthArgs,
    /// Radius of the neighbourhoods, metres.
    #[arg(long, value_name = "METRES", default_value_t = SharpnessOptions::default().radius)]
    radius: f64,
    /// Number of points that are examined, evenly spread. A larger number makes neighbourhoods denser.
    #[arg(long, value_name = "N", default_value_t = SharpnessOptions::default().max_points)]
    sample: usize,
    /// Minimum time between two passes of the same place.
    #[arg(long, value_name = "SECONDS", default_value_t = PassOptions::default().gap)]
    pass_gap: f64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct CloudReport {
    /// File of the cloud or of the trajectory.
    cloud: String,
    /// Number of points of the cloud, of which `points` were examined.
    total_points: u64,
    #[serde(flatten)]
    quality: CloudQuality,
    surfaces: Option<SurfaceErrors>,
    #[serde(skip)]
    distances: Vec<([i32; 3], f64)>,
}

/// Comparison of a cloud with the first one.
#[derive(Serialize)]
struct Comparison {
    before: String,
    after: String,
    changes: Vec<PairedComparison>,
}

#[derive(Serialize)]
struct Report {
    options: QualityOptions,
    clouds: Vec<CloudReport>,
    comparisons: Vec<Comparison>,
}

pub fn run(args: &CloudArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let options = options(args)?;
    let truth = args.truth.read(global)?;
    let Clouds { clouds, lost_data } =
        read_clouds(&args.inputs, &args.points, args.truth.trajectory(), args.sample, global)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(global.thread_count())
        .build()
        .map_err(|error| CliError::Failed(error.to_string()))?;
    let reports: Vec<CloudReport> =
        pool.install(|| clouds.iter().map(|cloud| judge(cloud, &options, truth.as_ref())).collect());
    let comparisons = comparisons(&reports, global.quiet);
    let report = Report { options, clouds: reports, comparisons };
    if args.json {
        print_json(&report)?
    } else {
        print(&text(&report))?
    }
    let lost_data = lost_data || truth.is_some_and(|truth| truth.lost_data);
    Ok(if lost_data { Outcome::DataLost } else { Outcome::Done })
}

fn options(args: &CloudArgs) -> Result<QualityOptions, CliError> {
    let within = |name: &str, value: f64, most: f64| match value > 0.0 && value <= most {
        true => Ok(value),
        false => Err(CliError::Usage(format!("{name} must be above 0 and at most {most}, but is {value}"))),
    };
    if !(100..=100_000_000).contains(&args.sample) {
        return Err(CliError::Usage(format!("--sample must be 100 to 100 million, but is {}", args.sample)));
    }
    let usual = QualityOptions::default();
    let radius = within("--radius", args.radius, 1e3)?;
    let sharpness = SharpnessOptions { radius, max_points: args.sample, ..usual.sharpness };
    let passes = PassOptions { gap: within("--pass-gap", args.pass_gap, 1e9)?, ..usual.passes };
    Ok(QualityOptions { sharpness, passes, ..usual })
}

fn judge(cloud: &JudgedCloud, options: &QualityOptions, truth: Option<&Truth>) -> CloudReport {
    let JudgedCloud { points, seconds, places, .. } = cloud;
    let quality = cloud_quality(&CloudToJudge { points, seconds, places }, options);
    let distances =
        truth.map(|truth| truth.distances(points, cloud.truth_from_cloud.as_ref())).unwrap_or_default();
    let at = if places.len() == points.len() { places } else { points };
    let beyond = truth.map_or(f64::INFINITY, |truth| truth.beyond);
    let by_place = at.iter().zip(&distances).filter(|(_, d)| **d <= beyond);
    CloudReport {
        cloud: cloud.name.clone(),
        total_points: cloud.total,
        quality,
        distances: by_place.map(|(p, d)| (place_of(*p, PLACE), 100.0 * d)).collect(),
        surfaces: truth.and_then(|truth| SurfaceErrors::of(distances, truth.beyond)),
    }
}

fn comparisons(reports: &[CloudReport], quiet: bool) -> Vec<Comparison> {
    let [first, others @ ..] = reports else { return Vec::new() };
    let density = |r: &CloudReport| r.quality.sharpness.map(|s| s.mean_neighbours);
    others
        .iter()
        .map(|other| {
            if let (Some(a), Some(b), false) = (density(first), density(other), quiet)
                && (a > LIKE_DENSITY * b || b > LIKE_DENSITY * a)
            {
                print_line(&format!(
                    "{} and {} are not equally dense ({a:.1} and {b:.1} points within the radius): entropy and \
                     thickness depend on that",
                    first.cloud, other.cloud
                ));
            }
            let mut changes = first.quality.compared_with(&other.quality);
            let what = "distance to the true surfaces (cm)";
            changes.extend(compare_places(what, &first.distances, &other.distances));
            Comparison { before: first.cloud.clone(), after: other.cloud.clone(), changes }
        })
        .collect()
}

fn text(report: &Report) -> String {
    let mut parts = Vec::new();
    for cloud in &report.clouds {
        parts.push(format!("{} ({} of {} points)", cloud.cloud, cloud.quality.points, cloud.total_points));
        parts.push(cloud.quality.to_string());
        parts.extend(cloud.surfaces.iter().map(ToString::to_string));
    }
    for comparison in &report.comparisons {
        parts.push(format!("From {} to {}", comparison.before, comparison.after));
        parts.extend(comparison.changes.iter().map(|change| format!("  {change}")));
        if comparison.changes.is_empty() {
            parts.push("  too few places are in both to compare them".to_owned());
        }
    }
    parts.join("\n")
}
