//! Trajectories as GeoJSON: one line (`LineString`) each, with times and rotations as properties.

use std::io::{Read, Write};

use nalgebra::Vector3;
use portolan_geometry::{EastNorthUp, GeodeticPosition, Time};
use serde_json::Value;

use super::{bad_line, both, pose_of};
use crate::EvaluationError;
use crate::trajectory::{TimedPose, Trajectory, TrajectoryRepairs};

/// Maximum size of a file, bytes.
const MAX_BYTES: u64 = 1 << 30;

/// Writes trajectories with their numbers. With a frame, coordinates are longitude, latitude (degrees) and
/// height (metres), as GeoJSON requires; without one, they are metres in the map. The properties `times`
/// (Unix seconds as text, exact) and `rotations` (x, y, z, w) have one entry for each coordinate.
///
/// # Errors
/// If writing fails.
pub fn write_geojson(
    trajectories: &[(i32, Trajectory)],
    frame: Option<&EastNorthUp>,
    mut writer: impl Write,
) -> std::io::Result<()> {
    writeln!(writer, "{{\"type\":\"FeatureCollection\",\"features\":[")?;
    for (i, (id, trajectory)) in trajectories.iter().enumerate() {
        let separator = if i == 0 { "" } else { "," };
        let list = |text: &dyn Fn(&TimedPose) -> String| {
            trajectory.poses().iter().map(text).collect::<Vec<_>>().join(",")
        };
        let coordinates = list(&|p| coordinates(&p.map_from_tracking.translation.vector, frame));
        let times = list(&|p| format!("\"{}\"", p.time.unix_decimal()));
        let rotations = list(&|p| {
            let [x, y, z, w] = crate::quaternion_xyzw(&p.map_from_tracking);
            format!("[{x:.9},{y:.9},{z:.9},{w:.9}]")
        });
        let units = if frame.is_some() { "degrees" } else { "metres" };
        writeln!(
            writer,
            "{separator}{{\"type\":\"Feature\",\"properties\":{{\"trajectory_id\":{id},\"coordinates\":\
             \"{units}\",\"times\":[{times}],\"rotations\":[{rotations}]}},\"geometry\":{{\"type\":\
             \"LineString\",\"coordinates\":[{coordinates}]}}}}"
        )?;
    }
    writeln!(writer, "]}}")
}

fn coordinates(position: &Vector3<f64>, frame: Option<&EastNorthUp>) -> String {
    match frame {
        Some(frame) => {
            let g = frame.to_geodetic(position);
            format!("[{:.11},{:.11},{:.6}]", g.longitude_degrees, g.latitude_degrees, g.altitude)
        }
        None => format!("[{:.6},{:.6},{:.6}]", position.x, position.y, position.z),
    }
}

/// Reads trajectories as [`write_geojson`] writes them. Lines without `times` are left out and counted as
/// invalid poses. Without `rotations` the rotation is the identity. Coordinates in degrees need the frame.
///
/// # Errors
/// If reading fails, the text is not GeoJSON, or its coordinates are degrees and `frame` is `None`.
pub fn read_geojson(
    reader: impl Read,
    frame: Option<&EastNorthUp>,
) -> Result<(Vec<(i32, Trajectory)>, TrajectoryRepairs), EvaluationError> {
    let mut text = String::new();
    reader.take(MAX_BYTES).read_to_string(&mut text)?;
    let root: Value = serde_json::from_str(&text)
        .map_err(|error| bad_line(error.line(), format!("not GeoJSON: {error}")))?;
    let features = root.get("features").and_then(Value::as_array);
    let features = features.map_or_else(|| std::slice::from_ref(&root), Vec::as_slice);
    let mut trajectories = Vec::new();
    let mut repairs = TrajectoryRepairs::default();
    for (i, feature) in features.iter().enumerate() {
        let Some(points) = feature.pointer("/geometry/coordinates").and_then(Value::as_array) else {
            continue;
        };
        let times = feature.pointer("/properties/times").and_then(Value::as_array);
        let Some(times) = times.filter(|times| times.len() == points.len()) else {
            repairs.invalid_poses += points.len();
            continue;
        };
        let rotations = feature.pointer("/properties/rotations").and_then(Value::as_array);
        let degrees = feature.pointer("/properties/coordinates").and_then(Value::as_str) == Some("degrees");
        if degrees && frame.is_none() {
            return Err(bad_line(1, "the coordinates are degrees: give the origin of the map"));
        }
        let mut poses = Vec::with_capacity(points.len());
        for (k, (point, time)) in points.iter().zip(times).enumerate() {
            let rotation = rotations.and_then(|r| r.get(k));
            let found = pose(point, time, rotation, frame.filter(|_| degrees), &mut repairs);
            poses.extend(found);
        }
        let (trajectory, disorder) = Trajectory::new(poses);
        repairs = both(repairs, disorder);
        let id = feature.pointer("/properties/trajectory_id").and_then(Value::as_i64);
        let id = id.and_then(|id| i32::try_from(id).ok()).or_else(|| i32::try_from(i).ok()).unwrap_or(0);
        trajectories.push((id, trajectory));
    }
    Ok((trajectories, repairs))
}

