//! A small world of walls, seen by spinning lidars along a walk.
#![allow(dead_code)] // not every test uses everything

use portolan_geometry::{Duration, Point3f, Rigid3, Time, Vector3, nalgebra as na};
use portolan_numeric::{Lcg64, SplitMix64};
use portolan_refinement::PointStore;
use portolan_sensor::{TimedPoint, TimedPointCloudData};

/// Seconds between poses of the trajectories.
const POSE_STEP: f64 = 0.02;

/// A rectangle: corner and two edges at right angles.
pub struct Wall {
    pub corner: Vector3,
    pub edges: [Vector3; 2],
}

/// A deterministic generator of noise.
pub struct Random(Lcg64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(Lcg64::new(seed.wrapping_mul(SplitMix64::GAMMA) | 1))
    }

    pub fn uniform(&mut self) -> f64 {
        self.0.uniform()
    }

    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

fn wall(corner: [f64; 3], a: [f64; 3], b: [f64; 3]) -> Wall {
    Wall { corner: Vector3::from(corner), edges: [Vector3::from(a), Vector3::from(b)] }
}

/// The inner faces of a box.
pub fn room(low: [f64; 3], high: [f64; 3]) -> Vec<Wall> {
    let [dx, dy, dz] = std::array::from_fn(|k| high[k] - low[k]);
    vec![
        wall(low, [dx, 0.0, 0.0], [0.0, dy, 0.0]),
        wall([low[0], low[1], high[2]], [dx, 0.0, 0.0], [0.0, dy, 0.0]),
        wall(low, [dx, 0.0, 0.0], [0.0, 0.0, dz]),
        wall([low[0], high[1], low[2]], [dx, 0.0, 0.0], [0.0, 0.0, dz]),
        wall(low, [0.0, dy, 0.0], [0.0, 0.0, dz]),
        wall([high[0], low[1], low[2]], [0.0, dy, 0.0], [0.0, 0.0, dz]),
    ]
}

/// A room with a few things in it.
pub fn furnished() -> Vec<Wall> {
    let mut walls = room([0.0; 3], [8.0, 7.0, 2.8]);
    walls.extend(room([3.6, 3.2, 0.0], [4.4, 3.8, 1.9]));
    walls.extend(room([6.9, 0.0, 0.0], [8.0, 2.0, 0.8]));
    walls
}

/// A walk along a curve: the pose at each second.
pub type Walk = fn(f64) -> Rigid3;

/// Circles through a room, with bob and sway.
pub fn circles(s: f64) -> Rigid3 {
    let a = 0.35 * s;
    let bob = 0.02 * (6.0 * s).sin();
    let place = Vector3::new(4.0 + 2.5 * a.cos(), 3.5 + 1.8 * a.sin(), 1.4 + bob);
    let yaw = a + 1.57 + 0.05 * (3.0 * s).sin();
    Rigid3::from_parts(
        na::Translation3::from(place),
        na::UnitQuaternion::from_euler_angles(0.03 * (4.0 * s).sin(), 0.3 + 0.02 * (5.0 * s).cos(), yaw),
    )
}

/// Straight along x.
pub fn straight(s: f64) -> Rigid3 {
    Rigid3::from_parts(
        na::Translation3::new(1.2 * s, 0.1 * (0.5 * s).sin(), 1.4),
        na::UnitQuaternion::from_euler_angles(0.02 * (4.0 * s).sin(), 0.3, 0.05 * (3.0 * s).sin()),
    )
}

/// Poses of a walk.
pub fn poses(walk: Walk, seconds: f64) -> Vec<(Time, Rigid3)> {
    let at = |s: f64| Time::from_unix_seconds(1000.0) + Duration::from_seconds(s);
    (0..=(seconds / POSE_STEP).round() as usize)
        .map(|i| i as f64 * POSE_STEP)
        .map(|s| (at(s), walk(s)))
        .collect()
}

/// The same with drift (that grows to `drift` metres and a tenth of that in radians) and with short errors.
pub fn disturbed(truth: &[(Time, Rigid3)], drift: f64, jitter: f64) -> Vec<(Time, Rigid3)> {
    let last = (truth.len() - 1) as f64;
    truth
        .iter()
        .enumerate()
        .map(|(i, (time, pose))| {
            let (share, s) = (i as f64 / last, i as f64 * POSE_STEP);
            let grows = drift * (1.0 - (std::f64::consts::PI * share).cos()) / 2.0;
            let start = (s / 0.5).min(1.0);
            let wave = |k: f64| jitter * start * (s * (2.0 + k) + k).sin();
            let shift = Vector3::new(grows + wave(0.3), -0.6 * grows + wave(1.1), 0.3 * grows + wave(2.3));
            let turn =
                Vector3::new(0.02 * grows + 0.2 * wave(0.7), 0.2 * wave(1.9), 0.1 * grows + 0.2 * wave(1.4));
            let rotation = na::UnitQuaternion::new(turn) * pose.rotation;
            let translation = na::Translation3::from(pose.translation.vector + shift);
            (*time, Rigid3::from_parts(translation, rotation))
        })
        .collect()
}

