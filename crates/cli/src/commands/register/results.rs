//! What a registration prints and writes.

use std::path::{Path, PathBuf};

use portolan_export::{PointImage, PointView, encode_grey, write_tum};
use portolan_geometry::{Quaternion, Rigid3, Time, nalgebra as na};
use portolan_pointcloud::{
    Attributes, CloudError, PointCloud, UosFrame, WriteOptions, create, uos_frames_text, uos_pose_text,
};
use portolan_refinement::registration::ClosedLoop;
use serde::Serialize;

use super::Work;
use super::input::Scans;
use super::options::IcpArgs;
use super::trust::doubt;
use crate::error::CliError;
use crate::output::{counted, write_file};

/// Longest edge of the pictures, pixels, and least metres per pixel.
const EDGE: usize = 1600;
const FINEST: f64 = 0.005;

/// Poses of all scans, stage after stage.
pub struct History(Vec<(u32, Vec<Rigid3>)>);

impl History {
    /// Kinds of states as `.frames` files name them.
    pub const ICP: u32 = 1;
    const GIVEN: u32 = 2;
    pub const GLOBAL: u32 = 3;
    pub const LOOPS: u32 = 4;

    /// What is given.
    pub fn starting(poses: &[Rigid3]) -> Self {
        Self(vec![(Self::GIVEN, poses.to_vec())])
    }

    /// After a stage.
    pub fn add(&mut self, poses: &[Rigid3], kind: u32) {
        self.0.push((kind, poses.to_vec()));
    }
}

/// A registered scan.
#[derive(Serialize)]
pub struct Registered {
    pub file: String,
    points: usize,
    /// x y z (m), qx qy qz qw; in the frame of the first scan unless first poses say otherwise.
    pose: [f64; 7],
    /// Why it could not be matched with the scans before it.
    error: Option<String>,
    iterations: usize,
    converged: bool,
    pairs: u64,
    rms: f64,
    /// What speaks against the result; it is worth nothing then.
    pub doubt: Option<String>,
    /// Standard deviations of turn (rad) and shift (m) after ICP; none for the first scan.
    deviations: Option<[f64; 6]>,
    /// The covariance they are from, row by row.
    covariance: Option<[[f64; 6]; 6]>,
    /// Standard deviations of shift (m) and turn (rad) after the global matching.
    global_deviations: Option<[f64; 6]>,
}

/// All scans with their results.
pub fn describe(scans: &Scans, work: &Work, icp: &IcpArgs) -> Vec<Registered> {
    let covariances = work.global.as_ref().map(|g| g.covariances.as_slice()).unwrap_or_default();
    (0..scans.clouds.len())
        .map(|i| {
            let pose = scans.of_file(&work.poses[i]);
            let (t, q) = (pose.translation, pose.rotation.quaternion());
            let matched = work.sequence.matched.get(i).and_then(Option::as_ref);
            let result = matched.and_then(|m| m.as_ref().ok());
            let deviations = |c: &na::Matrix6<f64>| std::array::from_fn(|k| c[(k, k)].max(0.0).sqrt());
            let doubt = result.and_then(|r| doubt(r, scans.clouds[i].points().len(), icp));
            // What is not good to anything is not good to millimetres.
            let covariance = result.and_then(|r| r.covariance).filter(|_| doubt.is_none());
            Registered {
                file: scans.names[i].clone(),
                points: scans.clouds[i].points().len(),
                pose: [t.x, t.y, t.z, q.i, q.j, q.k, q.w],
                error: matched.and_then(|m| m.as_ref().err()).map(ToString::to_string),
                iterations: result.map_or(0, |r| r.iterations),
                converged: result.is_none_or(|r| r.converged),
                pairs: result.map_or(0, |r| r.pairs),
                rms: result.map_or(0.0, |r| r.rms),
                doubt,
                deviations: covariance.as_ref().map(deviations),
                covariance: covariance.map(|c| std::array::from_fn(|r| std::array::from_fn(|k| c[(r, k)]))),
                global_deviations: covariances.get(i).filter(|_| i > 0).map(deviations),
            }
        })
        .collect()
}

/// How the global matching went.
#[derive(Serialize)]
struct GlobalSummary {
    iterations: usize,
    converged: bool,
    links: usize,
    pairs: u64,
    rms: f64,
    shift: f64,
}

#[derive(Serialize)]
pub struct RegisterReport<'a> {
    scans: &'a [Registered],
    loops: &'a [ClosedLoop],
    global: Option<GlobalSummary>,
}

/// Everything for programs.
pub fn report<'a>(work: &'a Work, registered: &'a [Registered]) -> RegisterReport<'a> {
    let global = work.global.as_ref().map(|g| GlobalSummary {
        iterations: g.iterations,
        converged: g.converged,
        links: g.links,
        pairs: g.pairs,
        rms: g.rms,
        shift: g.shift,
    });
    RegisterReport { scans: registered, loops: &work.sequence.loops, global }
}

