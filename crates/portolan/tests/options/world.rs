//! A hall with pillars and what sensors on a robot in it measure: exact, cheap, the same every time.

use portolan::geometry::{Duration, Point3f, Rigid3, Time, Vector3, rotation_from_roll_pitch_yaw};
use portolan::sensor::{ImuData, OdometryData, TimedPoint, TimedPointCloudData};

pub const GRAVITY: f64 = 9.806;

/// Inner walls of the hall: two opposite corners, metres.
const HALL: [[f64; 3]; 2] = [[-6.0, -4.5, -1.2], [6.5, 4.0, 2.4]];
/// Pillars and boxes.
const BOXES: [[[f64; 3]; 2]; 4] = [
    [[2.6, 1.4, -1.2], [3.2, 2.0, 2.4]],
    [[-3.6, -2.8, -1.2], [-2.4, -2.2, 0.6]],
    [[-1.0, 2.6, -1.2], [0.4, 3.0, 1.5]],
    [[3.8, -3.4, -1.2], [4.4, -1.8, 0.9]],
];

pub fn at(seconds: f64) -> Time {
    Time::from_ticks(0) + Duration::from_seconds(seconds)
}

pub fn pose(x: f64, y: f64, yaw: f64) -> Rigid3 {
    Rigid3::from_parts(Vector3::new(x, y, 0.0).into(), rotation_from_roll_pitch_yaw(0.0, 0.0, yaw))
}

/// Where a ray enters (and leaves) a box.
fn crossing(origin: &Vector3, direction: &Vector3, [low, high]: [[f64; 3]; 2]) -> (f64, f64) {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let [a, b] = [low, high].map(|corner| (corner[axis] - origin[axis]) / direction[axis]);
        if a.is_nan() || b.is_nan() {
            continue;
        }
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter, leave)
}

/// Metres from a place in the hall to the first surface along a unit direction.
fn range(origin: &Vector3, direction: &Vector3) -> f64 {
    let wall = crossing(origin, direction, HALL).1;
    BOXES.iter().fold(wall, |nearest, solid| {
        let (enter, leave) = crossing(origin, direction, *solid);
        if enter > 0.0 && enter <= leave { nearest.min(enter) } else { nearest }
    })
}

/// A scan of beams at some elevations, radians, `columns` all around, of a sensor in the tracking frame.
pub fn scan_at(
    map_from_tracking: &Rigid3,
    seconds: f64,
    elevations: &[f64],
    columns: usize,
) -> TimedPointCloudData {
    let mut points = Vec::with_capacity(columns * elevations.len());
    let mut intensities = Vec::with_capacity(columns * elevations.len());
    let origin = map_from_tracking.translation.vector;
    for column in 0..columns {
        let azimuth = std::f64::consts::TAU * (column as f64 + 0.5) / columns as f64;
        for elevation in elevations {
            let (sin, cos) = elevation.sin_cos();
            let beam = Vector3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
            let direction = map_from_tracking.rotation * beam;
            let length = range(&origin, &direction);
            let place = origin + direction * length;
            points.push(TimedPoint { position: Point3f::from((beam * length).cast::<f32>()), time: 0.0 });
            // Stripes on the walls.
            intensities.push(if (place.x + place.y).rem_euclid(1.0) < 0.5 { 10.0 } else { 30.0 });
        }
    }
    TimedPointCloudData {
        time: at(seconds),
        origin_in_tracking: Point3f::origin(),
        points_in_tracking: points,
        intensities,
    }
}

/// A planar scan; every second beam looks up a little, so that points have heights.
pub fn scan_2d(map_from_tracking: &Rigid3, seconds: f64) -> TimedPointCloudData {
    let mut scan = scan_at(map_from_tracking, seconds, &[0.0], 600);
    scan.intensities.clear();
    for point in scan.points_in_tracking.iter_mut().step_by(2) {
        point.position.z = 0.3;
    }
    scan
}

/// A scan in 3D of a tracking frame that may lean.
pub fn scan_3d(map_from_tracking: &Rigid3, seconds: f64) -> TimedPointCloudData {
    let elevations: Vec<f64> = (-5..=5).map(|ring| 0.09 * f64::from(ring)).collect();
    scan_at(map_from_tracking, seconds, &elevations, 90)
}

/// The same so dense that no cell of a wall is left out.
pub fn dense_scan(map_from_tracking: &Rigid3, seconds: f64) -> TimedPointCloudData {
    let elevations: Vec<f64> = (-20..=20).map(|ring| 0.025 * f64::from(ring)).collect();
    scan_at(map_from_tracking, seconds, &elevations, 300)
}

/// Round a circle of 1.5 m with 0.6 m/s, looking ahead.
pub fn on_circle(seconds: f64) -> Rigid3 {
    let angle = 0.4 * seconds;
    pose(1.5 * angle.sin(), 1.5 - 1.5 * angle.cos(), angle)
}

pub fn odometry(odom_from_tracking: Rigid3, seconds: f64) -> OdometryData {
    OdometryData { time: at(seconds), odom_from_tracking }
}

/// An IMU that turns about the vertical and leans by `roll`.
pub fn imu(seconds: f64, roll: f64, yaw_rate: f64) -> ImuData {
    let tracking_from_level = rotation_from_roll_pitch_yaw(roll, 0.0, 0.0).inverse();
    ImuData {
        time: at(seconds),
        linear_acceleration: tracking_from_level * Vector3::new(0.0, 0.0, GRAVITY),
        angular_velocity: tracking_from_level * Vector3::new(0.0, 0.0, yaw_rate),
    }
}

/// How far one pose is from another, metres.
pub fn distance(a: &Rigid3, b: &Rigid3) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}
