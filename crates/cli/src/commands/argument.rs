//! Parsers of arguments that several verbs have in common: ids, poses, areas and others.

use portolan_geometry::{Duration, Rigid3, Vector3, rotation_from_roll_pitch_yaw};
use portolan_ingest::{BeamElevation, RangeNoise};
use portolan_mapfile::{FrozenTrajectories, MapArea};
use portolan_pbstream::IdInFile;

/// `N` finite numbers separated by commas; `names` describes them in the error message.
pub fn numbers<const N: usize>(text: &str, names: &str) -> Result<[f64; N], String> {
    let values: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().ok().filter(|v| v.is_finite()))
        .collect::<Option<_>>()
        .ok_or_else(|| format!("expected {names}, not \"{text}\""))?;
    values.try_into().map_err(|_| format!("expected {names}, not \"{text}\""))
}

/// A rectangle in the map, metres.
pub fn area(text: &str) -> Result<MapArea, String> {
    let [x1, y1, x2, y2] = numbers::<4>(text, "X1,Y1,X2,Y2")?;
    let area = MapArea { min_x: x1.min(x2), min_y: y1.min(y2), max_x: x1.max(x2), max_y: y1.max(y2) };
    if area.min_x < area.max_x && area.min_y < area.max_y {
        return Ok(area);
    }
    Err(format!("the rectangle {text} is empty"))
}

/// Number of threads, at most 256: more threads than the largest machines have cores would only slow each other down.
pub fn threads(text: &str) -> Result<usize, String> {
    let most = 256;
    let number = text.parse::<usize>().ok().filter(|n| *n <= most);
    number.ok_or_else(|| format!("expected 0 to {most} threads, not \"{text}\""))
}

/// Duration in seconds, 0 or more.
pub fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|s| s.is_finite() && *s >= 0.0);
    seconds.ok_or_else(|| format!("expected seconds, 0 or more, not \"{text}\""))
}

/// Finite number, 0 or more.
pub fn not_negative(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite() && *number >= 0.0);
    number.ok_or_else(|| format!("expected a number, 0 or more, not \"{text}\""))
}

/// Length in metres, above 0 and at most 1,000 km: larger pixels and voxels would be useless.
pub fn positive_metres(text: &str) -> Result<f64, String> {
    let metres = text.parse::<f64>().ok().filter(|metres| *metres > 0.0 && *metres <= 1e6);
    metres.ok_or_else(|| format!("expected metres, more than 0 and at most 1000000, not \"{text}\""))
}

/// x, y, yaw: metres and degrees.
pub fn pose_2d(text: &str) -> Result<Rigid3, String> {
    let [x, y, yaw] = numbers::<3>(text, "X,Y,YAW")?;
    Ok(Rigid3::new(Vector3::new(x, y, 0.0), Vector3::z() * yaw.to_radians()))
}

/// Time offsets that are added to the stamps of topics, from seconds.
pub fn shifts(offsets: &[(String, f64)]) -> Vec<(String, Duration)> {
    offsets.iter().map(|(topic, seconds)| (topic.clone(), Duration::from_seconds(*seconds))).collect()
}

/// Topic and time offset in seconds: `/imu=-0.05`.
pub fn time_offset(text: &str) -> Result<(String, f64), String> {
    let parts = text.rsplit_once('=').filter(|(topic, _)| !topic.is_empty());
    let parsed = parts.and_then(|(topic, seconds)| Some((topic.to_owned(), seconds.parse::<f64>().ok()?)));
    // Clocks that differ by more are detected without an option.
    let valid = parsed.filter(|(_, seconds)| seconds.abs() <= 1e6);
    valid.ok_or_else(|| format!("expected TOPIC=SECONDS, not \"{text}\""))
}

/// Correction of the elevation of beams: `auto`, `off` or degrees.
pub fn beam_elevation(text: &str) -> Result<BeamElevation, String> {
    /// Maximum correction, degrees; a larger error is not a calibration error.
    const MOST_DEGREES: f64 = 5.0;
    match text {
        "auto" => Ok(BeamElevation::Auto),
        "off" => Ok(BeamElevation::Fixed(0.0)),
        degrees => {
            let degrees = degrees.parse::<f64>().ok().filter(|degrees| degrees.abs() <= MOST_DEGREES);
            let fixed = degrees.map(|degrees| BeamElevation::Fixed(degrees.to_radians()));
            fixed.ok_or_else(|| format!("expected auto, off or degrees (-5 to 5), not \"{text}\""))
        }
    }
}

/// Noise of ranges: `auto`, or a standard deviation in metres.
pub fn range_noise(text: &str) -> Result<RangeNoise, String> {
    /// Maximum standard deviation, metres; no lidar is noisier.
    const MOST_METRES: f64 = 1.0;
    if text == "auto" {
        return Ok(RangeNoise::Auto);
    }
    let metres = text.parse::<f64>().ok().filter(|metres| (0.0..=MOST_METRES).contains(metres));
    metres.map(RangeNoise::Fixed).ok_or_else(|| format!("expected auto or metres (0 to 1), not \"{text}\""))
}

/// x, y, z, roll, pitch, yaw: metres and degrees.
pub fn pose_3d(text: &str) -> Result<Rigid3, String> {
    let [x, y, z, angles @ ..] = numbers::<6>(text, "X,Y,Z,ROLL,PITCH,YAW")?;
    let [roll, pitch, yaw] = angles.map(f64::to_radians);
    let rotation = rotation_from_roll_pitch_yaw(roll, pitch, yaw);
    Ok(Rigid3::from_parts(Vector3::new(x, y, z).into(), rotation))
}

