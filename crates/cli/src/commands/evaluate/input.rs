//! Trajectories and relations from files of any format, distinguished by content.

use std::path::Path;

use portolan_evaluation::{
    EvaluationError, Relation, TimedPose, Trajectory, TrajectoryRepairs, kitti_trajectory, read_csv,
    read_kitti_poses, read_kitti_times, read_relations, read_tum,
};
use portolan_geometry::{Duration, Time};
use portolan_input::Forward;
use portolan_pbstream::proto::mapping::{self, PoseGraph};
use portolan_pbstream::{MapReader, ReadLimits, pose_from_proto};

use crate::error::CliError;
use crate::input::{is_map, must_be_text, open_forward, peek, read_bytes};
use crate::output::counted;
use crate::progress::say;

/// So much of a text tells its format, bytes: more than any comments at its start.
const HEAD: usize = 1 << 16;
/// Seconds between the scans of KITTI recordings.
const KITTI_PERIOD: f64 = 0.1;

/// Where a trajectory comes from.
pub struct TrajectorySource<'a> {
    /// The file: a map, TUM, KITTI poses, or a table with a line of names.
    pub path: &'a Path,
    /// Which trajectory of a map.
    pub trajectory_id: i32,
    /// Times of KITTI poses, one a line.
    pub times: Option<&'a Path>,
    /// Whether nothing is to be said about repairs.
    pub quiet: bool,
}

impl TrajectorySource<'_> {
    /// Reads the trajectory; says on stderr what was put right.
    pub fn read(&self) -> Result<Trajectory, CliError> {
        self.read_from(open_forward(self.path)?)
    }

    /// Reads the trajectory from an opened input.
    pub fn read_from(&self, mut input: Forward) -> Result<Trajectory, CliError> {
        let (trajectory, repairs) = if is_map(&mut input, self.path)? {
            let pose_graph = pose_graph_from(input, self.path)?;
            Trajectory::new(nodes(self.path, &pose_graph, self.trajectory_id)?)
        } else {
            self.read_text(input)?
        };
        if trajectory.is_empty() {
            return Err(CliError::in_file(self.path, "the trajectory has no poses"));
        }
        if !self.quiet {
            tell_repairs(self.path, &repairs);
        }
        Ok(trajectory)
    }

    fn read_text(&self, mut input: Forward) -> Result<(Trajectory, TrajectoryRepairs), CliError> {
        must_be_text(&mut input, self.path)?;
        let read = match text_format(peek(&mut input, self.path, HEAD)?) {
            TextFormat::Tum => read_tum(input),
            TextFormat::Csv => read_csv(input),
            TextFormat::Kitti => {
                let poses = read_kitti_poses(input).map_err(|error| CliError::in_file(self.path, error))?;
                kitti_trajectory(&poses, &self.kitti_times(poses.len())?)
            }
        };
        read.map_err(|error| CliError::in_file(self.path, error))
    }

    fn kitti_times(&self, count: usize) -> Result<Vec<Time>, CliError> {
        if let Some(path) = self.times {
            return read_kitti_times(open_forward(path)?).map_err(|error| CliError::in_file(path, error));
        }
        if !self.quiet {
            say(&format!(
                "{}: KITTI poses without times; taken as {KITTI_PERIOD} s apart from time 0 (give times.txt with \
                 --times)",
                self.path.display()
            ));
        }
        Ok((0..count).map(|i| Time::from_unix_seconds(i as f64 * KITTI_PERIOD)).collect())
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TextFormat {
    Tum,
    Kitti,
    Csv,
}

/// By the first line that is no comment: twelve numbers are a KITTI pose; commas separate the columns of
/// a table, whose line of names may begin like a comment.
fn text_format(text: &[u8]) -> TextFormat {
    let mut lines = text.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii).filter(|line| !line.is_empty());
    match lines.find(|line| !line.starts_with(b"#")) {
        Some(line) if line.contains(&b',') => TextFormat::Csv,
        Some(line) if line.split(u8::is_ascii_whitespace).filter(|f| !f.is_empty()).count() == 12 => {
            TextFormat::Kitti
        }
        _ => TextFormat::Tum,
    }
}

