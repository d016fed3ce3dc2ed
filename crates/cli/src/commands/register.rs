//! `portolan register`: registers scans with each other.

mod input;
mod options;
mod summary;

use std::path::PathBuf;

use portolan::job::OutputFolder;
use portolan::job::register::{
    History, Registered, Registration, Scans, describe, registered_files, report, write_registration,
};
use portolan_geometry::{Rigid3, nalgebra as na, rotation_from_roll_pitch_yaw};
use portolan_registration::{
    GlobalReport, IcpError, Link, ScanCloud, SequenceReport, links_by_distance, links_by_overlap,
    register_globally_twice, register_sequence, unlinked_scans,
};

use super::map::remarks;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, make_folder, print, print_json, print_summary};
use crate::progress::{Progress, print_line};
use input::{InputArgs, read_links, read_scans};
use options::{GlobalMatchingArgs, IcpArgs, LinksName, LoopArgs, SurfacesOf};
use summary::{ADVICE, text};

/// Register scans: estimate the pose of each scan in the frame of the first.
///
/// Scans are files of points (PLY, PCD, text, LAS, LAZ, E57, uos), metres, or a folder of uos scans with
/// their initial poses. Each scan is matched with the one before it (--metascan: with all before it),
/// starting from its initial pose with the correction of that one; with --close-loops errors are distributed
/// where the trajectory returns to an earlier place, and with --global all scans are then matched at once (Lu
/// and Milios in six degrees of freedom).
///
/// Exit code 4, and no files without --force, if the scans do not overlap or matching did not converge; 3 if
/// that is so for some of several scans.
#[derive(clap::Args, Clone, Debug)]
#[command(after_help = "Examples:\n  \
    portolan register scan000.ply scan001.ply\n  \
    portolan register a.pcd b.pcd c.pcd --method point-to-plane --reduce 0.1 --global -o together\n  \
    portolan register hannover1/ --reduce 0.1 --close-loops --global -o together\n  \
    portolan register map.ply scan.ply --guess 10,2,0,0,0,1.57 --json")]
pub struct RegisterArgs {
    /// Files of scans, or a folder of uos scans; the pose of the first scan stays.
    #[arg(required = true, num_args = 1.., value_name = "SCAN")]
    scans: Vec<PathBuf>,
    /// Initial pose of the second scan in the first: x,y,z (metres), roll,pitch,yaw (radians).
    #[arg(long, value_name = "X,Y,Z,R,P,Y", value_parser = pose, allow_hyphen_values = true, conflicts_with = "poses")]
    guess: Option<Rigid3>,
    /// Initial poses of all scans, one per line in their order (TUM; times are ignored).
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Folder for results: poses.tum, a .pose and a .frames for each scan, the joined cloud, top views before
    /// and after, report.json. Created if missing.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Format of the joined cloud.
    #[arg(long, value_parser = ["ply", "pcd", "xyz", "las", "laz", "e57"], default_value = "ply", value_name = "FORMAT", requires = "output")]
    cloud: String,
    /// Also write unreliable results, and overwrite files in the folder that were not written by an earlier
    /// `register`.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    input: InputArgs,
    #[command(flatten)]
    icp: IcpArgs,
    #[command(flatten)]
    loops: LoopArgs,
    #[command(flatten)]
    global: GlobalMatchingArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &RegisterArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(global.thread_count())
        .build()
        .map_err(|error| CliError::Failed(error.to_string()))?;
    pool.install(|| run_on_pool(args, global))
}

fn run_on_pool(args: &RegisterArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let sequence = args.icp.sequence(&args.loops)?;
    args.global.check()?;
    let surfaces = if args.global.planes() { SurfacesOf::All } else { args.icp.surfaces() };
    let mut scans = read_scans(&args.scans, &args.input, surfaces, global.quiet)?;
    if scans.clouds.len() < 2 {
        return Err(CliError::Usage(format!("{} holds one scan; two are needed", args.scans[0].display())));
    }
    let _made = args.output.as_deref().map(make_folder).transpose()?;
    let folder = output_folder(args, scans.clouds.len(), global)?;
    let guesses = first_poses(args, &mut scans)?;
    let mut work = Registration {
        poses: guesses.clone(),
        sequence: SequenceReport { matched: Vec::new(), loops: Vec::new() },
        global: None,
        history: History::starting(&guesses),
    };
    let mut progress = Progress::start("registering", scans.clouds.len() as u64, global.quiet);
    work.sequence = register_sequence(&scans.clouds, &mut work.poses, &sequence, &mut |index| {
        progress.update(index as u64 + 1, scans.clouds.len() as u64, format!("scan {index}"));
    });
    progress.finish();
    let lost = unmatched(&scans, &work.sequence, global.quiet)?;
    work.history.add(&work.poses, if work.sequence.loops.is_empty() { History::ICP } else { History::LOOPS });
    if args.global.global {
        work.global = Some(match_globally(args, &scans, &mut work.poses, global.quiet)?);
        work.history.add(&work.poses, History::GLOBAL);
    }
    let registered: Vec<Registered> = describe(&scans, &work, &sequence.icp);
    let outcome = trusted(&work, &registered, global.quiet);
    let files = match &folder {
        Some(_) if outcome == Outcome::Untrusted && !args.force => Vec::new(),
        Some(folder) => {
            let mut observe = remarks(global);
            write_registration(folder, &args.cloud, &scans, &work, &registered, &mut observe)?
        }
        None => Vec::new(),
    };
    if args.json {
        print_json(&report(&work, &registered))?;
    } else if files.is_empty() {
        print(&text(&work, &registered, &files))?;
    } else {
        print_summary(&text(&work, &registered, &files));
    }
    Ok(if lost || scans.lost_data { outcome.max(Outcome::DataLost) } else { outcome })
}

