//! How much drift can be taken away? Disturbs the true trajectory of a recording in several ways, refines each, and
//! prints a line for each:
//! `study_drift RECORDING TRUTH.tum [FRAME] [kind=walk,jump,…] [drift=0.2:1,1.5:8] [seed=1,2] [method=semi-rigid]
//! [threads=2] [save=FOLDER]`.

use std::io::{BufReader, BufWriter};
use std::path::Path;

use portolan_evaluation::{
    Alignment, Association, TimedPose, Trajectory, absolute_errors, read_tum, write_tum,
};
use portolan_geometry::{Rigid3, Time, Vector3, nalgebra as na, quaternion_from_angle_axis};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_numeric::{Lcg64, SplitMix64};
use portolan_recording::open;
use portolan_refinement::PointStore;
use portolan_refinement::continuous::{ContinuousOptions, Refined, refine_continuous};
use portolan_refinement::semi_rigid::{SemiRigidOptions, refine_semi_rigid};
use portolan_sensor::Measurement;

type Poses = Vec<(Time, Rigid3)>;
type Failure = Box<dyn std::error::Error>;

/// A deterministic generator of noise.
struct Random(Lcg64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0.uniform()
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A curve over the poses that begins at 0, by the kind of drift; three components.
fn curve(kind: &str, seconds: &[f64], random: &mut Random) -> Result<Vec<Vector3>, Failure> {
    let last = seconds.last().copied().unwrap_or(1.0);
    let direction =
        |random: &mut Random| Vector3::new(random.normal(), random.normal(), 0.4 * random.normal());
    let curve: Vec<Vector3> = match kind {
        "bias" => {
            let slope = direction(random);
            seconds.iter().map(|s| slope * (s / last)).collect()
        }
        "smooth" => {
            let waves: Vec<(Vector3, f64)> =
                (1..5).map(|k| (direction(random) / f64::from(k), random.uniform() * 6.3)).collect();
            let at = |s: f64| -> Vector3 {
                let wave = |(k, (a, phase)): (usize, &(Vector3, f64))| {
                    a * ((k as f64 + 1.0) * 3.0 * s / last + phase).sin()
                };
                waves.iter().enumerate().map(wave).sum()
            };
            seconds.iter().map(|s| at(*s) - at(0.0)).collect()
        }
        "walk" => {
            let mut sum = Vector3::zeros();
            let step =
                |random: &mut Random| Vector3::new(random.normal(), random.normal(), 0.4 * random.normal());
            seconds
                .iter()
                .enumerate()
                .map(|(i, s)| {
                    let before = seconds[i.saturating_sub(1)];
                    sum += step(random) * (s - before).max(0.0).sqrt();
                    sum
                })
                .collect()
        }
        "jump" => {
            let jumps: Vec<(f64, Vector3)> =
                (0..3).map(|_| (last * (0.1 + 0.8 * random.uniform()), direction(random))).collect();
            let at = |s: f64| jumps.iter().filter(|j| j.0 < s).map(|j| j.1).sum();
            seconds.iter().map(|s| at(*s)).collect()
        }
        other => return Err(format!("{other} is no kind of drift: bias, smooth, walk, jump").into()),
    };
    let most = curve.iter().map(|c| c.norm()).fold(1e-12, f64::max);
    Ok(curve.into_iter().map(|c| c / most).collect())
}

/// Truth with drift of at most `metres` and `degrees`, mostly about z, and short errors of 1 cm and 0.15°.
fn disturbed(truth: &Poses, kind: &str, [metres, degrees]: [f64; 2], seed: u64) -> Result<Poses, Failure> {
    let start = truth[0].0;
    let seconds: Vec<f64> = truth.iter().map(|p| p.0.seconds_since(start)).collect();
    let mut random = Random(Lcg64::new(seed.wrapping_mul(SplitMix64::GAMMA) | 1));
    let shifts = curve(kind, &seconds, &mut random)?;
    let turns = curve(kind, &seconds, &mut random)?;
    let phases: Vec<f64> = (0..36).map(|_| random.uniform() * 6.3).collect();
    let jitter = |s: f64, axis: usize| -> f64 {
        let waves = (0..6).map(|k| (s * (3.0 + 2.1 * k as f64) + phases[6 * axis + k]).sin());
        waves.sum::<f64>() / 3.0_f64.sqrt() * (s / 0.5).min(1.0)
    };
    let disturb = |(i, (time, pose)): (usize, &(Time, Rigid3))| {
        let s = seconds[i];
        let short = |first: usize| Vector3::new(jitter(s, first), jitter(s, first + 1), jitter(s, first + 2));
        let shift = shifts[i] * metres + short(0) * 0.01;
        let turn = turns[i].xyz();
        let turn = Vector3::new(0.15 * turn.x, 0.15 * turn.z, turn.y) * degrees.to_radians()
            + short(3) * 0.15_f64.to_radians();
        let rotation = quaternion_from_angle_axis(&turn) * pose.rotation;
        (*time, Rigid3::from_parts(na::Translation3::from(pose.translation.vector + shift), rotation))
    };
    Ok(truth.iter().enumerate().map(disturb).collect())
}

fn trajectory(poses: &[(Time, Rigid3)]) -> Trajectory {
    Trajectory::new(poses.iter().map(|(time, pose)| TimedPose { time: *time, map_from_tracking: *pose })).0
}

/// Root mean square distance (metres) and angle (degrees) once the best rigid fit is taken away.
fn errors(truth: &Trajectory, poses: &Poses) -> Result<[f64; 3], Failure> {
    let errors = absolute_errors(truth, &trajectory(poses), Association::default(), Alignment::Se3)?;
    Ok([errors.translation.rmse, errors.rotation_degrees.rmse, errors.translation.max])
}

/// CPU seconds of this process so far.
fn cpu_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

fn read_points(path: &str, frame: Option<String>) -> Result<PointStore, Failure> {
    let recording = open(Path::new(path))?;
    let mut points = PointStore::new(0.3);
    let options = IngestOptions { tracking_frame: frame, ..IngestOptions::default() };
    for measurement in Ingestion::new(recording.as_ref(), &options)? {
        if let Measurement::Range(sweep) = measurement?.1 {
            points.push(&sweep);
        }
    }
    points.sort();
    Ok(points)
}

#[allow(clippy::print_stdout, clippy::print_stderr)]
fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let ([recording, truth], more) = arguments.split_at(2.min(arguments.len())) else {
        return Err("usage: study_drift RECORDING TRUTH.tum [FRAME] [kind=…] [drift=…] [seed=…]".into());
    };
    let value = |name: &str| {
        let own = more.iter().filter_map(|a| a.split_once('=')).find(|(key, _)| *key == name);
        own.map(|(_, value)| value.to_owned())
    };
    let list = |name: &str, default: &str| -> Vec<String> {
        value(name).unwrap_or(default.to_owned()).split(',').map(str::to_owned).collect()
    };
    let threads: usize = value("threads").unwrap_or("2".to_owned()).parse()?;
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    let points = read_points(recording, more.iter().find(|a| !a.contains('=')).cloned())?;
    let (truth, _) = read_tum(BufReader::new(std::fs::File::open(truth)?))?;
    let poses: Poses = truth.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    println!(
        "| drift | m : ° | seed | ATE m before | after | rot ° before | after | largest m | entropy before | after | CPU-s | notes |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for kind in list("kind", "smooth,walk,jump,bias") {
        for drift in list("drift", "0.2:1,0.75:4,1.5:8") {
            let (metres, degrees) = drift.split_once(':').ok_or("drift=METRES:DEGREES")?;
            let most = [metres.parse()?, degrees.parse()?];
            for seed in list("seed", "1") {
                let input = disturbed(&poses, &kind, most, seed.parse()?)?;
                if let Some(folder) = value("save") {
                    let path = Path::new(&folder).join(format!("{kind}_{metres}_{degrees}_{seed}.tum"));
                    write_tum(&trajectory(&input), BufWriter::new(std::fs::File::create(path)?))?;
                }
                let cpu = cpu_seconds();
                let refined = refine(&points, &input, value("method").as_deref())?;
                let cpu = cpu_seconds() - cpu;
                let after: Poses =
                    input.iter().map(|(t, p)| (*t, refined.trajectory.corrected(*t, p))).collect();
                let ([ate, turn, _], [ate1, turn1, most]) =
                    (errors(&truth, &input)?, errors(&truth, &after)?);
                let report = &refined.report;
                let entropy = |s: &Option<portolan_spatial::Sharpness>| {
                    s.as_ref().map_or(f64::NAN, |s| s.mean_map_entropy)
                };
                println!(
                    "| {kind} | {drift} | {seed} | {ate:.3} | {ate1:.4} | {turn:.2} | {turn1:.3} | {most:.3} | {:.3} | {:.3} | {cpu:.1} | {} |",
                    entropy(&report.sharpness_before),
                    entropy(&report.sharpness_after),
                    report.warnings.join("; ")
                );
            }
        }
    }
    Ok(())
}

fn refine(points: &PointStore, input: &Poses, method: Option<&str>) -> Result<Refined, Failure> {
    let mut observe = |_: &_| true;
    Ok(match method {
        Some("semi-rigid") => refine_semi_rigid(points, input, &SemiRigidOptions::default(), &mut observe)?,
        _ => refine_continuous(points, input, &ContinuousOptions::default(), &mut observe)?,
    })
}