/// A pose in a map in 2D or in 3D, metres and degrees: x, y, yaw; or x, y, z, yaw; or x, y, z, roll, pitch,
/// yaw.
pub fn start_pose(text: &str) -> Result<Rigid3, String> {
    const NAMES: &str = "X,Y,YAW, or X,Y,Z,YAW, or X,Y,Z,ROLL,PITCH,YAW";
    let pose = match text.split(',').count() {
        3 => pose_2d(text),
        4 => numbers::<4>(text, NAMES)
            .map(|[x, y, z, yaw]| Rigid3::new(Vector3::new(x, y, z), Vector3::z() * yaw.to_radians())),
        _ => pose_3d(text),
    };
    pose.map_err(|_| format!("expected {NAMES}, not \"{text}\""))
}

/// Uncertainty of a start pose: standard deviations of the position, metres, and of the heading, degrees. Returns metres
/// and radians; the heading defaults to 10 degrees.
pub fn start_sigma(text: &str) -> Result<(f64, f64), String> {
    let [metres, degrees] = match text.contains(',') {
        true => numbers::<2>(text, "METRES,DEGREES")?,
        false => numbers::<1>(text, "METRES,DEGREES").map(|[metres]| [metres, 10.0])?,
    };
    let is_possible = (0.01..=1000.0).contains(&metres) && (0.1..=180.0).contains(&degrees);
    let bounds = || format!("expected 0.01 to 1000 metres and 0.1 to 180 degrees, not \"{text}\"");
    if is_possible { Ok((metres, degrees.to_radians())) } else { Err(bounds()) }
}

/// Id of a submap or node, trajectory and index: `0,12`, or `12` for trajectory 0.
pub fn id(text: &str) -> Result<IdInFile, String> {
    let bad = || format!("expected TRAJECTORY,INDEX, not \"{text}\"");
    let (trajectory, index) = text.split_once(',').unwrap_or(("0", text));
    let number = |part: &str| part.trim().parse::<i32>().ok().filter(|v| *v >= 0).ok_or_else(bad);
    Ok((number(trajectory)?, number(index)?))
}

/// `all`, or numbers of trajectories separated by commas.
pub fn frozen_trajectories(text: &str) -> Result<FrozenTrajectories, String> {
    if text == "all" {
        return Ok(FrozenTrajectories::All);
    }
    let ids: Option<_> = text.split(',').map(|part| part.trim().parse().ok().filter(|id| *id >= 0)).collect();
    ids.map(FrozenTrajectories::Only)
        .ok_or_else(|| format!("expected `all` or numbers of trajectories as in 0,2, not \"{text}\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_numbers_are_refused() {
        assert_eq!((threads("0"), threads("256"), seconds("1.5")), (Ok(0), Ok(256), Ok(1.5)));
        assert!(threads("100000").is_err() && seconds("nan").is_err() && seconds("-1").is_err());
    }

    #[test]
    fn starts_in_2d_and_in_3d() {
        let pose = |text| start_pose(text).unwrap_or_else(|e| panic!("{e}"));
        let yaw = |pose: &Rigid3| pose.rotation.euler_angles().2.to_degrees();
        assert_eq!(pose("1,-2,90"), pose_2d("1,-2,90").unwrap_or_else(|e| panic!("{e}")));
        assert_eq!(pose("1,-2,3.5,90").translation.vector, Vector3::new(1.0, -2.0, 3.5));
        assert!((yaw(&pose("1,-2,3.5,90")) - 90.0).abs() < 1e-9);
        assert_eq!(pose("1,2,3,0,0,45"), pose("1,2,3,45"));
        assert!((pose("1,2,3,20,0,0").rotation.euler_angles().0.to_degrees() - 20.0).abs() < 1e-9);
        assert!(["1,2", "1,2,3,4,5", "1,2,x", ""].iter().all(|text| start_pose(text).is_err()));
    }

    #[test]
    fn standard_deviations_of_a_start() {
        assert_eq!(start_sigma("2,90"), Ok((2.0, 90f64.to_radians())));
        assert_eq!(start_sigma("0.3"), Ok((0.3, 10f64.to_radians())));
        assert!(["0", "-1,10", "1,0", "nan", "1,2,3"].iter().all(|text| start_sigma(text).is_err()));
    }

    #[test]
    fn offsets_of_clocks() {
        assert_eq!(time_offset("/imu=-0.05"), Ok(("/imu".to_owned(), -0.05)));
        assert!(["/imu", "=1", "/imu=nan", "/imu=1e9"].iter().all(|text| time_offset(text).is_err()));
    }

    #[test]
    fn ids_and_areas() {
        assert_eq!((id("3,12"), id("7")), (Ok((3, 12)), Ok((0, 7))));
        assert!(id("a,1").is_err() && id("-1,2").is_err());
        let found = area("3,4,-1,2").unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((found.min_x, found.min_y, found.max_x, found.max_y), (-1.0, 2.0, 3.0, 4.0));
        let some = FrozenTrajectories::Only([0, 2].into());
        assert_eq!(
            (frozen_trajectories("0,2"), frozen_trajectories("all")),
            (Ok(some), Ok(FrozenTrajectories::All))
        );
        assert!(frozen_trajectories("").is_err() && frozen_trajectories("-1").is_err());
        assert!(area("0,0,0,1").is_err() && area("0,0,1").is_err() && area("0,0,nan,1").is_err());
    }
}