/// Folder for the results; none if no files are to be written.
fn output_folder(
    args: &RegisterArgs,
    scans: usize,
    global: &GlobalArgs,
) -> Result<Option<OutputFolder>, CliError> {
    let Some(folder) = &args.output else { return Ok(None) };
    let names = registered_files(scans, &args.cloud);
    Ok(Some(OutputFolder::begin(folder, "register", &names, args.force, &mut remarks(global))?))
}

/// Whether the result is reliable: all of it, part of the scans, or none. Reasons against it are reported.
fn trusted(work: &Registration, registered: &[Registered], quiet: bool) -> Outcome {
    let untrusted: Vec<&Registered> = registered.iter().filter(|scan| scan.distrust.is_some()).collect();
    let outcome = match &work.global {
        // After global matching a scan no longer depends on its match with the scan before.
        Some(global) if global.converged => Outcome::Done,
        Some(_) => Outcome::Untrusted,
        None if untrusted.is_empty() => Outcome::Done,
        None if untrusted.len() + 1 >= registered.len() => Outcome::Untrusted,
        None => Outcome::DataLost,
    };
    if outcome != Outcome::Done && !quiet {
        for scan in untrusted {
            print_line(&format!(
                "{}: NOT registered: {}",
                scan.file,
                scan.distrust.as_deref().unwrap_or_default()
            ));
        }
        if work.global.is_some() {
            print_line("the global matching of all scans did not converge");
        }
        print_line(ADVICE);
    }
    outcome
}

/// Initial poses of the scans, relative to the common origin of the points.
fn first_poses(args: &RegisterArgs, scans: &mut Scans) -> Result<Vec<Rigid3>, CliError> {
    let count = scans.clouds.len();
    let poses: Vec<Rigid3> = match (&args.poses, args.guess) {
        (Some(path), _) => input::read_poses(path, count)?,
        // The correction of each scan is applied to the next one, so that the same guess serves for all scans.
        (None, Some(guess)) => (0..count).map(|i| if i == 0 { Rigid3::identity() } else { guess }).collect(),
        (None, None) => scans.guesses.clone(),
    };
    scans.count_from(poses.first().unwrap_or(&Rigid3::identity()));
    Ok(poses.iter().map(|pose| scans.about_origin(pose)).collect())
}

/// Reports scans that could not be matched; returns whether there are any. It is an error if no scan could be matched;
/// for two scans that do not overlap the error is [`CliError::Untrusted`].
fn unmatched(scans: &Scans, report: &SequenceReport, quiet: bool) -> Result<bool, CliError> {
    let mut lost = 0;
    for (index, result) in report.matched.iter().enumerate() {
        let Some(Err(error)) = result else { continue };
        lost += 1;
        if scans.clouds.len() == 2 {
            let message = format!("{}: {error}", scans.names[index]);
            let is_apart = matches!(error, IcpError::TooFewPairs { .. });
            return Err(if is_apart { CliError::Untrusted(message) } else { CliError::Failed(message) });
        }
        if !quiet {
            print_line(&format!("{}: {error}; it was moved with the scan before it", scans.names[index]));
        }
    }
    match lost + 1 == report.matched.len() {
        true => Err(CliError::Failed("no scan could be matched with those before it".to_owned())),
        false => Ok(lost > 0),
    }
}

fn match_globally(
    args: &RegisterArgs,
    scans: &Scans,
    poses: &mut [Rigid3],
    quiet: bool,
) -> Result<GlobalReport, CliError> {
    let options = args.global.options(&args.icp);
    let clouds: &[ScanCloud] = &scans.clouds;
    let links: Vec<Link> = match &args.global.links_file {
        Some(path) => read_links(path, clouds.len())?,
        None => match args.global.links {
            LinksName::Overlap => {
                links_by_overlap(clouds, poses, args.global.min_pairs, options.max_distance)
            }
            LinksName::Distance => links_by_distance(poses, args.global.link_gap, args.global.link_distance),
        },
    };
    if links.is_empty() {
        return Err(CliError::Failed(
            "no two scans are linked for the global matching: take a larger --global-distance, a smaller \
             --min-pairs, or --links distance"
                .to_owned(),
        ));
    }
    let alone = unlinked_scans(clouds.len(), &links);
    if !alone.is_empty() && !quiet {
        let names: Vec<&str> = alone.iter().map(|i| scans.names[*i].as_str()).take(5).collect();
        print_line(&format!(
            "{} not linked with the first scan in the global matching, which matches them only to each other: {}{}",
            counted(alone.len() as u64, "scan is", "scans are"),
            names.join(", "),
            if alone.len() > names.len() { ", …" } else { "" }
        ));
    }
    register_globally_twice(clouds, poses, &links, &options, args.global.last_distance)
        .map_err(|error| CliError::Failed(error.to_string()))
}

/// Pose from `x,y,z,roll,pitch,yaw`, metres and radians.
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