/// Everything for people.
pub fn text(work: &Work, registered: &[Registered], files: &[PathBuf]) -> String {
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
        if let Some(d) = scan.deviations {
            let [shift, turn] = [&d[3..], &d[..3]].map(|part| part.iter().map(|v| v * v).sum::<f64>().sqrt());
            text += &format!(", good to {:.2} mm and {:.4} deg", 1e3 * shift, turn.to_degrees());
        }
        if scan.doubt.is_some() {
            text += ", NOT to be trusted";
        }
        if let Some(error) = &scan.error {
            text += &format!("; not matched: {error}");
        }
        text += "\n";
    }
    for closed in &work.sequence.loops {
        text += &format!(
            "loop closed from scan {} to scan {}: {:.3} m and {:.3} deg shared out\n",
            closed.first,
            closed.last,
            closed.shift,
            closed.turn.to_degrees()
        );
    }
    if let Some(global) = &work.global {
        text += &format!(
            "all at once: {}, {} within {:.4} m rms, {}{}\n",
            counted(global.links as u64, "link", "links"),
            counted(global.pairs, "pair", "pairs"),
            global.rms,
            counted(global.iterations as u64, "iteration", "iterations"),
            if global.converged { "" } else { ", not converged" }
        );
    }
    for file in files {
        text += &format!("{}\n", file.display());
    }
    text
}

/// Writes poses, frames, the joined cloud, pictures and the report; returns their names.
pub fn write_results(
    folder: &Path,
    extension: &str,
    scans: &Scans,
    work: &Work,
    registered: &[Registered],
) -> Result<Vec<PathBuf>, CliError> {
    std::fs::create_dir_all(folder).map_err(|source| CliError::File { path: folder.to_owned(), source })?;
    let mut files = Vec::new();
    let mut file = |name: &str| {
        files.push(folder.join(name));
        folder.join(name)
    };
    let poses: Vec<Rigid3> = work.poses.iter().map(|pose| scans.of_file(pose)).collect();
    let timed: Vec<(Time, Rigid3)> =
        poses.iter().enumerate().map(|(i, pose)| (Time::from_unix_seconds(i as f64), *pose)).collect();
    write_tum(&file("poses.tum"), &timed)?;
    for (i, pose) in poses.iter().enumerate() {
        let states = work.history.0.iter();
        let frames: Vec<UosFrame> = states
            .map(|(kind, poses)| UosFrame { world_from_scan: scans.of_file(&poses[i]), kind: *kind })
            .collect();
        let texts = [("pose", uos_pose_text(pose)), ("frames", uos_frames_text(&frames))];
        for (extension, text) in texts {
            let path = folder.join(format!("scan{i:03}.{extension}"));
            write_file(&path, |out| out.write_all(text.as_bytes()))?;
        }
    }
    file("scan000.pose");
    file("scan000.frames");
    write_cloud(&file(&format!("registered.{extension}")), scans, &poses)?;
    let start = &work.history.0[0].1;
    for (name, image, view) in pictures(scans, start, &work.poses) {
        let png =
            encode_grey(view.width, view.height, &image).map_err(|e| CliError::Failed(e.to_string()))?;
        write_file(&file(name), |out| out.write_all(&png))?;
    }
    let report =
        serde_json::to_vec_pretty(&report(work, registered)).map_err(|e| CliError::Failed(e.to_string()))?;
    write_file(&file("report.json"), |out| out.write_all(&report))?;
    Ok(files)
}

/// All points of all files, not only those that were kept for matching.
fn write_cloud(path: &Path, scans: &Scans, poses: &[Rigid3]) -> Result<(), CliError> {
    let failed = |error: CloudError| CliError::Failed(error.to_string());
    let attributes: Attributes = match scans.sources.first() {
        Some(source) => source.open()?.attributes(),
        None => Attributes::default(),
    };
    let mut writer = create(path, attributes, &WriteOptions::default()).map_err(failed)?;
    let (mut batch, mut placed) = (PointCloud::default(), PointCloud::new(attributes));
    for (source, pose) in scans.sources.iter().zip(poses) {
        let mut reader = source.open()?;
        while reader.next_batch(&mut batch).map_err(failed)? {
            placed.reset(attributes);
            for i in 0..batch.len() {
                let Some(point) = scans.input.point(batch.position(i)) else { continue };
                placed.push(
                    (pose * na::Point3::from(point)).coords.into(),
                    batch.intensity(i).unwrap_or(0.0),
                    batch.time(i).unwrap_or(0.0),
                    batch.color(i).unwrap_or([0; 3]),
                );
            }
            writer.write(&placed).map_err(failed)?;
        }
    }
    writer.finish().map_err(failed)?;
    Ok(())
}

/// Seen from above, before and after, in the same greys.
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
    vec![("before.png", first, view), ("after.png", second, view)]
}