/// The second message of a map.
pub fn read_pose_graph(path: &Path) -> Result<PoseGraph, CliError> {
    pose_graph_from(open_forward(path)?, path)
}

/// The second message of a map that is opened; `path` is named in errors.
pub fn pose_graph_from(input: Forward, path: &Path) -> Result<PoseGraph, CliError> {
    let length = input.length();
    let reader = MapReader::from_source(input, length, ReadLimits::default());
    Ok(reader.map_err(|error| CliError::in_file(path, error))?.take_pose_graph())
}

/// The second message of a map, and what is wrong with what follows, which is looked through to its end.
pub fn whole_pose_graph_from(input: Forward, path: &Path) -> Result<(PoseGraph, Option<String>), CliError> {
    let length = input.length();
    let reader = MapReader::from_source_for_summary(input, length, ReadLimits::default());
    let mut reader = reader.map_err(|error| CliError::in_file(path, error))?;
    let graph = reader.take_pose_graph();
    loop {
        match reader.next_message() {
            Ok(Some(_)) => {}
            Ok(None) => return Ok((graph, None)),
            Err(error) => return Ok((graph, Some(error.to_string()))),
        }
    }
}

/// One trajectory of a map.
pub fn trajectory_of<'a>(
    path: &Path,
    pose_graph: &'a PoseGraph,
    id: i32,
) -> Result<&'a mapping::Trajectory, CliError> {
    pose_graph.trajectory.iter().find(|t| t.trajectory_id == id).ok_or_else(|| {
        let ids: Vec<String> = pose_graph.trajectory.iter().map(|t| t.trajectory_id.to_string()).collect();
        CliError::in_file(
            path,
            format!("there is no trajectory {id} in this map; it has: {}", ids.join(", ")),
        )
    })
}

/// The poses of all nodes of a trajectory, in the order of the file.
pub fn nodes(path: &Path, pose_graph: &PoseGraph, id: i32) -> Result<Vec<TimedPose>, CliError> {
    let pose = |node: &mapping::trajectory::Node| {
        let invalid = || {
            let reason = format!("node ({id}, {}) has no valid pose; see `portolan check`", node.node_index);
            CliError::in_file(path, reason)
        };
        let map_from_tracking = pose_from_proto(node.pose.as_ref()).ok_or_else(invalid)?;
        Ok(TimedPose { time: Time::from_ticks(node.timestamp), map_from_tracking })
    };
    trajectory_of(path, pose_graph, id)?.node.iter().map(pose).collect()
}

/// Relations, text or binary.
pub fn read_relations_file(path: &Path) -> Result<Vec<Relation>, CliError> {
    read_relations(&read_bytes(path)?).map_err(|error: EvaluationError| CliError::in_file(path, error))
}

/// Says on stderr what was put right.
pub fn tell_repairs(path: &Path, repairs: &TrajectoryRepairs) {
    let told = [
        (repairs.unsorted, "came after a later one: put in order"),
        (repairs.duplicate_stamps, "at the time of another: the first was kept"),
        (repairs.invalid_poses, "with values that are no pose: left out"),
        (repairs.renormalized_quaternions, "with a quaternion of a length other than one: normalised"),
    ];
    for (count, what) in told.into_iter().filter(|(count, _)| *count > 0) {
        say(&format!("{}: {} {what}", path.display(), counted(count as u64, "pose", "poses")));
    }
}

/// Seconds as a duration; a number that is none, or not above zero, is wrong usage.
pub fn positive_seconds(option: &str, seconds: f64) -> Result<Duration, CliError> {
    if seconds > 0.0 && seconds < 1e9 {
        return Ok(Duration::from_seconds(seconds));
    }
    Err(CliError::Usage(format!("{option} must be seconds above 0, but is {seconds}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_formats_are_told_apart() {
        assert_eq!(text_format(b"# time x\n1 2 3 4 0 0 0 1\n"), TextFormat::Tum);
        assert_eq!(text_format(b"\n1 0 0 5 0 1 0 6 0 0 1 7\n"), TextFormat::Kitti);
        assert_eq!(text_format(b"# time,x,y\n1,2,3\n"), TextFormat::Csv);
        assert_eq!(text_format(b""), TextFormat::Tum);
    }
}