/// A lidar of 16 rings at 10 Hz.
pub struct Lidar {
    pub name: &'static str,
    pub tracking_from_lidar: Rigid3,
    /// Where the recording says that it is.
    pub assumed_mounting: Rigid3,
    /// Its stamps are so many seconds too early.
    pub delay: f64,
}

impl Lidar {
    /// One at the tracking frame, of which everything is known.
    pub fn known() -> Self {
        Self {
            name: "",
            tracking_from_lidar: Rigid3::identity(),
            assumed_mounting: Rigid3::identity(),
            delay: 0.0,
        }
    }
}

/// What a lidar of 16 rings at 10 Hz sees on a walk, with 1 cm of noise.
pub fn scan(walls: &[Wall], walk: Walk, seconds: f64, columns: usize) -> PointStore {
    scan_with(&[Lidar::known()], walls, walk, seconds, columns)
}

/// The same for several.
pub fn scan_with(lidars: &[Lidar], walls: &[Wall], walk: Walk, seconds: f64, columns: usize) -> PointStore {
    let mut store = PointStore::new(0.3);
    for (i, lidar) in lidars.iter().enumerate() {
        let mut random = Random::new(3 + i as u64);
        for turn in 0..(seconds * 10.0) as usize {
            store.push_from(lidar.name, &sweep(lidar, walls, walk, turn, columns, &mut random));
        }
    }
    store.sort();
    store
}

fn sweep(
    lidar: &Lidar,
    walls: &[Wall],
    walk: Walk,
    turn: usize,
    columns: usize,
    random: &mut Random,
) -> TimedPointCloudData {
    let end = (turn + 1) as f64 * 0.1;
    let mut points = Vec::with_capacity(columns * 16);
    for column in 0..columns {
        let share = column as f64 / columns as f64;
        let time = share * 0.1 - 0.1;
        let pose = walk(end + time) * lidar.tracking_from_lidar;
        for ring in 0..16 {
            let elevation = (f64::from(ring) * 2.0 - 15.0).to_radians();
            let azimuth = std::f64::consts::TAU * share;
            let beam = Vector3::new(
                elevation.cos() * azimuth.cos(),
                elevation.cos() * azimuth.sin(),
                elevation.sin(),
            );
            let Some(range) = cast(walls, &pose.translation.vector, &(pose.rotation * beam)) else {
                continue;
            };
            let p = lidar.assumed_mounting * na::Point3::from(beam * (range + 0.01 * random.normal()));
            points.push(TimedPoint {
                position: Point3f::new(p.x as f32, p.y as f32, p.z as f32),
                time: time as f32,
            });
        }
    }
    let origin = lidar.assumed_mounting.translation.vector;
    TimedPointCloudData {
        time: Time::from_unix_seconds(1000.0) + Duration::from_seconds(end - lidar.delay),
        origin_in_tracking: Point3f::new(origin.x as f32, origin.y as f32, origin.z as f32),
        points_in_tracking: points,
        intensities: Vec::new(),
    }
}

fn cast(walls: &[Wall], from: &Vector3, direction: &Vector3) -> Option<f64> {
    let mut nearest: Option<f64> = None;
    for wall in walls {
        let normal = wall.edges[0].cross(&wall.edges[1]);
        let along = normal.dot(direction);
        let range = normal.dot(&(wall.corner - from)) / along;
        if along.abs() < 1e-9 || !(range > 0.1 && range < 60.0) {
            continue;
        }
        let at = from + direction * range - wall.corner;
        let inside = wall.edges.iter().all(|e| (0.0..=1.0).contains(&(at.dot(e) / e.norm_squared())));
        if inside && nearest.is_none_or(|n| range < n) {
            nearest = Some(range);
        }
    }
    nearest
}

/// Largest distance (metres) and angle (radians) between two trajectories once the best rigid fit is taken away.
pub fn errors(truth: &[(Time, Rigid3)], estimate: &[(Time, Rigid3)]) -> (f64, f64) {
    use portolan_evaluation::{Alignment, Association, TimedPose, Trajectory, absolute_errors};
    let trajectory = |poses: &[(Time, Rigid3)]| {
        Trajectory::new(poses.iter().map(|(time, pose)| TimedPose { time: *time, map_from_tracking: *pose }))
            .0
    };
    let errors =
        absolute_errors(&trajectory(truth), &trajectory(estimate), Association::default(), Alignment::Se3)
            .unwrap();
    (errors.translation.rmse, errors.rotation_degrees.rmse.to_radians())
}
