//! Writes the results of a registration.

use std::path::{Path, PathBuf};

use portolan_export::{PointImage, PointView, encode_grey, write_tum};
use portolan_geometry::{Rigid3, Time, nalgebra as na};
use portolan_pointcloud::{
    Attributes, PointCloud, UosFrame, WriteOptions, create, uos_frames_text, uos_pose_text,
};
use portolan_registration::{ClosedLoop, GlobalReport, IcpOptions, SequenceReport};
use serde::Serialize;

use super::scans::Scans;
use super::trust::reason_for_distrust;
use crate::job::error::write_file;
use crate::job::{JobError, Observer, OutputFolder, REPORT_VERSION, Stale};

/// Longest edge of the pictures, pixels.
const EDGE: usize = 1600;
/// Minimum size of a pixel, metres.
const FINEST: f64 = 0.005;

/// Names of the pictures.
const BEFORE: &str = "before.png";
const AFTER: &str = "after.png";

/// Results of a registration.
pub struct Registration {
    /// Pose of each scan, from its points in memory.
    pub poses: Vec<Rigid3>,
    /// Results of scan-to-scan matching, and loops.
    pub sequence: SequenceReport,
    /// Results of the global matching.
    pub global: Option<GlobalReport>,
    /// Poses after each stage.
    pub history: History,
}

/// Poses of all scans, stage after stage.
pub struct History(Vec<(u32, Vec<Rigid3>)>);

impl History {
    /// Kinds of states as `.frames` files name them.
    pub const ICP: u32 = 1;
    /// Given beforehand.
    const GIVEN: u32 = 2;
    /// After the global matching.
    pub const GLOBAL: u32 = 3;
    /// After loops were closed.
    pub const LOOPS: u32 = 4;

    /// With the given poses.
    pub fn starting(poses: &[Rigid3]) -> Self {
        Self(vec![(Self::GIVEN, poses.to_vec())])
    }

    /// Adds the poses after a stage.
    pub fn add(&mut self, poses: &[Rigid3], kind: u32) {
        self.0.push((kind, poses.to_vec()));
    }
}

/// A registered scan.
#[derive(Serialize)]
pub struct Registered {
    /// Its name.
    pub file: String,
    /// Number of points that are matched.
    pub points: usize,
    /// x y z (m), qx qy qz qw; in the frame of the first scan unless first poses say otherwise.
    pub pose: [f64; 7],
    /// Why it could not be matched with the scans before it.
    pub error: Option<String>,
    /// Iterations of ICP.
    pub iterations: usize,
    /// Whether ICP converged.
    pub converged: bool,
    /// Pairs of points in the last iteration.
    pub pairs: u64,
    /// Root mean square of their distances, metres.
    pub rms: f64,
    /// Reason why the result cannot be trusted; it is then worthless.
    #[serde(rename = "doubt")]
    pub distrust: Option<String>,
    /// Standard deviations of rotation (rad) and translation (m) after ICP; none for the first scan.
    pub deviations: Option<[f64; 6]>,
    /// The covariance they are from, row by row.
    covariance: Option<[[f64; 6]; 6]>,
    /// Standard deviations of translation (m) and rotation (rad) after the global matching.
    global_deviations: Option<[f64; 6]>,
}

/// All scans with their results.
pub fn describe(scans: &Scans, work: &Registration, icp: &IcpOptions) -> Vec<Registered> {
    let covariances = work.global.as_ref().map(|g| g.covariances.as_slice()).unwrap_or_default();
    (0..scans.clouds.len())
        .map(|i| {
            let pose = scans.of_file(&work.poses[i]);
            let (t, q) = (pose.translation, pose.rotation.quaternion());
            let matched = work.sequence.matched.get(i).and_then(Option::as_ref);
            let result = matched.and_then(|m| m.as_ref().ok());
            let deviations = |c: &na::Matrix6<f64>| std::array::from_fn(|k| c[(k, k)].max(0.0).sqrt());
            let distrust = result.and_then(|r| reason_for_distrust(r, scans.clouds[i].points().len(), icp));
            // For an untrusted result the covariance is meaningless.
            let covariance = result.and_then(|r| r.covariance).filter(|_| distrust.is_none());
            Registered {
                file: scans.names[i].clone(),
                points: scans.clouds[i].points().len(),
                pose: [t.x, t.y, t.z, q.i, q.j, q.k, q.w],
                error: matched.and_then(|m| m.as_ref().err()).map(ToString::to_string),
                iterations: result.map_or(0, |r| r.iterations),
                converged: result.is_none_or(|r| r.converged),
                pairs: result.map_or(0, |r| r.pairs),
                rms: result.map_or(0.0, |r| r.rms),
                distrust,
                deviations: covariance.as_ref().map(deviations),
                covariance: covariance.map(|c| std::array::from_fn(|r| std::array::from_fn(|k| c[(r, k)]))),
                global_deviations: covariances.get(i).filter(|_| i > 0).map(deviations),
            }
        })
        .collect()
}

/// Summary of the global matching.
#[derive(Serialize)]
struct GlobalSummary {
    iterations: usize,
    converged: bool,
    links: usize,
    pairs: u64,
    rms: f64,
    shift: f64,
}

/// The report for programs.
#[derive(Serialize)]
pub struct RegisterReport<'a> {
    version: u32,
    scans: &'a [Registered],
    loops: &'a [ClosedLoop],
    global: Option<GlobalSummary>,
}

