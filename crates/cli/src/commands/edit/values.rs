//! Parsers of the arguments of `edit`.

use portolan_geometry::{Rigid3, Time, Vector3, rotation_from_roll_pitch_yaw};
use portolan_pbstream::IdInFile;

use crate::commands::argument::{id, numbers, pose_2d};

/// How to rotate the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rotation {
    /// By this angle, radians.
    By(f64),
    /// So that the walls are parallel to the axes.
    Walls,
}

/// A loop closure to be added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopToAdd {
    pub submap: IdInFile,
    pub node: IdInFile,
    /// Pose of the node in the submap; none if it is to be found by matching.
    pub submap_from_node: Option<Rigid3>,
}

pub fn rotation(text: &str) -> Result<Rotation, String> {
    if text == "walls" {
        return Ok(Rotation::Walls);
    }
    let degrees = text.parse::<f64>().ok().filter(|d| d.is_finite());
    degrees
        .map(|d| Rotation::By(d.to_radians()))
        .ok_or_else(|| format!("expected degrees or `walls`, not \"{text}\""))
}

/// Point x, y or x, y, z, metres.
pub fn point(text: &str) -> Result<Vector3, String> {
    if text.split(',').count() == 2 {
        let [x, y] = numbers::<2>(text, "X,Y")?;
        return Ok(Vector3::new(x, y, 0.0));
    }
    numbers::<3>(text, "X,Y or X,Y,Z").map(Vector3::from)
}

/// Pose x, y, yaw or x, y, z, roll, pitch, yaw: metres and degrees.
fn pose(text: &str) -> Result<Rigid3, String> {
    if text.split(',').count() == 3 {
        return pose_2d(text);
    }
    let [x, y, z, roll, pitch, yaw] = numbers::<6>(text, "X,Y,YAW or X,Y,Z,ROLL,PITCH,YAW")?;
    let rotation = rotation_from_roll_pitch_yaw(roll.to_radians(), pitch.to_radians(), yaw.to_radians());
    Ok(Rigid3::from_parts(Vector3::new(x, y, z).into(), rotation))
}

pub fn rename(text: &str) -> Result<(i32, i32), String> {
    let number = |part: &str| part.trim().parse::<i32>().ok().filter(|v| *v >= 0);
    let numbers = text.split_once('=').and_then(|(old, new)| Some((number(old)?, number(new)?)));
    numbers.ok_or_else(|| format!("expected OLD=NEW, not \"{text}\""))
}

/// Ids of a submap and a node: `SUBMAP:NODE`.
pub fn pair(text: &str) -> Result<(IdInFile, IdInFile), String> {
    let (submap, node) =
        text.split_once(':').ok_or_else(|| format!("expected SUBMAP:NODE, not \"{text}\""))?;
    Ok((id(submap)?, id(node)?))
}

pub fn loop_to_add(text: &str) -> Result<LoopToAdd, String> {
    let (ids, submap_from_node) = match text.split_once('=') {
        Some((ids, value)) => (ids, Some(pose(value)?)),
        None => (text, None),
    };
    let (submap, node) = pair(ids)?;
    Ok(LoopToAdd { submap, node, submap_from_node })
}

/// Time as Unix seconds, or as `+S`, seconds after `first`.
pub fn time(text: &str, first: Time) -> Result<Time, String> {
    let bad = || format!("expected Unix seconds or +SECONDS, not \"{text}\"");
    match text.strip_prefix('+') {
        Some(seconds) => {
            let seconds = seconds.parse::<f64>().ok().filter(|s| s.is_finite() && *s < 1e9);
            Ok(first + portolan_geometry::Duration::from_seconds(seconds.ok_or_else(bad)?))
        }
        None => Time::from_unix_decimal(text).ok_or_else(bad),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read() {
        let found = loop_to_add("0,3:1,812=1.5,0.2,90").unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((found.submap, found.node), ((0, 3), (1, 812)));
        assert!(
            found.submap_from_node.is_some_and(|p| (p.rotation.angle().to_degrees() - 90.0).abs() < 1e-9)
        );
        assert!(loop_to_add("3:4").is_ok_and(|l| l.submap_from_node.is_none() && l.node == (0, 4)));
        assert!(loop_to_add("3").is_err() && pair("0,1:x").is_err() && rename("1-2").is_err());
        assert_eq!(rotation("walls"), Ok(Rotation::Walls));
        let first = Time::from_unix_seconds(100.0);
        assert_eq!(time("+2.5", first), Ok(Time::from_unix_seconds(102.5)));
        assert_eq!(time("7", first), Ok(Time::from_unix_seconds(7.0)));
        assert!(time("soon", first).is_err());
    }
}