fn pose(
    point: &Value,
    time: &Value,
    rotation: Option<&Value>,
    frame: Option<&EastNorthUp>,
    repairs: &mut TrajectoryRepairs,
) -> Option<TimedPose> {
    let number = |list: &Value, i: usize| list.get(i).and_then(Value::as_f64);
    let time = match time {
        Value::String(text) => Time::from_unix_decimal(text),
        other => other.as_f64().filter(|s| s.abs() < 1e11).map(Time::from_unix_seconds),
    };
    let (Some(time), Some(x), Some(y)) = (time, number(point, 0), number(point, 1)) else {
        repairs.invalid_poses += 1;
        return None;
    };
    let z = number(point, 2).unwrap_or(0.0);
    let position = match frame {
        Some(frame) => {
            frame.from_geodetic(&GeodeticPosition { longitude_degrees: x, latitude_degrees: y, altitude: z })
        }
        None => Vector3::new(x, y, z),
    };
    let quaternion =
        rotation.map_or([0.0, 0.0, 0.0, 1.0], |r| [0, 1, 2, 3].map(|i| number(r, i).unwrap_or(f64::NAN)));
    let map_from_tracking = pose_of(position.into(), quaternion, repairs)?;
    Some(TimedPose { time, map_from_tracking })
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Rigid3;

    fn trajectory() -> Trajectory {
        let pose = |i: i32| TimedPose {
            time: Time::from_unix_seconds(1e9 + f64::from(i)),
            map_from_tracking: Rigid3::new(Vector3::new(f64::from(i), -2.0, 0.5), Vector3::z() * 0.1),
        };
        Trajectory::new((0..5).map(pose)).0
    }

    #[test]
    fn written_and_read_again() {
        let origin = GeodeticPosition { latitude_degrees: 48.0, longitude_degrees: 11.0, altitude: 500.0 };
        for frame in [None, Some(EastNorthUp::at(&origin))] {
            let mut text = Vec::new();
            write_geojson(&[(3, trajectory()), (4, trajectory())], frame.as_ref(), &mut text).unwrap();
            let (back, repairs) = read_geojson(&*text, frame.as_ref()).unwrap();
            assert_eq!((back.len(), back[1].0, repairs), (2, 4, TrajectoryRepairs::default()));
            for (a, b) in back[0].1.poses().iter().zip(trajectory().poses()) {
                assert_eq!(a.time, b.time);
                let off = a.map_from_tracking.inverse() * b.map_from_tracking;
                assert!(off.translation.vector.norm() < 5e-6 && off.rotation.angle() < 1e-6);
            }
        }
    }

    #[test]
    fn files_that_cannot_be_read_are_named() {
        let error = read_geojson(&b"{\"features\": ["[..], None).unwrap_err().to_string();
        assert!(error.contains("not GeoJSON"), "{error}");
        let text = br#"{"type":"Feature","geometry":{"coordinates":[[1,2],[3,4]]}}"#;
        let (none, repairs) = read_geojson(&text[..], None).unwrap();
        assert_eq!((none.len(), repairs.invalid_poses), (0, 2));
        let text =
            br#"{"geometry":{"coordinates":[[1,2]]},"properties":{"times":[5],"coordinates":"degrees"}}"#;
        assert!(read_geojson(&text[..], None).unwrap_err().to_string().contains("origin"));
    }
}