/// Makes the report for programs.
pub fn report<'a>(work: &'a Registration, registered: &'a [Registered]) -> RegisterReport<'a> {
    let global = work.global.as_ref().map(|g| GlobalSummary {
        iterations: g.iterations,
        converged: g.converged,
        links: g.links,
        pairs: g.pairs,
        rms: g.rms,
        shift: g.shift,
    });
    RegisterReport { version: REPORT_VERSION, scans: registered, loops: &work.sequence.loops, global }
}

/// The files that [`write_registration`] writes for this number of scans and a cloud of this format.
pub fn registered_files(scans: usize, extension: &str) -> Vec<String> {
    let fixed = ["poses.tum", BEFORE, AFTER, "report.json"].map(str::to_owned);
    fixed.into_iter().chain([cloud_name(extension)]).chain(scan_files(scans)).collect()
}

fn cloud_name(extension: &str) -> String {
    format!("registered.{extension}")
}

fn scan_files(scans: usize) -> Vec<String> {
    (0..scans).flat_map(|i| [format!("scan{i:03}.pose"), format!("scan{i:03}.frames")]).collect()
}

/// Writes poses, frames, the joined cloud, pictures and the report; returns their names.
///
/// # Errors
/// Files that cannot be read or written.
pub fn write_registration(
    folder: &OutputFolder,
    extension: &str,
    scans: &Scans,
    work: &Registration,
    registered: &[Registered],
    observe: &mut Observer,
) -> Result<Vec<PathBuf>, JobError> {
    let mut files = Vec::new();
    let poses: Vec<Rigid3> = work.poses.iter().map(|pose| scans.of_file(pose)).collect();
    let timed: Vec<(Time, Rigid3)> =
        poses.iter().enumerate().map(|(i, pose)| (Time::from_unix_seconds(i as f64), *pose)).collect();
    write_tum(&folder.add("poses.tum", &mut files)?, &timed)?;
    folder.files(&scan_files(poses.len()))?;
    for (i, pose) in poses.iter().enumerate() {
        let states = work.history.0.iter();
        let frames: Vec<UosFrame> = states
            .map(|(kind, poses)| UosFrame { world_from_scan: scans.of_file(&poses[i]), kind: *kind })
            .collect();
        let texts = [("pose", uos_pose_text(pose)), ("frames", uos_frames_text(&frames))];
        for (extension, text) in texts {
            let path = folder.path().join(format!("scan{i:03}.{extension}"));
            write_file(&path, text.as_bytes())?;
        }
    }
    files.extend(["scan000.pose", "scan000.frames"].map(|name| folder.path().join(name)));
    let cloud = folder.add(&cloud_name(extension), &mut files)?;
    write_cloud(&cloud, scans, &poses)?;
    let start = &work.history.0[0].1;
    for (name, image, view) in pictures(scans, start, &work.poses) {
        let png = encode_grey(view.width, view.height, &image).map_err(JobError::Drawing)?;
        write_file(&folder.add(name, &mut files)?, &png)?;
    }
    let report = serde_json::to_vec_pretty(&report(work, registered))?;
    write_file(&folder.add("report.json", &mut files)?, &report)?;
    let inputs: Vec<PathBuf> = scans.sources.iter().map(|source| source.path().to_owned()).collect();
    folder.finish(Stale::Remove, &inputs, observe)?;
    Ok(files)
}

/// Writes all points of all files, not only those that were kept for matching.
fn write_cloud(path: &Path, scans: &Scans, poses: &[Rigid3]) -> Result<(), JobError> {
    let attributes: Attributes = match scans.sources.first() {
        Some(source) => source.open()?.attributes(),
        None => Attributes::default(),
    };
    let mut writer = create(path, attributes, &WriteOptions::default())?;
    let (mut batch, mut placed) = (PointCloud::default(), PointCloud::new(attributes));
    for (source, pose) in scans.sources.iter().zip(poses) {
        let mut reader = source.open()?;
        while reader.next_batch(&mut batch)? {
            placed.reset(attributes);
            for i in 0..batch.len() {
                let Some(point) = scans.limits.point(batch.position(i)) else { continue };
                placed.push(
                    (pose * na::Point3::from(point)).coords.into(),
                    batch.intensity(i).unwrap_or(0.0),
                    batch.time(i).unwrap_or(0.0),
                    batch.color(i).unwrap_or([0; 3]),
                );
            }
            writer.write(&placed)?;
        }
    }
    writer.finish()?;
    Ok(())
}

/// Pictures from above, before and after, in the same greys.
fn pictures(scans: &Scans, before: &[Rigid3], after: &[Rigid3]) -> Vec<(&'static str, Vec<u8>, PointView)> {
    let place = |pose: &Rigid3, p: &[f32; 3]| -> [f64; 3] {
        (pose * na::Point3::from(p.map(f64::from))).coords.into()
    };
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for poses in [before, after] {
        for (cloud, pose) in scans.clouds.iter().zip(poses) {
            for p in cloud.points().iter().map(|p| place(pose, p)) {
                for k in 0..3 {
                    (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
                }
            }
        }
    }
    let centre = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
    let size = [1.02 * (high[0] - low[0]).max(0.1), 1.02 * (high[1] - low[1]).max(0.1)];
    let view = PointView::new(centre, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], size, EDGE, FINEST);
    let images = [before, after].map(|poses| {
        let mut image = PointImage::new(&view);
        for (cloud, pose) in scans.clouds.iter().zip(poses) {
            cloud.points().iter().for_each(|p| image.add(&view, place(pose, p)));
        }
        image
    });
    let strong = images.iter().map(PointImage::strong_count).max().unwrap_or(1);
    let [first, second] = images.map(|image| image.grey(strong));
    vec![(BEFORE, first, view), (AFTER, second, view)]
}
